"""What every chapter's run shares: telling how long, computing the tasks, the file of results. Clocks live here."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desirepath.learning.cards import short, source_commit
from desirepath_experiments.reproduction.tasks import Function, Run, Task, Work, finish, in_order

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from desirepath_experiments.reproduction.on_workers import Queue

Tell = Callable[[str], None]
ELSEWHERE: ContextVar[Queue | None] = ContextVar(
    "where a run's tasks are computed, if not by this machine", default=None
)


@dataclass(frozen=True)
class Estimate:
    """What is left to do. core_seconds: of one core of this machine, about, when nothing else runs on it."""

    tasks: int
    stored: int
    core_seconds: float

    def in_words(self, processes: int) -> str:
        if self.tasks == self.stored:
            return f"All {self.tasks} tasks are stored already."
        return (
            f"{self.tasks - self.stored} of {self.tasks} tasks to compute, about {time_in_words(self.core_seconds)} "
            f"of one core; with {processes} processes about {time_in_words(self.core_seconds / processes)} "
            "if each has a core."
        )


def time_in_words(seconds: float) -> str:
    """Minutes up to two hours, then hours."""
    return f"{math.ceil(seconds / 60)} min" if seconds < 7_200 else f"{seconds / 3_600:.1f} h"


def estimate(wanted: Sequence[Task], work: Work) -> Estimate:
    """What these tasks and those they need still take."""
    tasks = in_order(wanted)
    missing = [task for task in tasks if not work.has(task)]
    return Estimate(len(tasks), len(tasks) - len(missing), sum(task.seconds for task in missing))


def compute(
    wanted: Sequence[Task],
    functions: Mapping[str, Function],
    work: Work,
    *,
    command: str,
    processes: int,
    tell: Tell,
    name: Callable[[Task], str],
) -> Run:
    """Compute what is missing of these tasks and those they need, telling `name` of each when it is finished.

    Raises ValueError for a number of processes that cannot be.
    """
    # numba and BLAS read these when a process begins; tasks are computed one thread each
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    began = time.perf_counter()
    tell(estimate(wanted, work).in_words(processes))

    def report(task: Task, done: int, todo: int, left: float) -> None:
        tell(f"[{done}/{todo}] {name(task)}; about {time_in_words(left)} left")

    elsewhere = ELSEWHERE.get()
    if elsewhere is None:
        computed = finish(wanted, functions, work, processes=processes, on_task=report)
    else:
        computed = elsewhere.finish(wanted, work, on_task=report, workers=processes)
    made = {task.key: work.load(task.key).meta["made"] for task in in_order(wanted)}
    return Run(command, source_commit(), processes, time.perf_counter() - began, computed, made)


def write_results(path: Path, run: Run, budget: DataclassInstance, **results: Any) -> dict[str, Any]:
    """Write results.json: run, budget, `results` and what is known of every task. Returns what stands in it."""
    written = {
        "command": run.command,
        "commit": run.commit,
        "budget": asdict(budget),
        "processes": run.processes,
        "seconds": run.seconds,
        "computed": run.computed,
        "core_seconds": run.core_seconds,
        "simulated": True,
        **results,
        "tasks": run.made,
    }
    path.write_text(json.dumps(short(plain(written)), indent=1) + "\n", encoding="utf-8")
    return written


def plain(value: Any) -> Any:
    """JSON has no NaN: null instead."""
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
