"""The API of a trial: start, a trajectory was seen or interrupted, again. Each change is committed, then played; the
video that is being shown."""

from __future__ import annotations

import base64
from collections.abc import Callable
from datetime import datetime
from functools import partial

from fastapi import APIRouter, Request
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.store.models import Session, utc_now
from desirepath.store.sides import is_side, shown_on
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.web.core.contract import reply_of
from desirepath.web.core.dependencies import TheServices, services_of
from desirepath.web.core.videos import ANSWERS, video_of, video_response
from desirepath.web.participant.replies import SessionState, TrialData
from desirepath.web.participant.sent import Interrupted, Seen, Start
from desirepath.web.participant.session_view import looking, state_of, videos_of

router = APIRouter()  # included in participant.router, which keeps guessers out
changing = partial(router.post, response_model=SessionState)


@changing("/api/session/{token}/trials/{key}/start")
def start(token: str, key: str, request: Request, body: Start) -> Response:
    """Play the first trajectory that was not seen yet."""

    def act(s: DatabaseSession, session: Session, now: datetime) -> machine.Playback | None:
        services = services_of(request)
        waits = not session.simulated and not services.presenter.is_connected(session.id)
        if waits and videos_of(services.files, s, session, request) is None:
            raise Refused(
                409,
                "stage_not_ready",
                "The picture is not there yet.",
                session_id=session.id,
                study_id=session.study_id,
            )
        return machine.start_trial(s, session, key, request_id=body.request_id, now=now)

    return _on_trial(request, token, "start", act)


@changing("/api/session/{token}/trials/{key}/seen")
def seen(token: str, key: str, request: Request, body: Seen) -> Response:
    """The stage reported that a trajectory has been watched to its end."""
    return _on_trial(
        request,
        token,
        "seen",
        lambda s, session, now: machine.trajectory_seen(
            s,
            session,
            key,
            body.side,
            body.playback_id,
            headset=body.headset.model_dump() if body.headset is not None else None,
            now=now,
        ),
    )


@changing("/api/session/{token}/trials/{key}/again")
def again(token: str, key: str, request: Request) -> Response:
    """Play both trajectories once more, where the protocol allows it."""
    return _on_trial(request, token, "again", lambda s, session, now: machine.watch_again(s, session, key, now=now))


@changing("/api/session/{token}/trials/{key}/interrupted")
def interrupted(token: str, key: str, request: Request, body: Interrupted) -> Response:
    """A trajectory could not be watched: hidden tab (that one again), lost picture or connection (the trial again)."""

    def act(s: DatabaseSession, session: Session, now: datetime) -> None:
        if machine.step_of(session).key == key:
            again = machine.restart_trajectory if body.reason == "hidden" else machine.interrupt
            again(s, session, reason=body.reason, now=now)

    return _on_trial(request, token, "interrupted", act, afresh=True)


def _on_trial(
    request: Request,
    token: str,
    asked: str,
    act: Callable[[DatabaseSession, Session, datetime], machine.Playback | None],
    *,
    afresh: bool = False,
) -> Response:
    """One change of a trial: commit it, then play what it says, then tell the page's stream.

    Watching is no answer: if the power fails, the trial starts over, so nobody waits for the disk here.
    """
    services = services_of(request)
    now = utc_now()
    with acting(services.database, token, request=asked, now=now, durable=False) as (s, session):
        playback = act(s, session, now)
        reply = state_of(request, s, session, machine.current(s, session))
    if playback is not None:
        services.presenter.play(session.id, playback)
    elif afresh:
        services.presenter.show(session.id, afresh=True)
    services.listeners.tell_changed(session.id)
    return reply_of(SessionState, reply)


@router.get("/api/session/{token}/trial-data", response_model=TrialData)
def trial_data(token: str, services: TheServices) -> Response:
    """The trajectories of the current trial as NPZ in base64, for oracles; simulated sessions only."""
    with looking(services, token) as (s, session):
        if not session.simulated:
            raise Refused(
                403, "simulated_only", "Only simulated sessions may read trajectories.", session_id=session.id
            )
        trial = machine.trial_of(s, session)
        if trial is None:
            raise Refused(409, "no_trial", "The current step is no trial.", session_id=session.id)
        shown = trial.shown
    return reply_of(TrialData, {"shown": [base64.b64encode(services.files.get(one)).decode() for one in shown]})


@router.get("/api/session/{token}/trials/{key}/video/{side}", response_class=Response, responses=ANSWERS)
def video(token: str, key: str, side: str, request: Request, services: TheServices) -> Response:
    """The video that is being shown, by ranges. Another one of the session comes when it is its turn."""
    with looking(services, token) as (s, session):
        whose = {"session_id": session.id, "study_id": session.study_id}
        trial = machine.trial_of(s, session) if machine.step_of(session).key == key else None
        shown = None
        if trial is not None and is_side(side) and session.state == "active" and trial.phase == f"playing_{side}":
            shown = video_of(s, services.files, shown_on(side, trial.trajectory_a, trial.trajectory_b))
    if shown is None:
        raise Refused(409, "not_playing", "This video is not being shown.", **whose)
    return video_response(request, services.files, shown)
