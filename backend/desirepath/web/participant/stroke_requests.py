"""The API of drawing: a stroke comes in, its rollout is shown, seen, interrupted or taken back.

Keeping a path is the step's answer, `session_pages.py`'s. What a stroke may be is `study/drawing/strokes.py`'s,
what the stage shows `drawing_sheet.py`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fastapi import APIRouter, Request
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.store.models import Session, StrokeRow, utc_now
from desirepath.study.drawing import paths, strokes, walks
from desirepath.study.drawing.walks import Walked
from desirepath.study.kinds.demonstration import DemonstrationStep
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.devices import headset_required
from desirepath.study.session.finding import acting
from desirepath.web.core.contract import reply_of
from desirepath.web.core.dependencies import Services, services_of
from desirepath.web.participant.replies import DrawingReply
from desirepath.web.participant.sent import Interrupted, RolloutSeen, StrokeSent, WalkAgain
from desirepath.web.participant.session_view import current_step, looking, state_of

router = APIRouter()  # included in participant.router, which keeps guessers out
changing = partial(router.post, response_model=DrawingReply)


@changing("/api/session/{token}/drawing/{key}/stroke")
def stroke(token: str, key: str, request: Request, body: StrokeSent) -> Response:
    """Store a drawn path; one that can be driven is driven at once. `problem` says kindly why another cannot."""
    services = services_of(request)
    with looking(services, token) as (_, session):
        step = _step(session, key)
        if not session.simulated and not services.presenter.is_connected(session.id):
            raise Refused(409, "stage_not_ready", "The picture is not there yet.", session_id=session.id)
        simulated = session.simulated
    attempt = strokes.attempt_of(
        step, body.model_dump(exclude_unset=True), simulated=simulated
    )  # outside any transaction: it computes

    def act(s: DatabaseSession, session: Session) -> StrokeRow:
        return strokes.add_stroke(
            s,
            services.files,
            session,
            step,
            attempt,
            request_id=body.request_id,
            client_time=body.client_time,
            now=utc_now(),
            must_wear=headset_required(s, session),
        )

    return _on_drawing(request, token, key, "stroke", act)


@changing("/api/session/{token}/drawing/{key}/rollout")
def roll_out(token: str, key: str, request: Request) -> Response:
    """Let the robot drive the path, again if it did before."""
    return _on_drawing(
        request,
        token,
        key,
        "rollout",
        lambda s, session: strokes.roll_out(s, session, _step(session, key), now=utc_now()),
    )


@changing("/api/session/{token}/drawing/{key}/rollout-seen")
def rollout_seen(token: str, key: str, request: Request, body: RolloutSeen) -> Response:
    """The stage reported that the rollout has been watched to its end."""
    services, playback = services_of(request), body.playback_id
    walked = _walked(services, token, key, body.walk.model_dump()) if body.walk is not None else None

    def act(s: DatabaseSession, session: Session) -> StrokeRow:
        return strokes.mark_watched(
            s,
            services.files,
            session,
            _step(session, key),
            playback,
            walked,
            now=utc_now(),
            headset=body.headset.model_dump() if body.headset is not None else None,
            must_wear=headset_required(s, session),
        )

    return _on_drawing(request, token, key, "rollout_seen", act)


def _walked(services: Services, token: str, key: str, given: object) -> Walked | None:
    """What was walked beside the rollout that is shown; made outside any transaction, as it computes."""
    with looking(services, token) as (s, session):
        step = _step(session, key)
        stroke = paths.latest_stroke(s, session.id, key)
        if stroke is None or not paths.is_walked(step, stroke):
            return None
        drawn, beside, simulated = stroke.drawn, stroke.trajectory, session.simulated
    return walks.combine_with_walk(paths.scene_of(step), drawn, beside, given, simulated=simulated)


@changing("/api/session/{token}/drawing/{key}/walk")
def walk(token: str, key: str, request: Request, body: WalkAgain) -> Response:
    """Walk once more beside the rollout of the path that is there."""

    def act(s: DatabaseSession, session: Session) -> StrokeRow:
        return strokes.walk_again(s, session, _step(session, key), request_id=body.request_id, now=utc_now())

    return _on_drawing(request, token, key, "walk", act)


@changing("/api/session/{token}/drawing/{key}/interrupted")
def interrupted(token: str, key: str, request: Request, body: Interrupted) -> Response:
    """The rollout could not be watched to its end; the path stays, and can be driven again."""

    def act(s: DatabaseSession, session: Session) -> None:
        strokes.interrupt(s, session, _step(session, key), reason=body.reason)

    return _on_drawing(request, token, key, "interrupted", act, afresh=True)


@changing("/api/session/{token}/drawing/{key}/redraw")
def redraw(token: str, key: str, request: Request) -> Response:
    """Take the path back and draw another one."""

    def act(s: DatabaseSession, session: Session) -> None:
        strokes.redraw(s, session, _step(session, key))

    return _on_drawing(request, token, key, "redraw", act, afresh=True)


def _step(session: Session, key: str) -> DemonstrationStep:
    """The session's current step, if it is that one and a path is drawn at it."""
    return current_step(session, key, DemonstrationStep)


def _on_drawing(
    request: Request,
    token: str,
    key: str,
    asked: str,
    act: Callable[[DatabaseSession, Session], StrokeRow | None],
    *,
    afresh: bool = False,
) -> Response:
    """One change of a drawing: commit it, then roll out what it says, then tell the page's stream."""
    services = services_of(request)
    with acting(services.database, token, request=asked, now=utc_now()) as (s, session):
        step = _step(session, key)
        row = act(s, session)
        s.flush()
        shown = paths.showing(step, row)
        reply = state_of(request, s, session, machine.current(s, session))
        if row is not None:
            reply["problem"] = row.problem if row.state == "refused" else None
    if shown is not None:
        services.presenter.play_stroke(session.id, shown)
    elif afresh or paths.has_met_person(row):
        services.presenter.show(session.id)
    services.listeners.tell_changed(session.id)
    return reply_of(DrawingReply, reply)
