"""`desirepath benchmark soak`: what counts as growth."""

from __future__ import annotations

import os

from desirepath_experiments.benchmarks.processes import open_files, threads_of
from desirepath_experiments.benchmarks.soaking import growth


def a_round(at_s: float, memory_mb: float, files: int = 60) -> dict[str, float]:
    return {"from_s": at_s, "memory_mb": memory_mb, "open_files": files, "threads": 30}


def test_growth_is_per_hour_and_leaves_out_the_round_in_which_things_are_loaded():
    rounds = [a_round(0, 100), a_round(600, 200), a_round(1200, 201), a_round(1800, 202)]
    assert growth(rounds) == {"memory_mb": 6.0, "open_files": 0.0, "threads": 0.0}
    assert growth(rounds[:2]) is None


def test_a_file_that_stays_open_is_seen(tmp_path):
    before = open_files(os.getpid())
    with (tmp_path / "held").open("w"):
        assert open_files(os.getpid()) == before + 1
    assert threads_of(os.getpid()) >= 1
    assert open_files(2**22 + 1) == 0  # no such process
