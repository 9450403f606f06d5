"""A session's pages, its answers, and pausing or leaving it.

Each route hands what came in to the session machine and shows what it says. No rule of a study lives here. Joining,
trials and the stream have files of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.events import log_event
from desirepath.store.models import Participant, Session, utc_now
from desirepath.store.models import Response as Answer
from desirepath.study.kind import Page, kind_of, read_plan
from desirepath.study.kinds.consent import ConsentStep
from desirepath.study.links import token_hash
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.session.versions import protocol_of
from desirepath.web.core.addresses import permissions
from desirepath.web.core.contract import reply_of
from desirepath.web.core.dependencies import TheServices, contact, page, services_of, stage_origin
from desirepath.web.core.throttle import EVENTS_PER_SESSION, PROBLEMS_PER_SESSION, count
from desirepath.web.participant import (
    device_check,
    head_requests,
    live_requests,
    recruiting,
    robot_requests,
    stream,
    stroke_requests,
    trials,
    voice_requests,
)
from desirepath.web.participant.replies import Answered, SessionState
from desirepath.web.participant.requests import not_too_often, too_many
from desirepath.web.participant.sent import Noticed, ProblemReport
from desirepath.web.participant.session_view import looking, page_context, state_of
from desirepath.web.participant.steps import AnswerSent
from desirepath.web.stage.admission import stage_cookie

router = APIRouter(dependencies=[Depends(not_too_often)])


# ---- pages --------------------------------------------------------------------------------------------------------


@router.get("/p/{token}")
def session_page(token: str, request: Request) -> Response:
    """The whole page at the current step. A trajectory that an older page was playing is not seen any more."""
    services = services_of(request)
    now = utc_now()
    with acting(services.database, token, request="page", now=now) as (s, session):
        if device_check.is_wanted(s, request, session):
            return device_check.check_page(request, s, session, token)
        reloaded = machine.interrupt(s, session, reason="page_loaded", now=now)
        machine.settle(s, services.files, session, now=now)
        name, value = stage_cookie(session)
        context = page_context(request, s, session, token)
    if reloaded:
        services.presenter.show(session.id, afresh=True)
        services.listeners.tell_changed(session.id)
    response = page(request, "participant/session.html", language=session.language, **context)
    response.set_cookie(name, value, path="/stage", httponly=True, samesite="lax", secure=request.url.scheme == "https")
    response.headers["X-Step-Key"] = context["step"].key
    room = stage_origin(request) if context["headset"] else None
    response.headers["Permissions-Policy"] = permissions(speaks=context["speaks"], room=room)
    return response


@router.post("/p/{token}/language")
def change_language(token: str, services: TheServices, language: Annotated[str, Form()] = "") -> Response:
    """Go on in another language; the page is loaded anew."""
    with acting(services.database, token, request="language", now=utc_now()) as (s, session):
        machine.change_language(s, session, language)
    return RedirectResponse(f"/p/{token}", status_code=303)


@router.get("/p/{token}/step")
def step_fragment(token: str, request: Request) -> Response:
    """The current step alone, to be swapped into the page."""
    with looking(services_of(request), token) as (s, session):
        context = page_context(request, s, session, token)
    response = page(request, "participant/step.html", language=session.language, **context)
    response.headers["X-Step-Key"] = context["step"].key
    return response


@router.get("/p/{token}/consent")
def consent_copy(token: str, request: Request) -> Response:
    """The participant's copy of what they consented to."""
    with looking(services_of(request), token) as (s, session):
        frozen = protocol_of(s, session)
        step = next(step for step in read_plan(session.plan) if isinstance(step, ConsentStep))
        theirs = select(Session.id).where(Session.participant_id == session.participant_id)  # of every appointment
        asked = select(Answer).where(Answer.session_id.in_(theirs), Answer.kind == "consent")
        given = s.scalars(asked.order_by(Answer.created_at.desc())).first()
        language = _consented_in(frozen, given) or session.language
        given_at = given.created_at if given else None
        agreed = dict(given.value.get("purposes") or {}) if given else None
        code = s.get_one(Participant, session.participant_id).code
    return page(
        request,
        "participant/consent_copy.html",
        language=language,
        study_title=frozen.title(language),
        payload=kind_of(step).payload(step, Page(frozen, language)),
        given_at=given_at,
        purposes=agreed,
        code=code,
        contact=frozen.protocol.contact or contact(request),
    )


def _consented_in(frozen: FrozenProtocol, given: Answer | None) -> str | None:
    """The language whose text was agreed to, so that the copy holds those words after a change of language."""
    agreed = given.value.get("text_hash") if given else None
    return next((language for language in frozen.protocol.languages if frozen.consent_hash(language) == agreed), None)


@router.get("/p/{token}/help")
def help_page(token: str, request: Request) -> Response:
    """Whom to ask and how things work."""
    with looking(services_of(request), token) as (s, session):
        context = page_context(request, s, session, token)
    return page(request, "participant/help.html", language=session.language, **context)


# ---- the API -------------------------------------------------------------------------------------------------------


@router.get("/api/session/{token}", response_model=SessionState)
def state(token: str, request: Request) -> Response:
    """Where the session stands."""
    with looking(services_of(request), token) as (s, session):
        now = state_of(request, s, session, machine.current(s, session))
    return reply_of(SessionState, now)


@router.post("/api/session/{token}/steps/{key}", response_model=Answered)
def answer(token: str, key: str, request: Request, body: AnswerSent) -> Response:
    """Store an answer; the reply is the acknowledgement."""
    services = services_of(request)
    now = utc_now()
    with acting(services.database, token, request="answer", now=now) as (s, session):
        submitted = machine.submit(
            s,
            services.files,
            session,
            key,
            body.value,
            request_id=body.request_id,
            client_time=body.client_time,
            now=now,
            named=body.kind,
        )
        reply = state_of(request, s, session, machine.current(s, session))
    if not submitted.duplicate:
        services.presenter.show(session.id)
        services.listeners.tell_changed(session.id)
    return reply_of(Answered, {"accepted": True, "duplicate": submitted.duplicate, **reply})


@router.post("/api/session/{token}/events", status_code=204)
def page_event(token: str, request: Request, services: TheServices, body: Noticed) -> Response:
    """Something the page noticed: into the log, with the browser's own time."""
    if not count(request, EVENTS_PER_SESSION, "page_event", token_hash(token)):
        raise too_many()
    with acting(services.database, token, request="event", now=utc_now()) as (s, session):
        log_event(
            s,
            f"page_{body.kind}",
            session_id=session.id,
            client_time=body.client_time,
            step=machine.step_of(session).key,
            page=body.data,
        )
    return Response(status_code=204)


@router.post("/api/session/{token}/pause", response_model=SessionState)
def pause(token: str, request: Request) -> Response:
    """Stop for now; the link stays valid."""
    return _change(request, token, "pause", lambda s, session, now: machine.pause(s, session, now=now))


@router.post("/api/session/{token}/resume", response_model=SessionState)
def resume(token: str, request: Request) -> Response:
    """Go on."""
    return _change(request, token, "resume", lambda s, session, now: machine.resume(s, session, now=now))


@router.post("/api/session/{token}/withdraw", response_model=SessionState)
def withdraw(token: str, request: Request) -> Response:
    """Leave the study for good."""
    return _change(request, token, "withdraw", lambda s, session, now: machine.withdraw(s, session, now=now))


@router.post("/api/session/{token}/problem", status_code=204)
def problem(token: str, request: Request, services: TheServices, body: ProblemReport) -> Response:
    """Report a problem."""
    if not count(request, PROBLEMS_PER_SESSION, "problem", token_hash(token)):
        raise Refused(409, "too_many_problems", f"At most {PROBLEMS_PER_SESSION} reports are kept.", field="text")
    with acting(services.database, token, request="problem", now=utc_now()) as (s, session):
        machine.report_problem(s, session, body.text)
    return Response(status_code=204)


def _change(
    request: Request, token: str, asked: str, act: Callable[[DatabaseSession, Session, datetime], None]
) -> Response:
    services = services_of(request)
    now = utc_now()
    with acting(services.database, token, request=asked, now=now) as (s, session):
        act(s, session, now)
        reply = state_of(request, s, session, machine.current(s, session))
    services.presenter.show(session.id, afresh=True)
    services.listeners.tell_changed(session.id)
    return reply_of(SessionState, reply)


_DRIVEN = (stroke_requests, live_requests, robot_requests)
for part in (recruiting, device_check, trials, head_requests, *_DRIVEN, voice_requests, stream):
    router.include_router(part.router)
