"""What a headset has to draw is counted as the browser would draw it, and stays within what such a headset manages."""

from __future__ import annotations

from desirepath_experiments.benchmarks.headset_scenes import HeadsetConfig, benchmark_headset, weight_of
from desirepath_stage.scene_nodes import squares


def test_a_file_is_weighed():
    assert weight_of(squares(3, 4, (0, 0, 0))) == (1, 6, 0.0)


def test_every_setup_is_cheap_enough_in_both_eyes():
    found = benchmark_headset(HeadsetConfig(scenes=1))
    assert found["over"] == []
    assert min(scene["triangles"] for scene in found["most_of_a_scene"].values()) > 1000, (
        "somebody looks into the files"
    )
