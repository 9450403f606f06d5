"""A sweep's tasks as jobs on the queue that all workers share (`desirepath reproduce CHAPTER --on workers`).

Which tasks there are and what they compute is each chapter's. A result is a file of the artefact store under the
task's key, so a sweep that was ended goes on where it was, from any machine; what two sweeps share is computed once.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from desirepath.jobs.context import JobContext
from desirepath.jobs.kinds import TASK, TaskParams
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, StorageError
from desirepath.store.models import Job, TaskFile
from desirepath.store.outbox import ENDED, enqueue_job
from desirepath_experiments.reproduction.driver import chapter_named
from desirepath_experiments.reproduction.tasks import (
    Countdown,
    Function,
    OnTask,
    Task,
    TaskResult,
    Work,
    computed,
    from_bytes,
    in_order,
    to_bytes,
)

POLL_S = 0.25
SWEEP_PRIORITY = 30  # after everything that somebody started by hand


class SweepError(RuntimeError):
    """A task of a sweep failed on a worker; says which job and why. Finished tasks stay."""


def waiting(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Wait for `seconds`, which costs no processor."""
    time.sleep(float(params["seconds"]))
    return TaskResult({"number": params["number"]}, {})


def summed(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The sum of the numbers of the tasks that it needs."""
    return TaskResult({"sum": sum(int(need.meta["number"]) for need in needs)}, {})


TRIAL: dict[str, Function] = {"waiting": waiting, "summed": summed}
"""Tasks that stand for a chapter's where only the queue is of interest: they wait, and add up who has waited."""


def do_task(context: JobContext, params: TaskParams) -> dict[str, Any]:
    """On a worker: compute one task, once, and store what it came to under its key."""
    with context.database.session() as s:
        known = s.get(TaskFile, params.key)
    if known is not None and context.files.exists(known.sha256):
        return {"task": params.key, "file": known.sha256, "computed": False}
    functions = TRIAL if params.chapter == "trial" else chapter_named(params.chapter).functions
    needs = [_result(context, key) for key in params.needs]
    result = computed(functions, params.function, params.params, needs)
    sha = context.files.put(to_bytes(result))
    with context.database.transaction() as s:
        s.merge(TaskFile(key=params.key, sha256=sha, job_id=context.job.id))
    return {"task": params.key, "file": sha, "computed": True, "seconds": result.meta["made"]["seconds"]}


def _result(context: JobContext, key: str) -> TaskResult:
    with context.database.session() as s:
        row = s.get(TaskFile, key)
    if row is None:
        raise LookupError(f"the task needs {key}, which no worker has computed; start the sweep again")
    return from_bytes(context.files.get(row.sha256))


class Queue:
    """Where the tasks of one chapter are computed: the workers of an installation."""

    def __init__(self, chapter: str, database: Database, files: ArtefactStore, *, created_by: str) -> None:
        self._chapter, self._database, self._files, self._by = chapter, database, files, created_by
        self._mine: set[str] = set()
        self._there: set[str] = set()  # files that were seen in the store

    def finish(self, tasks: Sequence[Task], work: Work, *, on_task: OnTask, workers: int = 1) -> int:
        """Have everything computed that is not in `work` yet and bring it there; returns how much that was.

        workers: how many work beside each other, for telling how long it will take. What is under way on the queue
        already is waited for. Raises SweepError; a database or a store that is away for a while is waited for.
        """
        missing = {task.key: task for task in in_order(tasks) if not work.has(task)}
        todo = len(missing)
        countdown = Countdown(list(missing.values()), workers, on_task)
        while missing:
            with suppress(StorageError, SQLAlchemyError):
                self._hand_out(missing, work)
                for key, sha in self._find_finished(list(missing)).items():
                    content = self._files.get(sha)
                    work.store_bytes(key, content)
                    countdown.count(missing.pop(key), float(from_bytes(content).meta["made"]["seconds"]))
            if missing:
                time.sleep(POLL_S)
        return todo

    def _find_finished(self, keys: list[str]) -> dict[str, str]:
        """The files of tasks that are computed, by key. One whose file is gone is computed again."""
        with self._database.session() as s:
            rows = s.execute(select(TaskFile.key, TaskFile.sha256).where(TaskFile.key.in_(keys)))
            written = {row.key: row.sha256 for row in rows}
        self._there |= {sha for sha in written.values() if sha not in self._there and self._files.exists(sha)}
        return {key: sha for key, sha in written.items() if sha in self._there}

    def _hand_out(self, missing: dict[str, Task], work: Work) -> None:
        """Queue every task that can begin and is not queued; the longest first."""
        keys = [key for task in missing.values() for key in (task.key, *(need.key for need in task.needs))]
        finished = self._find_finished(keys)
        for task in missing.values():
            for need in task.needs:
                if need.key not in finished and work.has(need):  # computed by this machine before
                    finished[need.key] = self._hand_up(need, work)
        ready = [
            task for task in missing.values() if task.key not in finished and all(n.key in finished for n in task.needs)
        ]
        with self._database.transaction() as s:
            jobs = s.scalars(select(Job).where(Job.kind == TASK, Job.params["key"].as_string().in_(list(missing))))
            newest = {str(job.params["key"]): job for job in sorted(jobs, key=lambda job: job.created_at)}
            # Asked after the jobs: one that ended in between has left its file.
            done = self._find_finished(list(missing))
            for task in sorted(ready, key=lambda task: -task.seconds):
                if task.key in done:
                    continue
                job = newest.get(task.key)
                if job is not None and job.id in self._mine and job.state in ("failed", "cancelled"):
                    raise SweepError(f"job {job.id} ({task.key}) {job.state}: {job.error or job.message}")
                if job is None or job.state in ENDED:
                    params = TaskParams(
                        chapter=self._chapter,
                        key=task.key,
                        function=task.kind,
                        params=task.params,
                        needs=tuple(need.key for need in task.needs),
                    )
                    job = enqueue_job(s, TASK, params.model_dump(), priority=SWEEP_PRIORITY, created_by=self._by)
                self._mine.add(job.id)

    def _hand_up(self, task: Task, work: Work) -> str:
        sha = self._files.put(work.path(task.key).read_bytes())
        with self._database.transaction() as s:
            s.merge(TaskFile(key=task.key, sha256=sha))
        return sha
