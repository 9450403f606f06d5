"""`desirepath benchmark train --instructions avx2,avx512 --beside 0,1`: the comparison with Stable-Baselines3 once per
instruction set and number of busy neighbours, each case in a process of its own, since libraries choose when they load.

The trainings themselves are `base_training.py`'s.
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from desirepath.learning.errors import LearningError

ARMS = ("fast", "sb3_fast")
# What NumPy's library, torch, MKL and oneDNN are held to; None: nothing is said, each takes what the processor has.
INSTRUCTIONS: Mapping[str, Mapping[str, str | None]] = {
    "avx2": {
        "OPENBLAS_CORETYPE": "Haswell",
        "ATEN_CPU_CAPABILITY": "avx2",
        "MKL_ENABLE_INSTRUCTIONS": "AVX2",
        "ONEDNN_MAX_CPU_ISA": "AVX2",
    },
    "avx512": {
        "OPENBLAS_CORETYPE": "SkylakeX",
        "ATEN_CPU_CAPABILITY": None,
        "MKL_ENABLE_INSTRUCTIONS": None,
        "ONEDNN_MAX_CPU_ISA": None,
    },
}
NEIGHBOUR = """
import os, numpy
parent, a = os.getppid(), numpy.ones((512, 512), numpy.float32)
while os.getppid() == parent:
    a @ a
"""
"""A process that multiplies matrices and ends with who started it."""


def benchmark_cases(
    *,
    setup: str = "open_field",
    seeds: int = 1,
    instructions: Sequence[str] = tuple(INSTRUCTIONS),
    beside: Sequence[int] = (0, 1),
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """The gain over Stable-Baselines3 on the same engine in every case: `ratio` of the medians, `per_seed` and `lowest`
    of each seed's own, with what both arms took, the products' rates and how busy the machine was.

    beside: so many processes that multiply matrices meanwhile. Raises LearningError for instructions that are not known
    or that this processor does not have.
    """
    for name in instructions:
        if name not in INSTRUCTIONS:
            raise LearningError(f"instructions = {name}: known are {', '.join(INSTRUCTIONS)}")
        if name == "avx512" and not processor_has("avx512f"):
            raise LearningError("instructions = avx512: this processor has none")
    cases = []
    for neighbours in beside:
        for name in instructions:
            tell(f"{name}, {neighbours} beside")
            with _neighbours(neighbours):
                found = in_a_process(setup, seeds, INSTRUCTIONS[name])
            cases.append({"instructions": name, "beside": neighbours} | _summary(found))
    return {"setup": setup, "seeds": seeds, "seconds_are": "processor time", "cores": os.cpu_count(), "cases": cases}


def processor_has(flag: str) -> bool:
    cpu = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return any(line.startswith("flags") and flag in line.split() for line in cpu)


@contextlib.contextmanager
def _neighbours(count: int) -> Iterator[None]:
    running = [subprocess.Popen([sys.executable, "-c", NEIGHBOUR]) for _ in range(count)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def in_a_process(setup: str, seeds: int, libraries: Mapping[str, str | None]) -> dict[str, Any]:
    environment = os.environ | {name: value for name, value in libraries.items() if value is not None}
    for name, value in libraries.items():
        if value is None:
            environment.pop(name, None)
    asked = ["benchmark", "train", "--setup", setup, "--seeds", str(seeds), "--arms", ",".join(ARMS), "--json"]
    ended = subprocess.run(
        [sys.executable, "-m", "desirepath", *asked], env=environment, stdout=subprocess.PIPE, text=True, check=False
    )
    if ended.returncode != 0:
        raise LearningError(f"desirepath {' '.join(asked)}: {ended.stdout.strip() or 'failed, see above'}")
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def _summary(found: Mapping[str, Any]) -> dict[str, Any]:
    """One case, out of what `benchmark_train` returns."""
    took = {arm: _to_94(found, arm) for arm in ARMS}
    gains = {
        str(seed): took["sb3_fast"][seed] / ours for seed, ours in took["fast"].items() if seed in took["sb3_fast"]
    }
    return {
        "ratio": found["ratio_vs_sb3_fast"],
        "ratio_at_least": found["ratio_vs_sb3_fast_at_least"],
        "per_seed": gains,
        "median": statistics.median(gains.values()) if gains else None,
        "lowest": min(gains.values(), default=None),
        "seconds_to_94": found["seconds_to_94_per_arm"],
        "never_reached": found["never_reached"],
        **{name: found["causes"][name] for name in ("ms_per_update", "ms_per_transition_stepped", "updates_needed")},
        "matmul_gflops": found["causes"]["matmul_gflops"],
        "openblas_coretype": found["openblas_coretype"],
        "torch_cpu_capability": found["torch_cpu_capability"],
        "load_average": found["load_average"],
    }


def _to_94(found: Mapping[str, Any], arm: str) -> dict[int, float]:
    """Seed -> seconds until 94 % was confirmed by whichever weights were first; without those that never got there."""
    seconds: dict[int, float] = {}
    for entry in found["per_seed"]:
        if entry["arm"] == arm and entry["seconds_to_94"] is not None:
            seconds[entry["seed"]] = min(entry["seconds_to_94"], seconds.get(entry["seed"], float("inf")))
    return seconds
