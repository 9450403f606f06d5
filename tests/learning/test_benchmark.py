"""The benchmarks run whole, say what they measured, and say null where nothing was reached. No timing is asserted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from backend.learning import benchmark
from backend.learning.base import BaseConfig
from backend.learning.benchmark import TrainBenchmarkConfig, benchmark_train
from backend.learning.errors import LearningError
from backend.learning.scene_sets import Purpose, scene_set
from backend.simulation.scene import Scene

TINY = TrainBenchmarkConfig(updates_per_check=24, max_updates=48, pybullet_steps=5)


def test_train_benchmark_compares_arms_and_admits_failure(tiny_config: BaseConfig) -> None:
    result = benchmark_train(seeds=1, config=TINY, base=replace(tiny_config, updates_per_step=12))
    assert result["seconds_to_94"] is None  # 48 updates do not make a driver
    assert result["held_out_success"] is None
    assert result["ratio_vs_sb3_fast"] is None
    assert result["ratio_vs_sb3_pybullet"] is None
    assert [(entry["arm"], entry["weights"]) for entry in result["per_seed"]] == [
        ("fast", "averaged"),
        ("fast", "last"),
        ("sb3_fast", "last"),
        ("sb3_fast", "averaged"),
    ]
    for entry in result["per_seed"]:
        assert entry["updates"] >= 48
        assert entry["transitions"] > tiny_config.random_transitions
        assert entry["ms_per_update"] > 0
        assert entry["ms_per_transition"] > 0
    assert set(result["causes"]["ms_per_update"]) == {"fast", "sb3_fast", "ratio"}
    assert "not trained" in result["sb3_pybullet_note"]


def test_a_target_that_is_reached_is_confirmed_on_scenes_that_are_new_at_every_try(
    tiny_config: BaseConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds: list[int] = []

    def noting(setup: str, n: int, *, purpose: Purpose, seed: int) -> list[Scene]:
        if purpose == Purpose.REPORT:
            seeds.append(seed)
            n = 20  # few, for speed
        return scene_set(setup, n, purpose=purpose, seed=seed)

    monkeypatch.setattr(benchmark, "scene_set", noting)
    monkeypatch.setattr(benchmark, "TARGET", 0.0)  # any policy reaches it
    result = benchmark_train(seeds=2, arms=("fast", "sb3_fast"), config=TINY, base=tiny_config)
    assert result["held_out_success"] is not None
    assert result["ratio_vs_sb3_fast"] == pytest.approx(
        result["seconds_to_94_per_arm"]["sb3_fast"] / result["seconds_to_94_per_arm"]["fast"]
    )
    assert all(entry["seconds_to_94"] > 0 for entry in result["per_seed"])
    per_training = [seeds[k : k + 2] for k in range(0, len(seeds), 2)]  # both weights of each training
    assert all(first != second for first, second in per_training)
    assert per_training[0] == per_training[1]  # both arms on the same scenes


def test_a_broken_benchmark_goes_on_where_it_was(tiny_config: BaseConfig, tmp_path: Path) -> None:
    keep = tmp_path / "kept.json"
    first = benchmark_train(seeds=1, arms=("fast",), config=TINY, base=tiny_config, keep=keep)
    again = benchmark_train(seeds=1, arms=("fast",), config=TINY, base=tiny_config, keep=keep)
    assert again["per_seed"] == first["per_seed"]  # seconds and all: nothing ran again
    with pytest.raises(LearningError, match="other settings"):
        benchmark_train(seeds=1, config=TINY, base=replace(tiny_config, tau=0.5), keep=keep)


def test_unknown_arms_are_refused() -> None:
    with pytest.raises(LearningError, match="known arms"):
        benchmark_train(arms=("fast", "warp"))
