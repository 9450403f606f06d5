"""The benchmarks run whole, say what they measured, and say null where nothing was reached. No timing is asserted."""

from __future__ import annotations

from dataclasses import replace

import pytest

from backend.learning.align import AlignConfig
from backend.learning.base import BaseConfig
from backend.learning.benchmark import TrainBenchmarkConfig, benchmark_align, benchmark_train
from backend.learning.errors import LearningError

TINY_ALIGN = AlignConfig(
    updates=64, checkpoints=1, replay_transitions=2_000, selection_scenes=20, gate_scenes=20, weighing_scenes=20
)


def test_train_benchmark_compares_arms_and_admits_failure(tiny_config: BaseConfig) -> None:
    config = TrainBenchmarkConfig(updates_per_check=24, max_updates=48, pybullet_steps=5)
    result = benchmark_train(seeds=1, config=config, base=replace(tiny_config, updates_per_step=12))
    assert result["seconds_to_94"] is None  # 48 updates do not make a driver
    assert result["held_out_success"] is None
    assert result["ratio_vs_sb3_fast"] is None
    assert result["ratio_vs_sb3_pybullet"] is None
    assert [entry["arm"] for entry in result["per_seed"]] == ["fast", "sb3_fast"]
    for entry in result["per_seed"]:
        assert entry["updates"] >= 48
        assert entry["transitions"] > tiny_config.random_transitions
    assert "not trained" in result["sb3_pybullet_note"]


def test_unknown_arms_are_refused() -> None:
    with pytest.raises(LearningError, match="known arms"):
        benchmark_train(arms=("fast", "warp"))


def test_align_benchmark_reports_the_keys_others_rely_on() -> None:
    result = benchmark_align(setup="study_room", queries=4, seed=1, n=60, config=TINY_ALIGN)
    assert {"seconds", "base", "aligned", "paired_gain", "ceiling_m"} <= set(result)
    assert result["seconds"] > 0
    for side in ("base", "aligned"):
        assert {"setup", "n", "success_rate", "min_human_distance_m", "path_length_m", "time_s"} <= set(result[side])
    assert result["paired_gain"]["low"] <= result["paired_gain"]["value"] <= result["paired_gain"]["high"]
    assert result["base"]["ceiling_m"] == result["ceiling_m"]


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(LearningError, match="refine, thesis"):
        benchmark_align(mode="telepathy")
