"""`desirepath benchmark workers`: a sweep's tasks on 1, 2 and 4 workers, and how long until a killed one's job goes on.

Each worker has a data folder of its own, as on a machine of its own; they share a PostgreSQL server of this command's
and a folder of artefacts.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from sqlalchemy import func, select

from desirepath.jobs.kinds import TASK
from desirepath.jobs.leases import attempts_at
from desirepath.jobs.process import environment_of
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Job, JobAttempt, WorkerProcess
from desirepath.store.outbox import ENDED, enqueue_job
from desirepath_experiments.own_postgres import own_postgres
from desirepath_experiments.reproduction.on_workers import Queue
from desirepath_experiments.reproduction.tasks import Task, Work

Load = Literal["waiting", "working"]
START_PATIENCE_S, HANDOVER_PATIENCE_S = 120.0, 120.0
LOOK_S = 0.05


class WorkersBenchmarkError(RuntimeError):
    """A worker did not start, or nobody took a job over."""


def benchmark_workers(
    *,
    tasks: int = 24,
    workers: Sequence[int] = (1, 2, 4),
    task_s: float = 5.0,
    load: Load = "waiting",
    kills: int = 3,
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """Have so many equal tasks computed by each number of workers, then kill one in the middle of a job, `kills` times.

    load: `waiting` tasks need no processor, so that what is measured is the queue whatever the number of cores;
    `working` ones keep one core busy each, for `task_s` of processor time.

    Returns {"load", "tasks", "task_s", "cores", "runs": by number of workers its seconds, speed-up against the first,
    efficiency (speed-up by number of workers) and how many tasks each worker did, "handover": seconds from the kill
    until another worker had begun the job anew, median and worst}.
    Raises WorkersBenchmarkError, ValueError, NoPostgres.
    """
    if tasks < 1 or kills < 0 or not workers or min(workers) < 1:
        raise ValueError(
            f"tasks = {tasks}, workers = {list(workers)}, kills = {kills}: at least one task and one worker"
        )
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="desirepath-workers-")))
        url = held.enter_context(own_postgres())
        installation = _Installation(folder, url)
        held.callback(installation.database.close)
        runs: list[dict[str, Any]] = []
        for number in workers:
            with installation.workers(number):
                tell(f"{tasks} tasks on {number} workers")
                seconds, shares = installation.sweep(tasks, load, task_s, of=f"{number} workers")
            runs.append({"workers": number, "seconds": round(seconds, 1), "tasks_by_worker": shares})
        handovers = []
        for number in range(kills):
            with installation.workers(2) as processes:
                tell(f"kill {number + 1} of {kills}")
                handovers.append(installation.handover(processes, number))
    first = runs[0]["seconds"] * runs[0]["workers"]
    for run in runs:
        run["speed_up"] = round(first / run["seconds"], 2)
        run["efficiency"] = round(first / run["seconds"] / run["workers"], 2)
    handover = (
        {"median_s": round(float(np.median(handovers)), 1), "worst_s": round(max(handovers), 1)} if kills else None
    )
    return {
        "load": load,
        "tasks": tasks,
        "task_s": task_s,
        "cores": os.cpu_count(),
        "runs": runs,
        "kills": kills,
        "handover": handover,
    }


class _Installation:
    """What the workers share, and who they are."""

    def __init__(self, folder: Path, url: str) -> None:
        self._folder, self._url = folder, url
        self._artefacts = (folder / "artefacts").as_uri()
        self.database, self.files = Database(url), ArtefactStore(self._artefacts)
        self.database.migrate()

    @contextlib.contextmanager
    def workers(self, number: int) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
        """So many workers, all of them ready; by the name of their machine. They end with the block, or with us."""
        with self.database.transaction() as s:
            for row in s.scalars(select(WorkerProcess)):
                s.delete(row)
        started = {f"machine-{place}": self._start(f"machine-{place}") for place in range(1, number + 1)}
        try:
            _until(lambda: self._living() == set(started), START_PATIENCE_S, f"{number} workers did not start")
            yield started
        finally:
            for process in started.values():
                process.kill()
                process.wait()

    def _start(self, machine: str) -> subprocess.Popen[bytes]:
        data = self._folder / machine
        data.mkdir(exist_ok=True)
        settings = Settings(data=data, database_url=self._url, artefacts_url=self._artefacts)
        known = environment_of(settings) | {"DESIREPATH_MACHINE": machine, "DESIREPATH_STANDING_PROCESS": "false"}
        with (data / "worker.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "desirepath.cli.ends_with_parent", "worker"],
                env=known,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def _living(self) -> set[str]:
        with self.database.session() as s:
            return set(s.scalars(select(WorkerProcess.machine)))

    def sweep(self, number: int, load: Load, seconds: float, *, of: str) -> tuple[float, dict[str, int]]:
        """Seconds for that many tasks, and how many of them each machine did."""
        tasks = [
            Task(load, {"number": place, "seconds": seconds, "of": of}, seconds=seconds) for place in range(number)
        ]
        work = Work(self._folder / f"work {of}")
        queue = Queue("benchmark", self.database, self.files, created_by="benchmark")
        with work.claimed():
            began = time.monotonic()
            queue.finish(tasks, work, on_task=lambda *_: None)
            took = time.monotonic() - began
        keys = [task.key for task in tasks]
        with self.database.session() as s:
            jobs = select(Job.id).where(Job.kind == TASK, Job.params["key"].as_string().in_(keys))
            did = s.scalars(select(JobAttempt.machine).where(JobAttempt.job_id.in_(jobs)))
            return took, dict(sorted(Counter(did).items()))

    def handover(self, processes: dict[str, subprocess.Popen[bytes]], number: int) -> float:
        """Seconds from the kill of the worker that has a job until the other has begun it anew."""
        task = Task("waiting", {"number": number, "seconds": 3.0, "of": "handover"})
        params = {"chapter": "benchmark", "key": task.key, "function": task.kind, "params": task.params}
        with self.database.transaction() as s:
            job = enqueue_job(s, TASK, params, created_by="benchmark").id
        _until(lambda: bool(self._machines(job)), START_PATIENCE_S, "nobody took the job up")
        process = processes[self._machines(job)[0]]
        children = _children(process.pid)
        process.send_signal(signal.SIGKILL)
        for child in children:  # the machine is gone with all that ran on it
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        killed = time.monotonic()
        _until(lambda: len(self._machines(job)) > 1, HANDOVER_PATIENCE_S, "nobody took the job over")
        took = time.monotonic() - killed
        _until(lambda: self._ended(job), HANDOVER_PATIENCE_S, "the job did not end")
        return took

    def _machines(self, job: str) -> list[str]:
        with self.database.session() as s:
            return [one.machine for one in attempts_at(s, job)]

    def _ended(self, job: str) -> bool:
        with self.database.session() as s:
            return s.scalar(select(func.count()).where(Job.id == job, Job.state.in_(ENDED))) == 1


def _children(process: int) -> list[int]:
    from desirepath_experiments.benchmarks.processes import children_of

    below = children_of(process)
    return below + [child for one in below for child in _children(one)]


def _until(holds: Callable[[], bool], patience_s: float, said: str) -> None:
    deadline = time.monotonic() + patience_s
    while not holds():
        if time.monotonic() > deadline:
            raise WorkersBenchmarkError(f"{said} within {patience_s:.0f} s")
        time.sleep(LOOK_S)
