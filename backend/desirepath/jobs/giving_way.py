"""Which running training gives way to another: whoever waits in front of a screen is first.

What it does while it gives way is `context.py`'s; which queue a job stands in `store/outbox.py`'s.
"""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.jobs.leases import is_silent
from desirepath.store.database import shared_now
from desirepath.store.job_results import Learned
from desirepath.store.models import Job, JobAttempt
from desirepath.store.outbox import ENDED, REFINES, Queue, is_instant, queue_of


def must_give_way(s: Session, job_id: str, processes: int) -> bool:
    """Whether a running training has to pause: it runs behind, and its worker has as many that go first as it may run
    at once. processes: that number."""
    job = s.get(Job, job_id)
    if job is None or queue_of(job) is not Queue.BEHIND or _is_waited_for(s, job):
        return False
    now = shared_now(s)
    beside = s.scalars(
        select(Job)
        .join(JobAttempt, JobAttempt.id == Job.held_by)
        .where(JobAttempt.worker == select(JobAttempt.worker).where(JobAttempt.id == job.held_by).scalar_subquery())
        .where(Job.state == "running", Job.session_id.is_not(None), Job.id != job.id)
    )
    first = [other for other in beside if not is_silent(other, now) and _goes_before(other, job)]
    return len(first) >= processes


def _goes_before(first: Job, other: Job) -> bool:
    queue = queue_of(first)
    if queue is Queue.BEHIND:
        return (first.priority, first.created_at, first.id) < (other.priority, other.created_at, other.id)
    return queue is Queue.PARTICIPANTS


def _is_waited_for(s: Session, job: Job) -> bool:
    """Whether the policy that it was to be better than cannot be shown: then somebody may wait for this one."""
    if job.priority > REFINES:
        return False
    same = select(Job).where(Job.session_id == job.session_id, Job.kind == job.kind, Job.id != job.id)
    return any(
        other.state in ENDED and not ((learned := other.result_as(Learned)) and learned.passed)
        for other in s.scalars(same)
        if is_instant(other) and other.params.get("snapshot") == job.params.get("snapshot")
    )
