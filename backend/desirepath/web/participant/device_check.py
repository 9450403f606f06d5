"""Going on in a browser that a session has not been in: its device is looked at first, as at joining.

What a device must have is `study/session/devices.py`'s; the first check, before anything is stored, is the welcome
page's (`recruiting.py`).
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Form, Request
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.models import Session, utc_now
from desirepath.study.refusals import Refused
from desirepath.study.session import appointments, devices
from desirepath.study.session.finding import acting
from desirepath.study.session.versions import protocol_of
from desirepath.web.core.dependencies import contact, page, services_of
from desirepath.web.participant.sent import known_device

router = APIRouter()  # included in participant.router, which keeps guessers out
COOKIE = "desirepath_device_"


def remember(request: Request, response: Response, session: Session) -> None:
    """Note in this browser that its device was looked at for that session."""
    response.set_cookie(
        f"{COOKIE}{session.id[:8]}",
        "looked-at",
        max_age=max(0, int((session.expires_at - utc_now()).total_seconds())),
        path="/p",
        httponly=True,
        samesite="lax",
        secure=request.url.scheme == "https",
    )


def is_wanted(s: DatabaseSession, request: Request, session: Session) -> bool:
    """Whether this browser's device has to be looked at: another one was measured before, and there is more to do."""
    if session.simulated or session.state not in ("active", "paused") or not appointments.is_open(session):
        return False
    return f"{COOKIE}{session.id[:8]}" not in request.cookies and devices.was_measured(s, session)


def check_page(request: Request, s: DatabaseSession, session: Session, token: str) -> Response:
    """The check; nothing of the session changes by it."""
    frozen = protocol_of(s, session)
    context: dict[str, Any] = {
        "study_title": frozen.title(session.language),
        "contact": frozen.protocol.contact or contact(request),
        "action": f"/p/{token}/device",
        "device": frozen.protocol.asked_of_devices.model_dump(),
    }
    return page(request, "participant/device.html", language=session.language, **context)


@router.post("/p/{token}/device")
def check(token: str, request: Request, device: Annotated[str, Form()] = "") -> Response:
    """What the page measured; the session goes on with it, or the study cannot be shown here."""
    response = RedirectResponse(f"/p/{token}", status_code=303)
    with acting(services_of(request).database, token, request="device", now=utc_now()) as (s, session):
        try:
            devices.change_device(s, session, protocol_of(s, session).protocol.device, known_device(device))
        except Refused as refused:
            refused.code, refused.session_id = "other_device", session.id
            raise
        remember(request, response, session)
    return response
