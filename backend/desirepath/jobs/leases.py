"""Who may write how a job ends: the attempt that holds it. Taking a job up, being heard of, letting it go.

Workers stand on several machines and share the database alone. One whose machine is gone says nothing any more; another
takes its jobs up, and should the first come back, what it does counts no more. Silence is told by the database's clock,
which they share, not by their own.
"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TypeGuard

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from desirepath.jobs.heartbeat import silent_s
from desirepath.store.database import shared_now
from desirepath.store.models import Job, JobAttempt, WorkerProcess
from desirepath.store.outbox import ENDED

STALE_AFTER = timedelta(seconds=12)  # six missed heartbeats
KEPT_LOG_BYTES = 6_000  # of each attempt's log, for pages on other machines
WORKER_ROWS_KEPT = timedelta(days=7)


@dataclass(frozen=True)
class WorkerName:
    """A worker: `id` tells it from all others and is the same after a restart; machine: what people call it."""

    id: str
    machine: str


def this_process() -> WorkerName:
    """The name of a worker that has no place in a data folder."""
    return WorkerName(platform.node(), platform.node())


def begin_attempt(s: Session, job: Job, worker: WorkerName) -> str:
    """This worker holds the job from now on, whoever held it before. Returns the attempt's id."""
    now = shared_now(s)
    left = update(JobAttempt).where(JobAttempt.job_id == job.id, JobAttempt.ended_at.is_(None))
    s.execute(left.values(ended_at=job.heartbeat_at or now, outcome="lost"))
    attempt = JobAttempt(job_id=job.id, worker=worker.id, machine=worker.machine, began_at=now)
    s.add(attempt)
    s.flush()
    job.held_by, job.heartbeat_at = attempt.id, now
    return attempt.id


def holds(job: Job | None, attempt: str | None) -> TypeGuard[Job]:
    """Whether that attempt may still write about the job. None: one of before attempts were written down."""
    return job is not None and job.held_by == attempt


def end_attempt(s: Session, attempt: str, outcome: str, log: str) -> None:
    """Write down how an attempt ended, unless another has ended it by taking the job up."""
    row = s.get(JobAttempt, attempt)
    if row is None:  # the job was erased
        return
    if row.ended_at is None:
        row.ended_at, row.outcome = shared_now(s), outcome
    row.log = log.replace("\0", "")


def attempts_at(s: Session, job_id: str) -> list[JobAttempt]:
    """Every attempt at a job, first one first."""
    return list(s.scalars(select(JobAttempt).where(JobAttempt.job_id == job_id).order_by(JobAttempt.began_at)))


def kept_log(attempts: list[JobAttempt]) -> str:
    """The ends of the logs of all attempts, where the whole one lies on other machines; each says whose it is."""
    return "\n".join(
        f"[{attempt.machine}, {attempt.worker}]\n{attempt.log.rstrip()}" for attempt in attempts if attempt.log
    )


def say_under_way(s: Session, job: Job) -> None:
    """Write down that the job's attempt lives."""
    job.heartbeat_at = shared_now(s)


def is_silent(job: Job, now: datetime) -> bool:
    """Whether nobody says any more that the job is under way. now: by `shared_now`."""
    return job.state not in ENDED and now - (job.heartbeat_at or job.created_at) >= STALE_AFTER


def claim_silent(s: Session, job_id: str) -> bool:
    """Whether this worker is the one that takes a silent job up: of several that look, the first."""
    job = s.get(Job, job_id, with_for_update=True, populate_existing=True)
    if job is None or not is_silent(job, shared_now(s)):
        return False
    say_under_way(s, job)
    return True


def say_alive(s: Session, worker: WorkerName, trainings: int) -> None:
    """Write down that a worker lives; one that was silent for a week is forgotten."""
    now = shared_now(s)
    row = s.get(WorkerProcess, worker.id)
    if row is None:
        s.add(WorkerProcess(id=worker.id, machine=worker.machine, trainings=trainings, started_at=now, seen_at=now))
    else:
        row.machine, row.trainings, row.seen_at = worker.machine, trainings, now
    for old in s.scalars(select(WorkerProcess).where(WorkerProcess.seen_at < now - WORKER_ROWS_KEPT)):
        s.delete(old)


def newest_sign_s(s: Session) -> float | None:
    """Seconds since any worker, on whichever machine, said that it lives; None where none ever did."""
    newest = s.scalar(select(WorkerProcess.seen_at).order_by(WorkerProcess.seen_at.desc()).limit(1))
    return None if newest is None else max(0.0, (shared_now(s) - newest).total_seconds())


def workers_silent_s(data: Path, s: Session) -> float | None:
    """Seconds since any worker said that it lives: in the database, or by its file in this data folder, which one whose
    database is busy goes on touching. None where none ever did."""
    signs = (newest_sign_s(s), silent_s(data))
    return min((sign for sign in signs if sign is not None), default=None)
