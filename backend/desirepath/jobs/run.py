"""The training process: `python -m desirepath.jobs.run WORKER_PID [JOB_ID ATTEMPT]` does one job, writes how it ended.

Without a job it stands ready, reads ids of jobs and attempts from its standard input and says each job's exit code on
its standard output. Started by `process.py`; everything that is printed while a job is done goes into the job's log.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.giving_way import must_give_way
from desirepath.jobs.kinds import TaskParams, get_kind
from desirepath.jobs.leases import end_attempt, holds
from desirepath.jobs.process import FINAL_STATES, ExitCode, finish, log_file, patiently, wait_for_end_of
from desirepath.os_errors import in_words
from desirepath.registries import find_offer
from desirepath.settings import Settings, get_settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, DatabaseBusy, is_full
from desirepath.store.job_results import JobResult
from desirepath.store.models import Job
from desirepath.store.outbox import Queue, enqueue_job, queue_of
from desirepath.store.places import StoreAway

TASKS = "desirepath.tasks"  # the group of entry points that do tasks of a sweep
MEASURED_KINDS = ("align", "train_base")
MEASURED_IN = {"each_scene": {"scenes": 200}, "each_scene_trained": {"scenes": 200}}
"""By recipe: each scene costs two dozen rollouts there."""
MEASURING_PRIORITY = 20  # after everything that somebody started
# whoever waits goes first; the server goes before all
NICENESS = {Queue.INSTANT: 2, Queue.PARTICIPANTS: 2, Queue.BEHIND: 6, Queue.ANALYSTS: 10}


def main(worker_pid: int, job_id: str | None = None, attempt: str = "") -> ExitCode:
    """Do the job given, or one after another as they come, until the worker ends."""
    threading.Thread(target=_end_with_worker, args=(worker_pid,), daemon=True).start()
    settings = get_settings()
    if job_id is not None:
        _log_into(log_file(settings, job_id))
        return do(settings, job_id, attempt)
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as worker:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing but exit codes goes to the worker
        os.nice(NICENESS[Queue.INSTANT])  # who has just joined waits for the first page meanwhile
        load()
        while line := sys.stdin.readline().split():
            _log_into(log_file(settings, line[0]))
            print(int(do(settings, *line)), file=worker, flush=True)
    return ExitCode.DONE


def do(settings: Settings, job_id: str, attempt: str = "") -> ExitCode:
    """Do the job. Returns the exit code; the row holds the rest, as long as that attempt holds the job. What passes (a
    database or a store of files that is away, a full disk) ends no job."""
    try:
        return _do(settings, job_id, attempt or None)
    except Exception as problem:
        if not _passes(problem):
            raise
        with contextlib.suppress(OSError):  # the log's disk may be the full one
            print(f"cannot work just now: {in_words(problem)}", flush=True)
        return ExitCode.AGAIN


def _passes(problem: Exception) -> bool:
    return isinstance(problem, DatabaseBusy | StoreAway) or is_full(problem)


def _do(settings: Settings, job_id: str, attempt: str | None) -> ExitCode:
    database, files = Database(settings.database), ArtefactStore(settings.artefacts)
    with _only_one(settings, job_id):
        with database.session() as s:
            job = s.get(Job, job_id)
            if job is None or job.state in FINAL_STATES or not holds(job, attempt):
                return ExitCode.DONE
        queue = queue_of(job)
        os.nice(NICENESS[queue] - os.nice(0))
        print(f"{job.kind} {job_id} begins", flush=True)
        progress = Progress(database, job_id, attempt)
        if queue is Queue.BEHIND:
            progress.must_pause = lambda s: must_give_way(s, job_id, settings.training_processes)
        began = time.monotonic()
        try:
            progress.give_way()
            result = _work(JobContext(settings, database, files, job, progress))
        except Exception as problem:
            if _passes(problem):
                raise
            traceback.print_exc()
            patiently(progress.write)
            return patiently(functools.partial(_fail, database, job_id, attempt, problem))
        patiently(progress.write)
        print(f"worked for {time.monotonic() - began:.1f} s", flush=True)
        try:
            patiently(lambda: _keep(database, job_id, attempt, result))
        except ValidationError as problem:  # whatever else hinders it, the job is tried again
            traceback.print_exc()
            return patiently(functools.partial(_fail, database, job_id, attempt, problem))
        return ExitCode.DONE


def _keep(database: Database, job_id: str, attempt: str | None, result: dict[str, object]) -> None:
    """Raises pydantic's ValidationError for what that kind of job does not result in."""
    with database.transaction() as s:
        row = s.get(Job, job_id, with_for_update=True)
        if row is not None and row.state not in FINAL_STATES and holds(row, attempt):
            if row.state == "cancelling":
                finish(row, "cancelled")
            else:
                row.keep_result(result)
                finish(row, "succeeded")
                _measure_later(s, row)
            _end_attempt(s, row, attempt)


def load() -> None:
    """Import torch and numba and compile a rollout, which takes seconds. What fails here fails again in the job, which
    writes it down."""
    with contextlib.suppress(Exception):
        import desirepath.jobs.runners  # noqa: F401
        from desirepath.learning.scene_sets import Purpose, scene_set
        from desirepath.simulation.fast import evaluate
        from desirepath.simulation.setups import SETUPS

        for setup in SETUPS.values():
            scene = scene_set(setup.name, 1, purpose=Purpose.FIGURE, seed=0)
            evaluate(lambda observations: np.ones((len(observations), 2), dtype=np.float32), setup, scene)


def _log_into(file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("ab") as out:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
            os.dup2(out.fileno(), stream.fileno())


def _work(context: JobContext) -> dict[str, object]:
    params = get_kind(context.job.kind).parse(context.job.params)
    # Imported late, so that its failure is written to the row, too.
    if isinstance(params, TaskParams):
        return _do_task(context, params)
    from desirepath.jobs.runners import run_kind

    return run_kind(context, params)


def _do_task(context: JobContext, params: TaskParams) -> dict[str, object]:
    """A task of a sweep, done by whoever plugs in. Raises LookupError where nobody does."""
    lacking = "tasks of a sweep are done by desirepath-experiments, which this worker has not installed"
    done: dict[str, object] = find_offer(TASKS, lacking)(context, params)
    return done


def _measure_later(s: DatabaseSession, job: Job) -> None:
    """A policy's card wants success and distances with intervals; who waits for the policy does not wait for them."""
    policy = getattr(job.result_as(JobResult), "policy", None)
    if job.kind in MEASURED_KINDS and policy:
        enqueue_job(
            s,
            "evaluate",
            {"policy": policy, **MEASURED_IN.get(str(job.params.get("recipe")), {})},
            priority=MEASURING_PRIORITY,
            study_id=job.study_id,
            created_by=job.created_by,
        )


def _fail(database: Database, job_id: str, attempt: str | None, problem: Exception) -> ExitCode:
    """Write a readable error: the sentence of errors meant for people, the type besides for all others."""
    meant_for_people = isinstance(problem, ValueError | LookupError | OSError) and not isinstance(
        problem, ValidationError | KeyError | IndexError
    )
    text = in_words(problem) if meant_for_people else f"{type(problem).__name__}: {problem}"
    with database.transaction() as s:
        job = s.get(Job, job_id, with_for_update=True)
        if job is not None and job.state not in FINAL_STATES and holds(job, attempt):
            job.error = text
            finish(job, "cancelled" if job.state == "cancelling" else "failed")
            _end_attempt(s, job, attempt)
    return ExitCode.FAILED


def _end_attempt(s: DatabaseSession, job: Job, attempt: str | None) -> None:
    """In the transaction of the job's end: the worker may be killed before it writes that down."""
    if attempt is not None:
        end_attempt(s, attempt, job.state, "")


def _end_with_worker(worker_pid: int) -> None:
    """A killed worker cannot end us, and the next one will start the job again: so end when ours is gone."""
    wait_for_end_of(worker_pid)
    os._exit(ExitCode.ORPHANED)


@contextmanager
def _only_one(settings: Settings, job_id: str) -> Iterator[None]:
    """Hold the job's log file, so that an orphan that has not noticed yet and its successor never overlap."""
    with log_file(settings, job_id).open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    ended = main(int(sys.argv[1]), *sys.argv[2:4])
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:  # on a full disk Python would end with a code of its own
        os._exit(ended)
    sys.exit(ended)
