"""The durable queue behind jobs, and the only place that knows DBOS. What a job does lives in `runners.py`.

One workflow per job, its id the job's id, so that nothing starts twice or never. A worker that is killed leaves its
workflow pending; the next one under the same executor id takes up the interrupted step and none before it.
DBOS keeps one engine per process.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from enum import StrEnum

from dbos import DBOS, DBOSConfig, SetEnqueueOptions, SetWorkflowID, WorkflowStatus
from sqlalchemy import make_url

from desirepath.store.outbox import Queue

# The shape of the workflow below, not the product's version: a job that an older release began is taken up by a newer
# one as long as the steps and their order stay the same. Raise it when they change.
WORKFLOW_VERSION = "1"
# Seconds between two looks of a queue; each costs 3 ms of processor time, also where nothing is ever queued.
INSTANT_POLL_S = 0.25  # a participant is waiting for a policy that takes a second
TRAINING_POLL_S = 0.5  # half a minute of training follows

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
        attempts: how many attempts a crashing job gets.
    """

    def __init__(
        self, url: str, *, executor_id: str, processes: int, attempt: Attempt, conclude: Conclude, attempts: int = 2
    ) -> None:
        _use_wal(url)
        self._processes = processes
        DBOS(
            config=DBOSConfig(
                name="desirepath",
                system_database_url=url,
                executor_id=executor_id,
                application_version=WORKFLOW_VERSION,
                log_level="WARNING",
                enable_otlp=False,
                use_listen_notify=False,
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
            outcome = "crashed"
            for number in range(1, attempts + 1):
                outcome = one_attempt(job_id, number)
                if outcome != "crashed":
                    break
            concluded(job_id, outcome)
            return outcome

        self._job = job

    def start(self) -> None:
        """Begin to take up work: first what a killed worker of this executor id left behind."""
        DBOS.launch()
        for queue in Queue:
            DBOS.register_queue(
                queue.value,
                worker_concurrency=self._processes,
                polling_interval_sec=INSTANT_POLL_S if queue is Queue.INSTANT else TRAINING_POLL_S,
                on_conflict="always_update",
            )

    def submit(self, job_id: str, *, queue: Queue, priority: int) -> None:
        """Queue a job; smaller priorities first. Submitting the same job again changes nothing."""
        with SetWorkflowID(job_id), SetEnqueueOptions(priority=max(1, priority)):
            DBOS.enqueue_workflow(queue.value, self._job, job_id)

    def submit_again(self, job_id: str, *, queue: Queue, priority: int) -> bool:
        """Queue a job anew that the engine ended without a result, as when its own tables were away for long. False
        where that was done `MOST_SUBMITTED` times."""
        for number in range(2, MOST_SUBMITTED + 1):
            if DBOS.get_workflow_status(_workflow(job_id, number)) is None:
                with SetWorkflowID(_workflow(job_id, number)), SetEnqueueOptions(priority=max(1, priority)):
                    DBOS.enqueue_workflow(queue.value, self._job, job_id)
                return True
        return False

    def resume(self, job_id: str, *, queue: Queue) -> None:
        """Take up a job whose worker is gone for good."""
        DBOS.resume_workflow(self._newest(job_id)[0], queue_name=queue.value)

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
        DBOS.destroy(destroy_registry=True)


def _workflow(job_id: str, number: int) -> str:
    """The id of a job's workflow: the job's own for the first."""
    return job_id if number == 1 else f"{job_id}.{number}"


def _use_wal(url: str) -> None:
    """Readers and the queue's writers must not block each other; the mode stays in the file."""
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite" and parsed.database:
        with closing(sqlite3.connect(parsed.database, timeout=30)) as connection:
            connection.execute("PRAGMA journal_mode=WAL")
