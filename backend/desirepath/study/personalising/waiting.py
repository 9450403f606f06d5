"""How long somebody in front of the waiting page will still wait: who is before them, and what trainings usually take.

An estimate, recomputed at every look: of what has been learned here before, and of how far the trainings under way are.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from statistics import median
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.database import shared_now
from desirepath.store.models import Job, JobAttempt, WorkerProcess
from desirepath.store.outbox import ENDED, queue_of
from desirepath.study.personalising import alignment_jobs

if TYPE_CHECKING:
    from desirepath.study.kind import Moment

USUAL_S = {
    "instant": 5.0,
    "each_scene": 10.0,
    "conditioning_search": 60.0,
    "each_scene_trained": 45.0,
    "places": 15.0,
    "depth": 85.0,
}
"""Where nothing of that sort was learned here yet: experiments/notebook, processor seconds of one core."""
OTHERWISE_USUAL_S = 90.0
LAST_ONES = 20  # ours: of so many trainings of one sort the median
KNOWN_FOR_S = 30.0
HEARD_OF = timedelta(seconds=45)  # workers say every 15 s that they live
TOLD_FROM = 0.1  # of a training: its own pace counts from there on
LEAST_S = 1.0  # of what is under way: nobody knows better in its last second


@dataclass(frozen=True)
class Waiting:
    """before: other sessions whose training comes first. running: theirs is under way. seconds: until it is ready, None
    where no worker lives. at_most: seconds until the session goes on without. share: of the whole wait, what is over.
    """

    before: int
    running: bool
    seconds: float | None
    at_most: float
    share: float

    def as_news(self) -> dict[str, Any]:
        """As the page is told it, no finer than it is known."""
        return {
            "progress": round(self.share, 3),
            "before": self.before,
            "running": self.running,
            "seconds": _round(self.seconds) if self.seconds is not None else None,
            "at_most": _round(self.at_most),
            "done": False,
        }


def waiting_of(moment: Moment) -> Waiting | None:
    """None where nothing is being learned that the session waits for."""
    s, session, training = moment.s, moment.session, moment.frozen.training
    awaited = alignment_jobs.find_awaited_jobs(s, session)
    if training is None or not awaited:
        return None
    since, patience = alignment_jobs.patience_of(moment)
    waited = max(0.0, (moment.now - since).total_seconds())
    queues, workers = _find_unfinished(s), _trainings_at_once(s)
    ends = [_ends(s, queues[queue_of(job)], max(1, workers)) for job in awaited]
    seconds = max(end[job.id] for end, job in zip(ends, awaited, strict=True))
    last = max(awaited, key=lambda job: (job.created_at, job.id))
    ahead = queues[queue_of(last)]
    before = {job.session_id for job in ahead[: [job.id for job in ahead].index(last.id)]} - {session.id}
    return Waiting(
        before=len(before) if last.state == "queued" else 0,
        running=any(job.state == "running" for job in awaited),
        seconds=seconds if workers else None,
        at_most=max(0.0, patience.total_seconds() - waited),
        share=waited / (waited + seconds) if workers else 0.0,
    )


def _find_unfinished(s: DatabaseSession) -> Mapping[str, list[Job]]:
    """Trainings of all sessions by queue, in the order in which they are taken up."""
    by_queue: dict[str, list[Job]] = {}
    for job in s.scalars(select(Job).where(Job.state.not_in(ENDED), Job.session_id.is_not(None))):
        by_queue.setdefault(queue_of(job), []).append(job)
    for of_queue in by_queue.values():
        of_queue.sort(key=lambda job: (job.state == "queued", job.priority, job.created_at, job.id))
    return by_queue


def _trainings_at_once(s: DatabaseSession) -> int:
    """Of all workers that live."""
    living = select(func.sum(WorkerProcess.trainings)).where(WorkerProcess.seen_at >= shared_now(s) - HEARD_OF)
    return int(s.scalar(living) or 0)


def _ends(s: DatabaseSession, queue: Sequence[Job], at_once: int) -> dict[str, float]:
    """In how many seconds each of a queue's trainings will have ended."""
    free = [0.0] * at_once
    ends = {}
    for job in queue:
        left = _usual_s(s, job) if job.state == "queued" else _left_s(s, job)
        ends[job.id] = free[0] + left
        heapq.heapreplace(free, ends[job.id])
    return ends


def _left_s(s: DatabaseSession, job: Job) -> float:
    """Of a training under way: as long as its like takes, and the further it is the more by its own pace."""
    attempt = s.get(JobAttempt, job.held_by) if job.held_by is not None else None
    gone = (shared_now(s) - attempt.began_at).total_seconds() if attempt is not None else 0.0
    whole = _usual_s(s, job)
    if job.progress >= TOLD_FROM:
        whole = (1 - job.progress) * whole + gone
    return max(LEAST_S, whole - gone)


_known: dict[tuple[str, ...], tuple[float, float]] = {}  # what is usual, and until when that is believed


def _sort_of(kind: str, params: Mapping[str, Any]) -> str:
    """By which recipe, or by which sensor, it learns."""
    return str(params.get("recipe") or params.get("sensor") or kind)


def _usual_s(s: DatabaseSession, job: Job) -> float:
    """How long a training of that sort takes: the median of the last ones here."""
    sort = _sort_of(job.kind, job.params)
    key = (str(s.get_bind().engine.url), job.kind, sort)
    usual, until = _known.get(key, (0.0, 0.0))
    if time.monotonic() >= until:
        done = s.execute(
            select(Job.started_at, Job.finished_at, Job.params)
            .where(Job.kind == job.kind, Job.state == "succeeded", Job.session_id.is_not(None))
            .order_by(Job.finished_at.desc())
            .limit(3 * LAST_ONES)
        )
        took = [
            (finished - started).total_seconds()
            for started, finished, params in done
            if started and finished and _sort_of(job.kind, params) == sort
        ]
        usual = median(took[:LAST_ONES]) if took else USUAL_S.get(sort, OTHERWISE_USUAL_S)
        _known[key] = (usual, time.monotonic() + KNOWN_FOR_S)
    return usual


def _round(seconds: float) -> int:
    """To 1 s below 20, to 5 s below two minutes, to half minutes above, always up."""
    step = 1 if seconds < 20 else 5 if seconds < 120 else 30
    return int(-(-seconds // step) * step)
