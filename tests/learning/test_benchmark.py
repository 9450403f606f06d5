"""The benchmarks run whole, say what they measured, and say null where nothing was reached. No timing is asserted."""

from __future__ import annotations

from dataclasses import replace

import pytest

from backend.learning.base import BaseConfig
from backend.learning.benchmark import TrainBenchmarkConfig, benchmark_train
from backend.learning.errors import LearningError


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
