"""The API of speaking aloud: parts of a recording come in while somebody speaks, and can be taken back."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from desirepath.store.models import utc_now
from desirepath.study import voices
from desirepath.study.kinds.think_aloud import ThinkAloudStep
from desirepath.study.refusals import Refused
from desirepath.study.session.finding import acting
from desirepath.web.core.dependencies import Services, TheServices
from desirepath.web.participant.session_view import current_step

router = APIRouter()  # included in participant.router, which keeps guessers out
WEBM = "audio/webm"
MOST_PARTS = 10_000
WHAT_COMES = {"requestBody": {"content": {WEBM: {"schema": {"type": "string", "format": "binary"}}}, "required": True}}


@router.post("/api/session/{token}/voice/{key}", status_code=204, openapi_extra=WHAT_COMES)
async def part(
    token: str, key: str, request: Request, services: TheServices, part: Annotated[int, Query(ge=0, le=MOST_PARTS)]
) -> Response:
    """Add a part to what is being recorded at the step; part 0 begins anew."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != WEBM:
        raise Refused(415, "bad_value", f"a recording is sent as {WEBM}")
    content = await request.body()  # bounded before every route: `core/guard.py`
    await run_in_threadpool(_add, services, token, key, part, content)
    return Response(status_code=204)


def _add(services: Services, token: str, key: str, part: int, content: bytes) -> None:
    now = utc_now()
    with acting(services.database, token, request="voice", now=now) as (s, session):
        step = current_step(session, key, ThinkAloudStep)
        _, replaced = voices.add_part(s, services.files, session, key, step.minutes, part, content, now)
    if replaced is not None:
        services.files.delete(replaced)
