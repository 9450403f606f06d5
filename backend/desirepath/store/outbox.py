"""Puts jobs into the database, in the transaction that causes them, and says which queue each stands in. Starting them
is the worker's (`backend/desirepath/jobs`)."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from sqlalchemy.orm import Session

from desirepath.store.database import shared_now
from desirepath.store.models import Job, utc_now
from desirepath.store.worker_signals import Signal, signal_workers

PARTICIPANT_WAITS = 1  # priority of a job that somebody in a session waits for; all after it give way to those
REFINES = 2  # of one that looks for something better than what somebody sees already
NOBODY_WAITS = 5  # ours: of a session's whose pages show nothing of it, and of simulated participants
ENDED = ("succeeded", "failed", "cancelled")


class Queue(StrEnum):
    """Lanes that never wait for each other: policies that are there at once, those that somebody in a session waits
    for, what runs behind them (searches for a better one, simulated participants'), and what analysts start."""

    INSTANT = "instant"
    PARTICIPANTS = "participants"
    BEHIND = "behind"
    ANALYSTS = "analysts"


IN_SECONDS = "each_scene"  # a recipe that trains nothing, and takes a few


def is_instant(job: Job) -> bool:
    """Is it a session's, and there within seconds?"""
    recipe = job.params.get("recipe")
    soon = recipe == "instant" or (recipe == IN_SECONDS and job.priority <= PARTICIPANT_WAITS)
    return job.session_id is not None and soon


def queue_of(job: Job) -> Queue:
    """A job of a session does not queue behind an analyst's, one that takes a second not behind a training, and none
    that somebody waits for behind one that nobody does."""
    if not job.session_id:
        return Queue.ANALYSTS
    if is_instant(job):
        return Queue.INSTANT
    return Queue.PARTICIPANTS if job.priority <= PARTICIPANT_WAITS else Queue.BEHIND


def enqueue_job(
    s: Session,
    kind: str,
    params: dict[str, Any],
    *,
    priority: int = 10,
    study_id: str | None = None,
    session_id: str | None = None,
    created_by: str | None = None,
    retry_of: str | None = None,
) -> Job:
    """Write the job's row; a worker picks it up once the transaction has committed. Smaller priority goes first."""
    job = Job(
        kind=kind,
        params=params,
        priority=priority,
        study_id=study_id,
        session_id=session_id,
        created_by=created_by,
        retry_of=retry_of,
        created_at=shared_now(s),  # workers tell by it how long nobody has taken it up
    )
    s.add(job)
    s.flush()
    signal_workers(s, Signal.JOB_QUEUED)
    return job


def cancel_job(s: Session, job_id: str, *, by: str) -> Job:
    """Ask a job to stop: a queued one is cancelled at once, a running one when its worker has ended it.

    Raises LookupError if there is none, ValueError if it has ended already.
    """
    job = s.get(Job, job_id, with_for_update=True)
    if job is None:
        raise LookupError(f"no job with id {job_id!r}")
    if job.state in ENDED:
        raise ValueError(f"job {job_id} has ended already: {job.state}")
    job.message = f"cancelled by {by}"
    if job.state == "queued":
        job.state, job.finished_at = "cancelled", utc_now()
    else:
        job.state = "cancelling"
    return job
