"""Puts jobs into the database, in the transaction that causes them. Starting them is the worker's (`backend/jobs`)."""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session

from backend.store.database import shared_now
from backend.store.models import Job, utc_now

PARTICIPANT_WAITS = 1  # priority of a job that somebody in a session waits for
ENDED = ("succeeded", "failed", "cancelled")


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
