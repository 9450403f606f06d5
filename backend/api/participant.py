"""Participants' routes: the recruiting link, the session's pages, its API and its stream.

Each route hands what came in to the session machine and shows what it says. No rule of a study lives here.
"""

from __future__ import annotations

import asyncio
import base64
import ipaddress
import json
import math
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Depends, Form, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import AfterValidator
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import JSONResponse, RedirectResponse, Response

from backend.api.dependencies import House, TheHouse, contact, house, page, stage_origin
from backend.api.stage_bridge import Listener, bridge_of, stage_cookie, stage_token
from backend.api.throttle import (
    EVENTS_PER_SESSION,
    JOINS_PER_ADDRESS,
    REFUSALS_PER_ADDRESS,
    address_of,
    count,
    exhausted,
)
from backend.store.database import DatabaseBusy
from backend.store.events import log_event
from backend.store.models import Participant, Session, Study, utc_now
from backend.store.models import Response as Answer
from backend.study import machine, personalisation
from backend.study.pages import payload_of
from backend.study.protocol import FrozenProtocol, thaw
from backend.study.refusals import Refused, log_refusal
from backend.study.sessions import acting, find_session, token_hash
from backend.study.studies import check_open, join_study, study_by_link
from backend.study.words import TRIAL_KINDS


async def _not_guessing(request: Request) -> None:
    """Refuse links that lead nowhere once an address asked for many; those that lead somewhere stay open to all."""
    if exhausted(request, REFUSALS_PER_ADDRESS, "refused", address_of(request)):
        await asyncio.to_thread(_check_link, request)


def _check_link(request: Request) -> None:
    try:
        with house(request).database.session() as s:
            if "token" in request.path_params:
                find_session(s, request.path_params["token"], now=utc_now(), lock=False)
            else:
                study_by_link(s, request.path_params["recruiting_token"])
    except Refused as refused:
        if refused.code == "unknown":
            raise _too_many() from None


def _too_many() -> Refused:
    """429; such refusals are not logged, or the log would be what a flood fills."""
    return Refused(429, "too_many", "Too many requests from here; wait a minute and try again.")


router = APIRouter(dependencies=[Depends(_not_guessing)])

PLATFORM_FIELDS = {"PROLIFIC_PID": "external_id", "STUDY_ID": "study", "SESSION_ID": "session"}
DEVICE_FIELDS = ("width", "height", "pixel_ratio", "pointer", "touch", "webgl", "scheme", "reduced_motion")
LONGEST_DEVICE_VALUE = 40
PAGE_EVENTS = {"stage_ready", "stage_slow", "visibility", "resized", "script_error", "connection", "device", "viewed"}
LARGEST_EVENT = 4000  # bytes of JSON; ours
STREAM_LOOK_S = 5.0  # how often a stream looks by itself; changes made in this process wake it at once
STREAM_WAIT_LOOK_S = 0.7  # while somebody waits for a job, whose progress comes from another process
SEEN_EVERY = timedelta(seconds=20)


def _storable(value: Any) -> Any:
    """JSON as every database and file keeps it: half characters (a cut emoji) as "?", no NUL, no NaN.

    Python's JSON lets them in, and a single one in the append-only log would stop all exports of its study.
    """
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode().replace("\0", "")
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, list):
        return [_storable(inner) for inner in value]
    if isinstance(value, dict):
        return {_storable(key): _storable(inner) for key, inner in value.items()}
    return value


Json = Annotated[dict[str, Any], Body(), AfterValidator(_storable)]


# ---- the recruiting link ---------------------------------------------------------------------------------------------


@router.get("/join/{recruiting_token}")
def welcome(recruiting_token: str, request: Request, lang: Annotated[str | None, Query()] = None) -> Response:
    """Device check and welcome; nothing is stored yet."""
    parts = house(request)
    with parts.database.session() as s:
        study = study_by_link(s, recruiting_token)
        check_open(s, study)
        frozen = thaw(study)
    languages = tuple(frozen.protocol.languages)
    best = parts.texts.best(request.headers.get("Accept-Language"), languages)
    language = lang if lang in languages else best
    here = request.url.path
    return page(
        request,
        "participant/join.html",
        language=language,
        study_title=frozen.title(language),
        languages=languages,
        recruiting={name: request.query_params[name] for name in PLATFORM_FIELDS if request.query_params.get(name)},
        contact=frozen.protocol.contact or contact(request),
        action=here,
        join_url=here,
    )


@router.post("/join/{recruiting_token}")
async def join(recruiting_token: str, request: Request) -> Response:
    """A new participant. A form is answered with the way to the session, JSON (bots) with its token."""
    is_json = request.headers.get("content-type", "").startswith("application/json")
    given = await _body(request, is_json)
    return await asyncio.to_thread(_join, recruiting_token, request, given, is_json)


async def _body(request: Request, is_json: bool) -> dict[str, Any]:
    if not is_json:
        return {key: _storable(str(value)) for key, value in (await request.form()).items()}
    try:
        given = await request.json()
    except ValueError:
        given = None
    if not isinstance(given, dict):
        raise Refused(422, "bad_value", "The body must be a JSON object.", field="body")
    cleaned: dict[str, Any] = _storable(given)
    return cleaned


def _join(recruiting_token: str, request: Request, given: dict[str, Any], is_json: bool) -> Response:
    parts = house(request)
    recruiting = {field: str(given[name]) for name, field in PLATFORM_FIELDS.items() if given.get(name)}
    simulated = is_json and given.get("simulated") is True
    if simulated and not _from_here(request):
        raise Refused(403, "bots_from_elsewhere", "Simulated participants join only from the server's own machine.")
    if not simulated and not count(request, JOINS_PER_ADDRESS, "join", address_of(request)):
        raise _too_many()
    oracle = given.get("oracle")
    with parts.database.transaction() as s:
        session, token = join_study(
            s,
            study_by_link(s, recruiting_token),
            files=parts.files,
            language=str(given.get("language", "")),
            recruiting={"platform": "prolific", **recruiting} if recruiting else None,
            device=_device(given.get("device")),
            simulated=simulated,
            oracle=oracle if isinstance(oracle, dict) else None,
        )
        code = s.get_one(Participant, session.participant_id).code
    if is_json:
        return JSONResponse({"token": token, "participant": code, "simulated": simulated}, 201)
    return RedirectResponse(f"/p/{token}", status_code=303)


def _from_here(request: Request) -> bool:
    """Whether this machine asks. A bot need not watch, so nobody who has no more than the link may be one."""
    try:
        return request.client is not None and ipaddress.ip_address(request.client.host).is_loopback
    except ValueError:
        return False


def _device(given: Any) -> dict[str, Any]:
    """What the device check told, only the fields we know."""
    if isinstance(given, str):
        try:
            given = _storable(json.loads(given))
        except ValueError:
            given = None
    if not isinstance(given, dict):
        return {}
    known = {field: given[field] for field in DEVICE_FIELDS if isinstance(given.get(field), str | int | float | bool)}
    return {field: value[:LONGEST_DEVICE_VALUE] if isinstance(value, str) else value for field, value in known.items()}


# ---- the session's pages ---------------------------------------------------------------------------------------------


@router.get("/p/{token}")
def session_page(token: str, request: Request) -> Response:
    """The whole page at the current step. A drive that an older page was playing is not seen any more."""
    parts = house(request)
    now = utc_now()
    with acting(parts.database, token, request="page", now=now) as (s, session):
        reloaded = machine.interrupted(s, session, reason="page_loaded", now=now)
        machine.settle(s, parts.files, session, now=now)
        name, value = stage_cookie(session)
        context = _context(request, s, session, token)
    if reloaded:
        bridge_of(parts).show(session.id, afresh=True)
        bridge_of(parts).changed(session.id)
    response = page(request, "participant/session.html", language=session.language, **context)
    response.set_cookie(name, value, path="/stage", httponly=True, samesite="lax", secure=request.url.scheme == "https")
    response.headers["X-Step-Key"] = context["step"].key
    return response


@router.post("/p/{token}/language")
def change_language(token: str, parts: TheHouse, language: Annotated[str, Form()] = "") -> Response:
    """Go on in another language; the page is loaded anew."""
    with acting(parts.database, token, request="language", now=utc_now()) as (s, session):
        machine.change_language(s, session, language)
    return RedirectResponse(f"/p/{token}", status_code=303)


@router.get("/p/{token}/step")
def step_fragment(token: str, request: Request) -> Response:
    """The current step alone, to be swapped into the page."""
    with _looking(house(request), token) as (s, session):
        context = _context(request, s, session, token)
    response = page(request, "participant/step.html", language=session.language, **context)
    response.headers["X-Step-Key"] = context["step"].key
    return response


@router.get("/p/{token}/consent")
def consent_copy(token: str, request: Request) -> Response:
    """The participant's copy of what they consented to."""
    with _looking(house(request), token) as (s, session):
        frozen = thaw(s.get_one(Study, session.study_id))
        step = next(step for step in session.plan if step["kind"] == "consent")
        given = s.scalar(select(Answer).where(Answer.session_id == session.id, Answer.kind == "consent"))
        language = _consented_in(frozen, given) or session.language
        given_at = given.created_at if given else None
        code = s.get_one(Participant, session.participant_id).code
    return page(
        request,
        "participant/consent_copy.html",
        language=language,
        study_title=frozen.title(language),
        payload=payload_of(frozen, step, language),
        given_at=given_at,
        code=code,
        contact=frozen.protocol.contact or contact(request),
    )


def _consented_in(frozen: FrozenProtocol, given: Answer | None) -> str | None:
    """The language whose text was agreed to, so that the copy holds those words after a change of language."""
    agreed = given.value.get("text_hash") if given else None
    return next((one for one in frozen.protocol.languages if frozen.consent_hash(one) == agreed), None)


@router.get("/p/{token}/help")
def help_page(token: str, request: Request) -> Response:
    """Whom to ask and how things work."""
    with _looking(house(request), token) as (s, session):
        context = _context(request, s, session, token)
    return page(request, "participant/help.html", language=session.language, **context)


def _context(request: Request, s: DatabaseSession, session: Session, token: str) -> dict[str, Any]:
    frozen = thaw(s.get_one(Study, session.study_id))
    view = machine.current(s, session)
    return {
        "token": token,
        "study_title": frozen.title(session.language),
        "languages": frozen.protocol.languages,
        "contact": frozen.protocol.contact or contact(request),
        "code": s.get_one(Participant, session.participant_id).code,
        "looks_around": any(step.get("view", "top_down") != "top_down" for step in session.plan),
        "step": view,
        "state": _state(request, session, view),
        "expires_at": session.expires_at,
    }


def _state(request: Request, session: Session, view: machine.StepView) -> dict[str, Any]:
    """What `GET /api/session/{token}` answers."""
    state: dict[str, Any] = {"state": session.state, "step": view.as_dict(), "language": session.language}
    if session.simulated and view.kind == "questionnaire":  # bots read no pages
        state["step"]["items"] = [item for block in view.payload["blocks"] for item in block["items"]]
    if view.kind in TRIAL_KINDS:
        state["stage_url"] = f"{stage_origin(request)}/stage/{stage_token(session)}/"
    return state


@contextmanager
def _looking(parts: House, token: str) -> Iterator[tuple[DatabaseSession, Session]]:
    """A reading transaction on the token's session, which first lets a waiting session go on. Refusals are logged."""
    try:
        with parts.database.session() as s:
            session = find_session(s, token, now=utc_now(), lock=False)
            due = _may_settle(s, session)
            if not due:
                yield s, session
        if due:
            _settle(parts, token)
            with parts.database.session() as s:
                yield s, find_session(s, token, now=utc_now(), lock=False)
    except Refused as refused:
        log_refusal(parts.database, refused, request="look")
        raise


def _may_settle(s: DatabaseSession, session: Session) -> bool:
    if session.state != "active" or machine.step_of(session)["kind"] != "wait":
        return False
    protocol = thaw(s.get_one(Study, session.study_id)).protocol
    return personalisation.outcome_of(s, session, protocol, utc_now()) is not None


def _settle(parts: House, token: str) -> None:
    now = utc_now()
    with acting(parts.database, token, request="settle", now=now) as (s, session):
        moved = machine.settle(s, parts.files, session, now=now)
    if moved:
        bridge_of(parts).changed(session.id)


# ---- the session's API -----------------------------------------------------------------------------------------------


@router.get("/api/session/{token}")
def state(token: str, request: Request) -> dict[str, Any]:
    """Where the session stands."""
    with _looking(house(request), token) as (s, session):
        return _state(request, session, machine.current(s, session))


@router.post("/api/session/{token}/steps/{key}")
def answer(token: str, key: str, request: Request, body: Json) -> dict[str, Any]:
    """Store an answer; the reply is the acknowledgement."""
    parts = house(request)
    now = utc_now()
    request_id = _request_id(body)
    client_time = _client_time(body.get("client_time"))
    with acting(parts.database, token, request="answer", now=now) as (s, session):
        submitted = machine.submit(
            s,
            parts.files,
            session,
            key,
            body.get("value") or {},
            request_id=request_id,
            client_time=client_time,
            now=now,
        )
        reply = _state(request, session, machine.current(s, session))
    if not submitted.duplicate:
        bridge_of(parts).show(session.id)
        bridge_of(parts).changed(session.id)
    return {"accepted": True, "duplicate": submitted.duplicate, **reply}


@router.post("/api/session/{token}/trials/{key}/start")
def start(token: str, key: str, request: Request, body: Json) -> dict[str, Any]:
    """Play the first drive that was not seen yet."""

    def act(s: DatabaseSession, session: Session, now: datetime) -> machine.Playback | None:
        if not session.simulated and not bridge_of(house(request)).connected(session.id):
            raise Refused(
                409,
                "stage_not_ready",
                "The picture is not there yet.",
                session_id=session.id,
                study_id=session.study_id,
            )
        return machine.start_trial(s, session, key, request_id=str(body.get("request_id", ""))[:64], now=now)

    return _on_trial(request, token, "start", act)


@router.post("/api/session/{token}/trials/{key}/seen")
def seen(token: str, key: str, request: Request, body: Json) -> dict[str, Any]:
    """The stage told the page that a drive has been watched to its end."""
    drive: Literal["a", "b"] = _drive(body.get("drive"))
    playback = body.get("playback_id")
    return _on_trial(
        request,
        token,
        "seen",
        lambda s, session, now: machine.drive_seen(s, session, key, drive, playback, now=now),
    )


@router.post("/api/session/{token}/trials/{key}/interrupted")
def interrupted(token: str, key: str, request: Request, body: Json) -> dict[str, Any]:
    """A drive could not be watched: hidden tab (that drive again), lost picture or connection (the trial again)."""
    reason = body.get("reason")
    if reason not in ("hidden", "webgl_lost", "connection"):
        raise Refused(
            422, "bad_value", "must be hidden, webgl_lost or connection", field="reason", value=str(reason)[:40]
        )

    def act(s: DatabaseSession, session: Session, now: datetime) -> None:
        if machine.step_of(session)["key"] == key:
            again = machine.restart_drive if reason == "hidden" else machine.interrupted
            again(s, session, reason=reason, now=now)

    return _on_trial(request, token, "interrupted", act, afresh=True)


def _on_trial(
    request: Request,
    token: str,
    asked: str,
    act: Callable[[DatabaseSession, Session, datetime], machine.Playback | None],
    *,
    afresh: bool = False,
) -> dict[str, Any]:
    """One change of a trial: commit it, then play what it says, then tell the page's stream."""
    parts = house(request)
    now = utc_now()
    with acting(parts.database, token, request=asked, now=now) as (s, session):
        playback = act(s, session, now)
        reply = _state(request, session, machine.current(s, session))
    bridge = bridge_of(parts)
    if playback is not None:
        bridge.play(session.id, playback)
    elif afresh:
        bridge.show(session.id, afresh=True)
    bridge.changed(session.id)
    return reply


@router.get("/api/session/{token}/trial-data")
def trial_data(token: str, parts: TheHouse) -> dict[str, str]:
    """The two drives of the current trial as NPZ in base64, for oracles; simulated sessions only."""
    with _looking(parts, token) as (s, session):
        if not session.simulated:
            raise Refused(403, "simulated_only", "Only simulated sessions may read drives.", session_id=session.id)
        trial = machine.trial_of(s, session)
        if trial is None:
            raise Refused(409, "no_trial", "The current step is no trial.", session_id=session.id)
    drives = {"a": trial.trajectory_a, "b": trial.trajectory_b}
    return {name: base64.b64encode(parts.files.get(drive)).decode() for name, drive in drives.items()}


@router.post("/api/session/{token}/events", status_code=204)
def page_event(token: str, request: Request, parts: TheHouse, body: Json) -> Response:
    """Something the page noticed: into the log, with the browser's own time."""
    if not count(request, EVENTS_PER_SESSION, "page_event", token_hash(token)):
        raise _too_many()
    kind, data = body.get("kind"), body.get("data") or {}
    if kind not in PAGE_EVENTS or not isinstance(data, dict) or len(json.dumps(data)) > LARGEST_EVENT:
        allowed = ", ".join(sorted(PAGE_EVENTS))
        raise Refused(422, "bad_value", f"must be one of {allowed} with a small object as data", field="kind")
    with acting(parts.database, token, request="event", now=utc_now()) as (s, session):
        log_event(
            s,
            f"page_{kind}",
            session_id=session.id,
            client_time=_client_time(body.get("client_time")),
            step=machine.step_of(session)["key"],
            page=data,
        )
    return Response(status_code=204)


@router.post("/api/session/{token}/pause")
def pause(token: str, request: Request) -> dict[str, Any]:
    """Stop for now; the link stays valid."""
    return _change(request, token, "pause", lambda s, session, now: machine.pause(s, session, now=now))


@router.post("/api/session/{token}/resume")
def resume(token: str, request: Request) -> dict[str, Any]:
    """Go on."""
    return _change(request, token, "resume", lambda s, session, now: machine.resume(s, session, now=now))


@router.post("/api/session/{token}/withdraw")
def withdraw(token: str, request: Request) -> dict[str, Any]:
    """Leave the study for good."""
    return _change(request, token, "withdraw", lambda s, session, now: machine.withdraw(s, session, now=now))


@router.post("/api/session/{token}/problem", status_code=204)
def problem(token: str, parts: TheHouse, body: Json) -> Response:
    """Report a problem."""
    with acting(parts.database, token, request="problem", now=utc_now()) as (s, session):
        machine.report_problem(s, session, str(body.get("text", "")))
    return Response(status_code=204)


def _change(
    request: Request, token: str, asked: str, act: Callable[[DatabaseSession, Session, datetime], None]
) -> dict[str, Any]:
    parts = house(request)
    now = utc_now()
    with acting(parts.database, token, request=asked, now=now) as (s, session):
        act(s, session, now)
        reply = _state(request, session, machine.current(s, session))
    bridge_of(parts).show(session.id, afresh=True)
    bridge_of(parts).changed(session.id)
    return reply


# ---- the stream ------------------------------------------------------------------------------------------------------


@router.get("/api/session/{token}/stream")
async def stream(token: str, request: Request) -> StreamingResponse:
    """Server-sent events: `state` (look again), `job` (progress while waiting), `moved` (another window took over)."""
    parts = house(request)
    first = await asyncio.to_thread(_glance, parts, token)
    listener = bridge_of(parts).listen(first.session_id)
    return StreamingResponse(
        _tell(parts, token, first, listener),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


class _Glance:
    """What a stream compares: where the session stands, and how far its job is while somebody waits for it."""

    def __init__(self, s: DatabaseSession, session: Session) -> None:
        self.session_id = session.id
        step = machine.step_of(session)
        trial = machine.trial_of(s, session) if step["kind"] in TRIAL_KINDS else None
        shown = (trial.phase, trial.restarts) if trial is not None else None
        self.state = (session.state, session.position, shown)
        self.position = session.position
        self.waiting = step["kind"] == "wait" and session.state == "active"
        self.job: dict[str, Any] | None = None
        if self.waiting:
            self.job = {"progress": round(personalisation.progress_of(s, session), 3), "done": False}


def _glance(parts: House, token: str) -> _Glance:
    with _looking(parts, token) as (s, session):
        glance = _Glance(s, session)
        unseen = session.last_seen_at is None or utc_now() - session.last_seen_at > SEEN_EVERY
    if unseen:
        with suppress(DatabaseBusy), acting(parts.database, token, request="stream", now=utc_now()):
            pass  # `acting` notes when the session was last seen; a busy database is told at the next look
    return glance


async def _tell(parts: House, token: str, before: _Glance, listener: Listener) -> AsyncIterator[str]:
    bridge = bridge_of(parts)
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
                now = await asyncio.to_thread(_glance, parts, token)
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
        bridge.leave(before.session_id, listener)


def _event(name: str, data: dict[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n"


# ---- what comes in ---------------------------------------------------------------------------------------------------


def _request_id(body: dict[str, Any]) -> str:
    given = body.get("request_id")
    if not isinstance(given, str) or not 8 <= len(given) <= 64:
        raise Refused(
            422, "bad_value", "must be a text of 8 to 64 characters, another one per answer", field="request_id"
        )
    return given


def _client_time(given: Any) -> datetime | None:
    """The browser's clock, where it says something that is a time with a zone."""
    try:
        told = datetime.fromisoformat(given) if isinstance(given, str) else None
    except ValueError:
        return None
    return told if told is not None and told.tzinfo is not None else None


def _drive(given: Any) -> Literal["a", "b"]:
    if given == "a":
        return "a"
    if given == "b":
        return "b"
    raise Refused(422, "bad_value", "must be 'a' or 'b'", field="drive", value=str(given)[:20])


def _refusal(request: Request, problem: Exception) -> Response:
    """A Refused as the page (people) or JSON (scripts) that says what happened."""
    assert isinstance(problem, Refused)  # noqa: S101  registered for this class only
    parts = house(request)
    wants_json = request.url.path.startswith("/api/") or request.headers.get("content-type", "").startswith(
        "application/json"
    )
    joining = request.url.path.startswith(
        "/join/"
    )  # everything on a session's own path was logged where it was refused
    if problem.code != "too_many" and (joining or problem.code == "unknown"):
        counted = count(request, REFUSALS_PER_ADDRESS, "refused", address_of(request))
        if joining and counted:
            log_refusal(parts.database, problem, request="join")
    if wants_json:
        return JSONResponse(problem.as_dict(), problem.status)
    languages = parts.texts.languages
    return page(
        request,
        "participant/refusal.html",
        language=parts.texts.best(request.headers.get("Accept-Language"), languages),
        status=problem.status,
        code=problem.code,
        contact=contact(request),
    )


exception_handlers = {Refused: _refusal}
