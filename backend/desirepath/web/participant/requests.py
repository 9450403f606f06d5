"""Who asks too often, and how a refusal is shown. What a request may bring is `sent.py`'s.

Routes live in `recruiting.py`, `session_pages.py`, `trials.py`, `stroke_requests.py` and `stream.py`.
"""

from __future__ import annotations

import asyncio

from fastapi import Request
from starlette.responses import JSONResponse, Response

from desirepath.store.models import utc_now
from desirepath.study.links import token_hash
from desirepath.study.refusals import Refused, log_refusal
from desirepath.study.session.finding import find_session
from desirepath.study.studies import study_by_link
from desirepath.web.core.contract import is_json
from desirepath.web.core.dependencies import contact, page, services_of
from desirepath.web.core.throttle import CHANGES_PER_SESSION, REFUSALS_PER_ADDRESS, count, is_exhausted, network_of


async def not_too_often(request: Request) -> None:
    """Bound what one link may change, and refuse links that lead nowhere once an address asked for many of them; links
    that lead somewhere stay open to all."""
    if services_of(request).notices.shared:  # counts are in the database
        await asyncio.to_thread(_check_count, request)
        return
    if _counted(request):
        await asyncio.to_thread(_check_link, request)


def _check_count(request: Request) -> None:
    if _counted(request):
        _check_link(request)


def _counted(request: Request) -> bool:
    """Count a change, if it is one; whether the link has to be looked at. Raises Refused."""
    token = request.path_params.get("token")
    if token and request.method == "POST" and not count(request, CHANGES_PER_SESSION, "change", token_hash(token)):
        raise too_many()
    return is_exhausted(request, REFUSALS_PER_ADDRESS, "refused", network_of(request))


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


def refusal_page(request: Request, problem: Exception) -> Response:
    """A Refused as the page (people) or JSON (scripts) that says what happened."""
    assert isinstance(problem, Refused)  # noqa: S101  registered for this class only
    services = services_of(request)
    asks_for_json = request.url.path.startswith("/api/") or is_json(request.headers.get("content-type"))
    joining = request.url.path.startswith(
        "/join/"
    )  # everything on a session's own path was logged where it was refused
    if problem.code != "too_many" and (joining or problem.code == "unknown"):
        counted = count(request, REFUSALS_PER_ADDRESS, "refused", network_of(request))
        if joining and counted:
            log_refusal(services.database, problem, request="join")
    if asks_for_json:
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
