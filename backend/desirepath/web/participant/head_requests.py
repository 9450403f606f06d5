"""The API of heads in headsets: parts of a recording come in while a headset is worn."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from desirepath.store.models import utc_now
from desirepath.study.session.finding import acting
from desirepath.study.session.head_poses import Part, keep_part
from desirepath.web.core.dependencies import TheServices
from desirepath.web.participant.sent import HeadMoved

router = APIRouter()  # included in participant.router, which keeps guessers out


@router.post("/api/session/{token}/head/{key}", status_code=204)
def head(token: str, key: str, services: TheServices, body: HeadMoved) -> Response:
    """Keep a part, once however often it comes."""
    sent = Part(body.wearing, body.part, body.began_s, body.playing_s, body.playback_id, body.times_s, body.poses)
    with acting(services.database, token, request="head", now=utc_now()) as (s, session):
        keep_part(s, session, key, sent)
    return Response(status_code=204)
