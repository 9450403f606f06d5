"""The parity benchmark drives the same scenes on both engines and pairs what came of it."""

from __future__ import annotations

import pytest

from desirepath_experiments.benchmarks.parity import benchmark_parity


def test_both_engines_drive_the_same_scenes_and_the_gap_is_their_difference() -> None:
    result = benchmark_parity(policy="study_room/base", scenes=6, seed=3)
    assert result["n"] == 6
    gap = result["success_gap_points"]
    difference = result["fast"]["success_rate"] - result["pybullet"]["success_rate"]
    assert gap["value"] == pytest.approx(100 * difference)
    assert gap["low"] <= gap["value"] <= gap["high"]
    assert result["only_fast_succeeds"] - result["only_pybullet_succeeds"] == round(gap["value"] * 6 / 100)
    for engine in ("fast", "pybullet"):
        assert sum(result[engine].values()) == pytest.approx(1)
    # Wheel motors lag: the same policy takes a little longer, not many times as long.
    assert 0.8 < result["paired"]["time_s"]["ratio"]["value"] < 2
