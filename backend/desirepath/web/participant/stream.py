"""The stream of a session's page: server-sent events that say "look again", how far a job is, or "another window"."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import suppress
from datetime import timedelta
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import Response, StreamingResponse
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.database import DatabaseBusy
from desirepath.store.models import Session, utc_now
from desirepath.study import robots
from desirepath.study.drawing import paths
from desirepath.study.kind import kind_of
from desirepath.study.kinds.demonstration import DemonstrationStep
from desirepath.study.kinds.robot_drive import RobotDriveStep
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.web.core.dependencies import Services, services_of
from desirepath.web.participant.session_view import looking
from desirepath.web.stage.listening import Listener

router = APIRouter()  # included in participant.router, which keeps guessers out

STREAM_LOOK_S = 5.0  # how often a stream looks by itself; changes made in this process wake it at once
STREAM_WAIT_LOOK_S = 0.7  # while somebody waits for a job, whose progress comes from another process
SEEN_EVERY = timedelta(seconds=20)


@router.get(
    "/api/session/{token}/stream", response_class=Response, responses={200: {"content": {"text/event-stream": {}}}}
)
async def stream(token: str, request: Request) -> StreamingResponse:
    """Server-sent events: `state` (look again), `job` (progress while waiting), `moved` (another window took over)."""
    services = services_of(request)
    first = await asyncio.to_thread(_glance, services, token)
    listener = services.listeners.listen(first.session_id)
    return StreamingResponse(
        _tell(services, token, first, listener),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


class _Glance:
    """What a stream compares: where the session stands, and how far its job is while somebody waits for it."""

    def __init__(self, s: DatabaseSession, session: Session) -> None:
        self.session_id = session.id
        step = machine.step_of(session)
        trial = machine.trial_of(s, session) if kind_of(step).shows == "trajectories" else None
        shown: tuple[object, ...] | None = (trial.phase, trial.restarts) if trial is not None else None
        if isinstance(step, DemonstrationStep):
            stroke = paths.latest_stroke(s, session.id, step.key)
            shown = (stroke.attempt, stroke.state, stroke.shown_since) if stroke is not None else None
        if isinstance(step, RobotDriveStep):
            run = robots.run_at(s, session, step.key)
            shown = (run.state, run.robot_id, run.moved_at) if run is not None else None
        self.state = (session.state, session.position, shown)
        self.position = session.position
        self.waiting = kind_of(step).goes_on and session.state == "active"
        self.job: dict[str, Any] | None = None
        if self.waiting:
            waiting = machine.waiting(s, session, now=utc_now())
            self.job = waiting.as_news() if waiting is not None else {"progress": 0.0, "done": False}


def _glance(services: Services, token: str) -> _Glance:
    with looking(services, token) as (s, session):
        glance = _Glance(s, session)
        unseen = session.last_seen_at is None or utc_now() - session.last_seen_at > SEEN_EVERY
    if unseen:
        with suppress(DatabaseBusy), acting(services.database, token, request="stream", now=utc_now(), durable=False):
            pass  # `acting` notes when the session was last seen; a busy database is told at the next look
    return glance


async def _tell(services: Services, token: str, before: _Glance, listener: Listener) -> AsyncIterator[str]:
    try:
        yield _event("state", {})  # whatever happened before the stream was open
        if before.job:
            yield _event("job", before.job)
        while True:
            await listener.wait(STREAM_WAIT_LOOK_S if before.waiting else STREAM_LOOK_S)
            if listener.taken_over:
                yield _event("moved", {"reason": "other_window"})
                return
            try:
                now = await asyncio.to_thread(_glance, services, token)
            except Refused:
                yield _event("moved", {"reason": "step"})
                return
            if now.job and now.job != before.job:
                yield _event("job", now.job)
            if before.waiting and now.position != before.position:
                yield _event("job", {"progress": 1.0, "done": True})
            if now.state != before.state:
                yield _event("state", {})
            else:
                yield ": still here\n\n"
            before = now
    finally:
        services.listeners.leave(before.session_id, listener)


def _event(name: str, data: dict[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n"
