"""The durable queue behind jobs, and the only place that knows DBOS. What a job does lives in `runners.py`.

One workflow per job, its id the job's id, so that nothing starts twice or never. A worker that is killed leaves its
workflow pending; the next one under the same executor id takes up the interrupted step and none before it.
DBOS keeps one engine per process.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from enum import StrEnum
from functools import partial

from dbos import DBOS, DBOSConfig, SetEnqueueOptions, SetWorkflowID, WorkflowStatus
from sqlalchemy import make_url

from desirepath.store.outbox import Queue

# The shape of the workflow below, not the product's version: a job that an older release began is taken up by a newer
# one as long as the steps and their order stay the same. Raise it when they change.
WORKFLOW_VERSION = "1"
# Seconds between two looks of a queue while something runs; each costs 3 ms of processor time. What is submitted here
# is taken up at once where there is room for it.
INSTANT_POLL_S = 0.25  # a participant is waiting for a policy that takes a second
TRAINING_POLL_S = 0.5  # half a minute of training follows
IDLE_POLL_S = 10.0  # while nothing runs: for what another worker submitted
STILL_BUSY_S = 5.0  # after a job: DBOS counts it as running for a moment longer
UNUSED_SCHEDULE_S = 3_600.0

MOST_ATTEMPTS = 2  # of a job whose process crashes
MOST_SUBMITTED = 3  # of one job, each after the engine ended it without a result

Attempt = Callable[[str, int], str]
Conclude = Callable[[str, str], None]


class EngineState(StrEnum):
    """What the engine knows of a job."""

    UNKNOWN = "unknown"
    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"


class Engine:
    """Runs jobs, each exactly once as far as anybody can see.

    Args:
        url: SQLAlchemy URL of DBOS's own tables.
        executor_id: name of this worker, the same after a restart.
        processes: trainings at once, per queue.
        attempt: `(job id, number of the attempt from 1) -> outcome`; "crashed" asks for one more attempt. It must be
            safe to call again after a kill in its middle.
        conclude: `(job id, outcome of the last attempt)`, called once all attempts are over.
    """

    def __init__(self, url: str, *, executor_id: str, processes: int, attempt: Attempt, conclude: Conclude) -> None:
        _use_wal(url)
        self._processes = processes
        self._pause = _Pause()
        self._dbos = DBOS(
            config=DBOSConfig(
                name="desirepath",
                system_database_url=url,
                executor_id=executor_id,
                application_version=WORKFLOW_VERSION,
                log_level="WARNING",
                enable_otlp=False,
                use_listen_notify=False,
                scheduler_polling_interval_sec=UNUSED_SCHEDULE_S,
            )
        )

        @DBOS.step(name="attempt")
        def one_attempt(job_id: str, number: int) -> str:
            return attempt(job_id, number)

        @DBOS.step(name="conclude")
        def concluded(job_id: str, outcome: str) -> None:
            conclude(job_id, outcome)

        @DBOS.workflow(name="job")
        def job(job_id: str) -> str:
            with self._pause.busy():
                outcome = "crashed"
                for number in range(1, MOST_ATTEMPTS + 1):
                    outcome = one_attempt(job_id, number)
                    if outcome != "crashed":
                        break
                concluded(job_id, outcome)
                return outcome

        self._job = job

    def start(self) -> None:
        """Begin to take up work: first what a killed worker of this executor id left behind."""
        DBOS.launch()
        # Two loops look for messages between workflows and for delayed ones: we have none.
        self._dbos._sys_db._run_background_processes = False
        self._dbos._background_jobs_stop_event.set()
        for stop in self._dbos.background_thread_stop_events:
            stop.wait = partial(self._pause.wait, stop)  # type: ignore[method-assign]
        for queue in Queue:
            DBOS.register_queue(
                queue.value,
                worker_concurrency=self._processes,
                polling_interval_sec=INSTANT_POLL_S if queue is Queue.INSTANT else TRAINING_POLL_S,
                on_conflict="always_update",
            )
        self._pause.end()

    def submit(self, job_id: str, *, queue: Queue, priority: int) -> None:
        """Queue a job; smaller priorities first. Submitting the same job again changes nothing."""
        with SetWorkflowID(job_id), SetEnqueueOptions(priority=max(1, priority)):
            DBOS.enqueue_workflow(queue.value, self._job, job_id)
        self._pause.end()

    def submit_again(self, job_id: str, *, queue: Queue, priority: int) -> bool:
        """Queue a job again that the engine ended without a result, as when its own tables were away for long. False
        where that was done `MOST_SUBMITTED` times."""
        for number in range(2, MOST_SUBMITTED + 1):
            if DBOS.get_workflow_status(_workflow(job_id, number)) is None:
                with SetWorkflowID(_workflow(job_id, number)), SetEnqueueOptions(priority=max(1, priority)):
                    DBOS.enqueue_workflow(queue.value, self._job, job_id)
                self._pause.end()
                return True
        return False

    def resume(self, job_id: str, *, queue: Queue) -> None:
        """Take up a job whose worker is gone for good."""
        DBOS.resume_workflow(self._newest(job_id)[0], queue_name=queue.value)
        self._pause.end()

    def state(self, job_id: str) -> EngineState:
        """Where the engine has the job."""
        status = self._newest(job_id)[1]
        if status is None:
            return EngineState.UNKNOWN
        if status.status in ("ENQUEUED", "DELAYED"):
            return EngineState.WAITING
        return EngineState.RUNNING if status.status == "PENDING" else EngineState.ENDED

    def _newest(self, job_id: str) -> tuple[str, WorkflowStatus | None]:
        """The job's latest workflow and how it stands."""
        newest = _workflow(job_id, 1), DBOS.get_workflow_status(_workflow(job_id, 1))
        for number in range(2, MOST_SUBMITTED + 1):
            status = DBOS.get_workflow_status(_workflow(job_id, number)) if newest[1] is not None else None
            if status is None:
                break
            newest = _workflow(job_id, number), status
        return newest

    def stop(self) -> None:
        """Let go of everything; what runs is taken up by the next start."""
        for stop in self._dbos.background_thread_stop_events:
            stop.set()
        self._pause.end()
        DBOS.destroy(destroy_registry=True)


class _Pause:
    """What DBOS's threads wait in between two looks: as long as they ask for while a job runs, longer while none does,
    and not at all once something changes. DBOS itself only polls."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._changes = 0
        self._running = 0
        self._busy_until = 0.0
        self._seen = threading.local()  # what each thread has looked after

    def wait(self, stop: threading.Event, timeout: float) -> bool:
        """In the place of `stop.wait(timeout)`: whether the thread is to end."""
        with self._changed:
            is_busy = self._running > 0 or time.monotonic() < self._busy_until
            seen = getattr(self._seen, "changes", None)
            self._changed.wait_for(
                lambda: stop.is_set() or self._changes != seen, timeout if is_busy else max(timeout, IDLE_POLL_S)
            )
            self._seen.changes = self._changes
        return stop.is_set()

    def end(self, *, running: int = 0) -> None:
        """There is something to look for. running: change of the number of running jobs."""
        with self._changed:
            self._changes += 1
            self._running += running
            self._busy_until = time.monotonic() + STILL_BUSY_S
            self._changed.notify_all()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """A job runs in the block."""
        self.end(running=1)
        try:
            yield
        finally:
            self.end(running=-1)


def _workflow(job_id: str, number: int) -> str:
    """The id of a job's workflow: the job's own for the first."""
    return job_id if number == 1 else f"{job_id}.{number}"


def _use_wal(url: str) -> None:
    """Readers and the queue's writers must not block each other; the mode stays in the file."""
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite" and parsed.database:
        with closing(sqlite3.connect(parsed.database, timeout=30)) as connection:
            connection.execute("PRAGMA journal_mode=WAL")
