"""What participants' requests bring, made safe to store: JSON, request ids, browsers' clocks; and who asks too often.

Routes live in `recruiting.py`, `participant.py`, `participant_trials.py` and `participant_stream.py`.
"""

from __future__ import annotations

import asyncio
import json
import math
from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import Body, Request
from pydantic import AfterValidator
from starlette.responses import JSONResponse, Response

from backend.api.core.dependencies import contact, page, services_of
from backend.api.core.throttle import REFUSALS_PER_ADDRESS, address_of, count, exhausted
from backend.store.models import utc_now
from backend.study.refusals import Refused, log_refusal
from backend.study.session.finding import find_session
from backend.study.studies import study_by_link


async def not_guessing(request: Request) -> None:
    """Refuse links that lead nowhere once an address asked for many; those that lead somewhere stay open to all."""
    if exhausted(request, REFUSALS_PER_ADDRESS, "refused", address_of(request)):
        await asyncio.to_thread(_check_link, request)


def _check_link(request: Request) -> None:
    try:
        with services_of(request).database.session() as s:
            if "token" in request.path_params:
                find_session(s, request.path_params["token"], now=utc_now(), lock=False)
            elif "recruiting_token" in request.path_params:
                study_by_link(s, request.path_params["recruiting_token"])
    except Refused as refused:
        if refused.code == "unknown":
            raise too_many() from None


def too_many() -> Refused:
    """429; such refusals are not logged, or the log would be what a flood fills."""
    return Refused(429, "too_many", "Too many requests from here; wait a minute and try again.")


def storable(value: Any) -> Any:
    """JSON as every database and file keeps it: half characters (a cut emoji) as "?", no NUL, no NaN.

    Python's JSON lets them in, and a single one in the append-only log would stop all exports of its study.
    """
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode().replace("\0", "")
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, list):
        return [storable(inner) for inner in value]
    if isinstance(value, dict):
        return {storable(key): storable(inner) for key, inner in value.items()}
    return value


DEVICE_FIELDS = (
    "width",
    "height",
    "pixel_ratio",
    "pointer",
    "touch",
    "webgl",
    "scheme",
    "reduced_motion",
    "frame_rate",
)
LONGEST_DEVICE_VALUE = 40
Json = Annotated[dict[str, Any], Body(), AfterValidator(storable)]


def request_id_of(body: dict[str, Any]) -> str:
    given = body.get("request_id")
    if not isinstance(given, str) or not 8 <= len(given) <= 64:
        raise Refused(
            422, "bad_value", "must be a text of 8 to 64 characters, another one per answer", field="request_id"
        )
    return given


def client_time_of(given: Any) -> datetime | None:
    """The browser's clock, where it says something that is a time with a zone."""
    try:
        told = datetime.fromisoformat(given) if isinstance(given, str) else None
    except ValueError:
        return None
    return told if told is not None and told.tzinfo is not None else None


def told_device(given: Any) -> dict[str, Any]:
    """What the device check told, only the fields we know."""
    if isinstance(given, str):
        try:
            given = storable(json.loads(given))
        except ValueError:
            given = None
    if not isinstance(given, dict):
        return {}
    known = {field: given[field] for field in DEVICE_FIELDS if isinstance(given.get(field), str | int | float | bool)}
    return {field: value[:LONGEST_DEVICE_VALUE] if isinstance(value, str) else value for field, value in known.items()}


def side_of(body: dict[str, Any]) -> Literal["a", "b"]:
    """Which trajectory of a pair; pages loaded before an update of the server call it `drive`."""
    given = body.get("side", body.get("drive"))
    if given == "a":
        return "a"
    if given == "b":
        return "b"
    raise Refused(422, "bad_value", "must be 'a' or 'b'", field="side", value=str(given)[:20])


def refusal_page(request: Request, problem: Exception) -> Response:
    """A Refused as the page (people) or JSON (scripts) that says what happened."""
    assert isinstance(problem, Refused)  # noqa: S101  registered for this class only
    services = services_of(request)
    wants_json = request.url.path.startswith("/api/") or request.headers.get("content-type", "").startswith(
        "application/json"
    )
    joining = request.url.path.startswith(
        "/join/"
    )  # everything on a session's own path was logged where it was refused
    if problem.code != "too_many" and (joining or problem.code == "unknown"):
        counted = count(request, REFUSALS_PER_ADDRESS, "refused", address_of(request))
        if joining and counted:
            log_refusal(services.database, problem, request="join")
    if wants_json:
        return JSONResponse(problem.as_dict(), problem.status)
    languages = services.texts.languages
    return page(
        request,
        "participant/refusal.html",
        language=services.texts.best(request.headers.get("Accept-Language"), languages),
        status=problem.status,
        code=problem.code,
        contact=contact(request),
    )
