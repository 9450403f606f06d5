"""The videos of a trial: where a participant's page finds them, and only the one that is being shown."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from desirepath.store.sides import is_side, shown_on
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.web.core.dependencies import TheServices
from desirepath.web.core.videos import ANSWERS, video_of, video_response
from desirepath.web.participant.session_view import looking

router = APIRouter()  # included in participant.router, which keeps guessers out


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
