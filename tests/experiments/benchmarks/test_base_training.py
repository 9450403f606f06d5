"""The benchmarks run whole, say what they measured, and say null where nothing was reached. No timing is asserted."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import BaseConfig
from desirepath.simulation.scene import Scene
from desirepath_experiments.benchmarks import training_arms
from desirepath_experiments.benchmarks.base_training import benchmark_train
from desirepath_experiments.benchmarks.training_arms import TrainBenchmarkConfig

TINY = TrainBenchmarkConfig(updates_per_check=24, check_scenes=50, max_updates=48)


@pytest.fixture(scope="module")
def both(tiny_config: BaseConfig, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What the benchmark of both arms says, and the file that it keeps."""
    keep = tmp_path_factory.mktemp("both") / "kept.json"
    return benchmark_train(replace(TINY, keep=keep), base=tiny_config), keep


def test_train_benchmark_compares_arms_and_admits_failure(
    both: tuple[dict[str, Any], Path], tiny_config: BaseConfig
) -> None:
    result, _ = both
    assert result["seconds_to_94"] is None  # 48 updates do not make a driver
    assert result["held_out_success"] is None
    assert result["ratio_vs_sb3_fast"] is None
    assert result["ratio_vs_sb3_fast_at_least"] is None  # ours got nowhere either
    assert result["never_reached"] == {"fast": 1, "sb3_fast": 1}
    assert [(entry["arm"], entry["weights"]) for entry in result["per_seed"]] == [
        ("fast", "averaged"),
        ("fast", "last"),
        ("sb3_fast", "last"),
    ]
    for entry in result["per_seed"]:
        assert entry["updates"] >= 48
        assert entry["ms_per_update"] > 0
        assert entry["ms_per_transition"] > 0
        assert entry["seconds"] > 0
        assert entry["transitions"] > tiny_config.random_transitions


def test_arms_that_take_turns_do_what_each_does_alone(
    both: tuple[dict[str, Any], Path], tiny_config: BaseConfig
) -> None:
    def told(result: dict[str, Any]) -> list[tuple[object, ...]]:
        names = ("arm", "weights", "seed", "updates", "transitions", "held_out_success", "tries")
        return sorted(tuple(entry[name] for name in names) for entry in result["per_seed"])

    alone = [benchmark_train(replace(TINY, arms=(arm,)), base=tiny_config) for arm in ("fast", "sb3_fast")]
    assert told(both[0]) == sorted(row for result in alone for row in told(result))


def test_turns_are_taken_chunk_by_chunk() -> None:
    order: list[str] = []

    def training(name: str, chunks: int) -> training_arms.Training:
        for _ in range(chunks):
            order.append(name)
            yield
        return []

    training_arms.take_turns({"a": training("a", 3), "b": training("b", 1)})
    assert order == ["a", "b", "a", "a"]


def test_a_slow_arm_that_never_arrives_gives_a_lower_bound(
    both: tuple[dict[str, Any], Path], tiny_config: BaseConfig, tmp_path: Path
) -> None:
    keep = Path(shutil.copy(both[1], tmp_path))
    kept = json.loads(keep.read_text(encoding="utf-8"))
    for entry in kept["runs"]["fast 0"]:
        entry.update(seconds=1.0, seconds_to_94=1.0, held_out_success=0.95)
    kept["runs"]["sb3_fast 0"][0]["seconds"] = 7.0
    keep.write_text(json.dumps(kept), encoding="utf-8")
    result = benchmark_train(replace(TINY, keep=keep), base=tiny_config)
    assert result["seconds_to_94"] == 1.0
    assert result["ratio_vs_sb3_fast"] is None
    assert result["ratio_vs_sb3_fast_at_least"] == 7.0


def test_a_target_that_is_reached_is_confirmed_on_scenes_that_are_new_at_every_try(
    tiny_config: BaseConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds: list[int] = []

    def noting(setup: str, n: int, *, purpose: Purpose, seed: int) -> list[Scene]:
        if purpose == Purpose.REPORT:
            seeds.append(seed)
            n = 20  # few, for speed
        return scene_set(setup, n, purpose=purpose, seed=seed)

    monkeypatch.setattr(training_arms, "scene_set", noting)
    monkeypatch.setattr(training_arms, "TARGET", 0.0)  # any policy reaches it
    result = benchmark_train(replace(TINY, seeds=2), base=tiny_config)
    assert result["held_out_success"] is not None
    assert result["ratio_vs_sb3_fast"] == pytest.approx(
        result["seconds_to_94_per_arm"]["sb3_fast"] / result["seconds_to_94_per_arm"]["fast"]
    )
    assert all(entry["seconds_to_94"] > 0 for entry in result["per_seed"])
    per_seed = [seeds[k : k + 3] for k in range(0, len(seeds), 3)]  # both weights of ours, then SB3's last
    assert all(averaged != last for averaged, last, _ in per_seed)
    assert all(averaged == sb3 for averaged, _, sb3 in per_seed)  # both arms begin with the same scenes
    assert len({seed for training in per_seed for seed in training}) == 4


def test_a_broken_benchmark_goes_on_where_it_was(both: tuple[dict[str, Any], Path], tiny_config: BaseConfig) -> None:
    first, keep = both
    again = benchmark_train(replace(TINY, keep=keep), base=tiny_config)
    assert again["per_seed"] == first["per_seed"]  # seconds and all: nothing ran again
    with pytest.raises(LearningError, match="other settings"):
        benchmark_train(replace(TINY, keep=keep), base=replace(tiny_config, tau=0.5))


def test_unknown_arms_are_refused() -> None:
    with pytest.raises(ValueError, match="'fast', 'unguided' or 'sb3_fast'"):
        TrainBenchmarkConfig(arms=("fast", "warp"))
