"""Work that survives being killed: tasks, each stored in one file named by the hash of all that its result depends on.

What the tasks of a chapter compute lives in that chapter's module; here live storing, ordering and running them, on
this machine or on an installation's workers, and telling how long that takes.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.cards import source_commit
from desirepath.npz import from_npz, to_npz

if TYPE_CHECKING:
    from desirepath_experiments.reproduction.on_workers import Queue

FORMAT = "desirepath-piece-1"
PARTIAL = ".partial"


@dataclass(frozen=True)
class Task:
    """One task. kind: the name of its function. params: JSON-ready, everything else its result depends on.

    needs: tasks whose results the function is given. seconds: about how long it takes, only for telling and for
    starting the longest first; no part of its identity.
    """

    kind: str
    params: dict[str, Any]
    needs: tuple[Task, ...] = ()
    seconds: float = 0.0

    @property
    def key(self) -> str:
        """Kind and hash: the name of its file."""
        needs = [need.key for need in self.needs]
        identity = {"format": FORMAT, "kind": self.kind, "params": self.params, "needs": needs}
        digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        return f"{self.kind}-{digest[:20]}"

    @property
    def name(self) -> str:
        """What people are told of it: its kind with the settings that tell it from others."""
        settings = {**self.params, **self.params.get("config", {})}
        return " ".join([self.kind.replace("_", " "), *(f"{settings[key]}" for key in TOLD if key in settings)])


TOLD = (
    "variant", "configuration", "view", "source", "style", "controller", "planner", "learner", "environment", "recipe",
    "queries", "kappa", "seed", "until",
)  # fmt: skip


@dataclass(frozen=True)
class TaskResult:
    """What a task came to: plain values and arrays. `meta` gets `made` (seconds, commit, date) when stored."""

    meta: dict[str, Any]
    arrays: dict[str, NDArray[Any]]

    def content(self, name: str) -> bytes:
        """A file that was stored as an array of bytes."""
        return self.arrays[name].tobytes()


def as_bytes(content: bytes) -> NDArray[np.uint8]:
    """A file as an array, to be stored with others."""
    return np.frombuffer(content, dtype=np.uint8)


Function = Callable[[dict[str, Any], Sequence[TaskResult]], TaskResult]
"""(params, results of the needs) -> result; runs in any process, so it must be a module's function."""
Load = Callable[[Task], TaskResult]
Tell = Callable[[str], None]
ELSEWHERE: ContextVar[Queue | None] = ContextVar("where tasks are computed, if not by this machine", default=None)


def to_bytes(result: TaskResult) -> bytes:
    """The content of a task's file."""
    return to_npz(result.meta, result.arrays)


def from_bytes(content: bytes) -> TaskResult:
    """Never unpickles."""
    return TaskResult(*from_npz(content))


class Work:
    """The folder of finished tasks. A file that is there is whole: it is written beside and renamed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, task_key: str) -> Path:
        return self.folder / f"{task_key}.npz"

    def has(self, task: Task) -> bool:
        return self.path(task.key).is_file()

    def load(self, task: Task) -> TaskResult:
        return from_bytes(self.path(task.key).read_bytes())

    def store_bytes(self, task_key: str, content: bytes) -> None:
        """Store what `to_bytes` made, perhaps on another machine."""
        partial = self.folder / f"{task_key}.{os.getpid()}{PARTIAL}"
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(self.path(task_key))

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """This process alone works here; the claim ends with the process, however it ends. Raises RuntimeError."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / "claim").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise RuntimeError(
                    f"{self.folder.parent}: another run works there; wait for it or use another --out"
                ) from None
            for left in self.folder.glob(f"*{PARTIAL}"):
                left.unlink()
            yield


def computed(
    functions: Mapping[str, Function], kind: str, params: dict[str, Any], needs: Sequence[TaskResult]
) -> TaskResult:
    """What a task comes to, as it is stored: with what it was and how long it took. Runs in any process."""
    began, cpu = time.perf_counter(), time.process_time()
    result = functions[kind](params, needs)
    about = {
        "seconds": time.perf_counter() - began,
        "cpu_seconds": time.process_time() - cpu,
        "commit": source_commit(),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return TaskResult({**result.meta, "kind": kind, "params": params, "made": about}, result.arrays)


def finish_task(functions: Mapping[str, Function], folder: Path, task: Task) -> float:
    """Compute and store one task whose needs are stored; returns its seconds. Runs in any process."""
    work = Work(folder)
    result = computed(functions, task.kind, task.params, [work.load(need) for need in task.needs])
    work.store_bytes(task.key, to_bytes(result))
    return float(result.meta["made"]["seconds"])


@dataclass(frozen=True)
class Run:
    """The run that made a report. made: what `tasks` stored about each task (seconds, commit, date), by key."""

    command: str
    commit: str
    processes: int
    seconds: float
    computed: int
    made: Mapping[str, Mapping[str, Any]]

    @property
    def core_seconds(self) -> float:
        """Of one core, for all tasks, whenever they were computed."""
        return sum(float(about["cpu_seconds"]) for about in self.made.values())


def in_order(tasks: Sequence[Task]) -> list[Task]:
    """These tasks and all they need, each once, needs first."""
    ordered: dict[str, Task] = {}

    def take(task: Task) -> None:
        for need in task.needs:
            take(need)
        ordered.setdefault(task.key, task)

    for task in tasks:
        take(task)
    return list(ordered.values())


OnTask = Callable[[Task, int, int, float], None]
"""(task just finished, finished so far, all to do, seconds that the rest will take, about)."""


def results_of(
    tasks: Sequence[Task], functions: Mapping[str, Function], folder: Path | None = None
) -> list[TaskResult]:
    """These tasks' results, computed here where they are not stored in `folder`; None: all of them, and none is kept.

    Raises RuntimeError if another process works there, and what a task raised.
    """
    with TemporaryDirectory() as made_here:
        work = Work(folder or Path(made_here))
        with work.claimed():
            finish(tasks, functions, work, processes=1, on_task=lambda *_: None)
            return [work.load(task) for task in tasks]


def finish(
    tasks: Sequence[Task], functions: Mapping[str, Function], work: Work, *, processes: int, on_task: OnTask
) -> int:
    """Compute what is not stored yet, in `processes` processes of one thread each; returns how many were computed.

    One process means this one. Raises what a task raised; finished tasks stay.
    """
    if processes < 1:
        raise ValueError(f"processes = {processes}: at least 1")
    missing = [task for task in in_order(tasks) if not work.has(task)]
    progress = Countdown(missing, processes, on_task)
    if processes == 1:
        for task in missing:
            progress.count(task, finish_task(functions, work.folder, task))
        return len(missing)
    with worker_pool(processes) as pool:
        waiting, running = list(missing), dict[Future[float], Task]()
        while waiting or running:
            ready = [task for task in waiting if all(work.has(need) for need in task.needs)]
            for task in sorted(ready, key=lambda p: -p.seconds)[: processes - len(running)]:
                waiting.remove(task)
                running[pool.submit(finish_task, functions, work.folder, task)] = task
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                progress.count(running.pop(future), future.result())
    return len(missing)


class Countdown:
    """Corrects the estimate of what is left by how long the finished tasks took."""

    def __init__(self, tasks: Sequence[Task], processes: int, on_task: OnTask) -> None:
        self._todo, self._processes, self._on_task = len(tasks), processes, on_task
        self._left = sum(task.seconds for task in tasks)
        # As if a tenth of the work had been done in the time estimated: the first, small tasks say little.
        self._done, self._estimated, self._took = 0, self._left / 10, self._left / 10

    def count(self, task: Task, seconds: float) -> None:
        self._done += 1
        self._left -= task.seconds
        self._estimated += task.seconds
        self._took += seconds
        slower = self._took / self._estimated if self._estimated else 1.0
        self._on_task(task, self._done, self._todo, max(0.0, self._left) * slower / self._processes)


def worker_pool(processes: int) -> ProcessPoolExecutor:
    """Of processes that end with this one."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent)


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever; this one ends instead."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # noqa: S101 - only ever called in a child

    def watch() -> None:
        wait_for([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def time_in_words(seconds: float) -> str:
    """Minutes up to two hours, then hours."""
    return f"{math.ceil(seconds / 60)} min" if seconds < 7_200 else f"{seconds / 3_600:.1f} h"


def estimate_in_words(wanted: Sequence[Task], work: Work, processes: int) -> str:
    """How long what is missing of these tasks and of those they need still takes this machine, about."""
    tasks = in_order(wanted)
    missing = [task for task in tasks if not work.has(task)]
    if not missing:
        return f"All {len(tasks)} tasks are stored already."
    seconds = sum(task.seconds for task in missing)
    return (
        f"{len(missing)} of {len(tasks)} tasks to compute, about {time_in_words(seconds)} of one core; with "
        f"{processes} processes about {time_in_words(seconds / processes)} if each has a core."
    )


def compute(
    wanted: Sequence[Task], functions: Mapping[str, Function], work: Work, *, command: str, processes: int, tell: Tell
) -> Run:
    """Compute what is missing of these tasks and those they need, telling of each when it is finished.

    Raises ValueError for a number of processes that cannot be.
    """
    # numba and BLAS read these when a process begins; tasks are computed one thread each
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    began = time.perf_counter()
    tell(estimate_in_words(wanted, work, processes))

    def report(task: Task, done: int, todo: int, left: float) -> None:
        tell(f"[{done}/{todo}] {task.name}; about {time_in_words(left)} left")

    elsewhere = ELSEWHERE.get()
    if elsewhere is None:
        computed = finish(wanted, functions, work, processes=processes, on_task=report)
    else:
        computed = elsewhere.finish(wanted, work, on_task=report, workers=processes)
    provenance = {task.key: work.load(task).meta["made"] for task in in_order(wanted)}
    return Run(command, source_commit(), processes, time.perf_counter() - began, computed, provenance)
