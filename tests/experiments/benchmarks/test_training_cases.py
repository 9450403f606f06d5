"""The comparison with Stable-Baselines3 case by case: what is set for each, what is said of it, what is left behind."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from desirepath.learning.errors import LearningError
from desirepath_experiments.benchmarks import training_cases
from desirepath_experiments.benchmarks.training_cases import INSTRUCTIONS, benchmark_cases


def reached(arm: str, seed: int, weights: str, seconds: float | None) -> dict[str, Any]:
    return {"arm": arm, "seed": seed, "weights": weights, "seconds_to_94": seconds}


def test_each_case_is_a_process_of_its_own_with_its_own_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """A training takes half a minute: what a process answers is made up, that it is asked is not."""
    asked: list[tuple[dict[str, str], int]] = []
    answer = {
        "ratio_vs_sb3_fast": 4.0,
        "ratio_vs_sb3_fast_at_least": None,
        "seconds_to_94_per_arm": {"fast": 5.5, "sb3_fast": 22.0},
        "never_reached": {"fast": 0, "sb3_fast": 0},
        "per_seed": [
            reached("fast", 0, "averaged", 5.0),
            reached("fast", 0, "last", 8.0),
            reached("sb3_fast", 0, "last", 20.0),
            reached("fast", 1, "averaged", None),
            reached("fast", 1, "last", 6.0),
            reached("sb3_fast", 1, "last", 30.0),
        ],
        "causes": {
            name: {"ratio": 1.0}
            for name in ("ms_per_update", "ms_per_transition_stepped", "updates_needed", "matmul_gflops")
        },
        "openblas_coretype": "Haswell",
        "torch_cpu_capability": "AVX2",
        "load_average": {"before": [0, 0, 0], "after": [1, 0, 0]},
    }

    def run(setup: str, seeds: int, libraries: dict[str, str]) -> dict[str, Any]:
        asked.append((libraries, len(children())))
        return answer

    monkeypatch.setattr(training_cases, "in_a_process", run)
    monkeypatch.setattr(training_cases, "processor_has", lambda flag: True)
    already = len(children())
    result = benchmark_cases(seeds=2, beside=(0, 2))
    assert [(case["instructions"], case["beside"]) for case in result["cases"]] == [
        *(("avx2", 0), ("avx512", 0)),
        *(("avx2", 2), ("avx512", 2)),
    ]
    assert [libraries for libraries, _ in asked] == [*INSTRUCTIONS.values()] * 2
    assert [running - already for _, running in asked] == [0, 0, 2, 2]
    assert len(children()) == already, "the neighbours are gone"
    for case in result["cases"]:
        assert case["per_seed"] == {"0": 4.0, "1": 5.0}
        assert (case["median"], case["lowest"], case["ratio"]) == (4.5, 4.0, 4.0)


def test_instructions_that_are_not_known_or_not_there_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LearningError, match="instructions = sse: known are avx2, avx512"):
        benchmark_cases(instructions=["sse"])
    monkeypatch.setattr(training_cases, "processor_has", lambda flag: False)
    with pytest.raises(LearningError, match="this processor has none"):
        benchmark_cases(instructions=["avx512"])


def children() -> list[str]:
    time.sleep(0.05)
    return Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
