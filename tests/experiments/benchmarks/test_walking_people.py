"""Walking against standing people in exploration: every training has its pair, and a run that was stopped goes on."""

from __future__ import annotations

from pathlib import Path

import pytest

from desirepath_experiments.benchmarks import walking_people
from desirepath_experiments.benchmarks.walking_people import MEASURES, WHERE, benchmark_walking


def test_pairs_of_trainings_differ_only_in_who_walks_and_are_trained_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(walking_people, "PAIRS", 1)
    monkeypatch.setattr(walking_people, "OTHERS_PER_PAIR", 2)
    monkeypatch.setattr(walking_people, "DEMONSTRATION_SETUPS", ("room",))
    found = benchmark_walking(tmp_path, seeds=(0, 1), updates=16)
    assert (found["pairs"], found["rollouts"]) == (2, {"shown": 2 * 2 * 4, "others": 2 * 2})
    assert [(one["setup"], one["seed"], one["walking"]) for one in found["by_pair"]] == [
        ("room", seed, walking) for seed in (0, 1) for walking in (False, True)
    ]
    for where in WHERE:
        for measure in MEASURES:
            one = found[f"{where}_{measure}"]
            assert one["difference"] == pytest.approx(one["walking"] - one["standing"])
            if one["interval"] is not None:  # pairs that all differ by the same have none
                assert one["interval"][0] <= one["difference"] <= one["interval"][1]
    written = {path: path.stat().st_mtime_ns for path in tmp_path.glob("trained-*.npz")}
    assert len(written) == 4
    assert benchmark_walking(tmp_path, seeds=(0, 1), updates=16) == found
    assert {path: path.stat().st_mtime_ns for path in written} == written
