"""The ways in: the recruiting link with its device check, and the code of a later appointment.

Nothing is stored before somebody joins.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import quote

from fastapi import APIRouter, Form, Query, Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.grammar.texts import local
from desirepath.store.models import RecruitingId, Session, Study, utc_now
from desirepath.study.kind import kind_of
from desirepath.study.links import normalise_token, token_hash
from desirepath.study.protocol.stages import STAGES
from desirepath.study.refusals import Refused
from desirepath.study.session import machine, states
from desirepath.study.session.joining import Joiner, TakenIn, check_open, is_of
from desirepath.study.session.platforms import PARAMETERS, TITLES, Sender, by_parameter, sender_of
from desirepath.study.session.versions import newest_protocol
from desirepath.study.studies import study_by_link
from desirepath.web.core.addresses import is_from_here
from desirepath.web.core.contract import is_json, reply_of
from desirepath.web.core.dependencies import contact, page, services_of
from desirepath.web.core.throttle import JOINS_PER_ADDRESS, count, network_of
from desirepath.web.participant.device_check import remember
from desirepath.web.participant.replies import Joined
from desirepath.web.participant.requests import too_many
from desirepath.web.participant.sent import Joining

router = APIRouter()  # included in participant.router, which keeps guessers out

JOINING = {  # read by hand, as it comes in two forms
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": Joining.model_json_schema()},
            "application/x-www-form-urlencoded": {"schema": Joining.model_json_schema()},
        },
    }
}
JOINED_COOKIE = "desirepath_joined_"  # and the study: the personal link of whoever joined in this browser


@router.get("/join/{recruiting_token}")
def welcome(recruiting_token: str, request: Request, lang: Annotated[str | None, Query()] = None) -> Response:
    """Device check and welcome; nothing is stored yet. Whoever joined in this browser by the same platform id goes on
    where they were; without an id, the page says how they stand here: nobody takes part twice by accident."""
    services = services_of(request)
    with services.database.session() as s:
        study = study_by_link(s, recruiting_token)
        sender = sender_of(request.query_params)
        begun = _begun_here(s, request, study, sender)
        if begun is not None and sender.recruiting:
            return RedirectResponse(begun.path, status_code=303)
        if begun is None:
            check_open(s, study)
        frozen = newest_protocol(s, study)[1]
    languages = tuple(frozen.protocol.languages)
    best = services.texts.best(request.headers.get("Accept-Language"), languages)
    language = lang if lang in languages else best
    here = request.url.path
    whom = frozen.protocol.contact or contact(request)
    if begun is not None:
        shown: dict[str, Any] = {"study_title": frozen.title(language), "contact": whom, "begun": begun}
        return page(request, "participant/begun.html", language=language, **shown)
    return page(
        request,
        "participant/join.html",
        language=language,
        study_title=frozen.title(language),
        welcome=local(frozen.protocol.welcome, language) if frozen.protocol.welcome else None,
        asked=[kind for kind in dict.fromkeys(stage.kind for stage in frozen.protocol.stages) if _is_lead(kind)],
        languages=languages,
        recruiting=by_parameter(request.query_params),  # as it came: whoever joins with a placeholder is noted then
        platform=sender.recruiting and TITLES[sender.recruiting["platform"]],
        preview=sender.preview,
        contact=whom,
        action=here,
        join_url=here,
        device=frozen.protocol.asked_of_devices.model_dump(),
    )


@dataclass(frozen=True)
class Begun:
    """Somebody's session that was begun in this browser. stands: under way, finished, declined or left."""

    path: str
    stands: Literal["under_way", "finished", "declined", "left"]


def _begun_here(s: DatabaseSession, request: Request, study: Study, sender: Sender) -> Begun | None:
    """The session of whoever joined this study in this browser; where a platform's id is given, only if it was theirs.
    None for nobody, and for who was erased since."""
    token = request.cookies.get(f"{JOINED_COOKIE}{study.id[:8]}", "")
    session = s.scalars(select(Session).where(Session.token_hash == token_hash(token))).first() if token else None
    if session is None or session.study_id != study.id:
        return None
    known = s.get(RecruitingId, session.participant_id)
    if sender.recruiting is not None and (known is None or not is_of(known, sender.recruiting)):
        return None
    if session.state == "withdrawn":
        return Begun(f"/p/{token}", "declined" if machine.has_declined(s, session) else "left")
    appointment_over = session.state == "completed" and kind_of(machine.step_of(session)).ends_appointment
    over = session.state in states.FINAL and not appointment_over
    return Begun(f"/p/{token}", "finished" if over else "under_way")


@router.post("/join/{recruiting_token}", status_code=201, response_model=Joined, openapi_extra=JOINING)
async def join(recruiting_token: str, request: Request) -> Response:
    """A new participant. A form is answered with the way to the session (303), JSON (bots) with its token."""
    as_json = is_json(request.headers.get("content-type"))
    try:
        given = await request.json() if as_json else dict(await request.form())
    except ValueError:
        given = None
    try:
        asked = Joining.model_validate(given)
    except ValidationError as wrong:
        raise RequestValidationError([{**error, "loc": ("body", *error["loc"])} for error in wrong.errors()]) from None
    simulated = as_json and asked.simulated
    if simulated and not is_from_here(request):  # a bot need not watch
        raise Refused(403, "bots_from_elsewhere", "Simulated participants join only from the server's own machine.")
    if not simulated and not count(request, JOINS_PER_ADDRESS, "join", network_of(request)):
        raise too_many()
    sender = sender_of({name: getattr(asked, name) for name in PARAMETERS.values()})
    if not as_json:  # a page from before joining, which the browser had kept, begins no second session
        begun = await asyncio.to_thread(_begun, request, recruiting_token, sender)
        if begun is not None:
            return RedirectResponse(begun.path, status_code=303)
    who = Joiner(
        language=asked.language,
        recruiting=sender.recruiting,
        unfilled=sender.unfilled,
        device=asked.device,
        simulated=simulated,
        oracle=asked.oracle,
    )
    return _let_in(request, await services_of(request).doors.join(recruiting_token, who), as_json=as_json)


def _begun(request: Request, recruiting_token: str, sender: Sender) -> Begun | None:
    with services_of(request).database.session() as s:
        return _begun_here(s, request, study_by_link(s, recruiting_token), sender)


def _let_in(request: Request, joined: TakenIn, *, as_json: bool) -> Response:
    """The answer to a new participant, once everything of theirs is on the disk."""
    session, token = joined.session, joined.token
    response: Response = RedirectResponse(f"/p/{token}", status_code=303)
    if as_json:
        body = {"token": token, "participant": joined.participant.code, "simulated": session.simulated}
        response = reply_of(Joined, body, 201)
    remember(request, response, session)
    if not session.simulated:
        response.set_cookie(
            f"{JOINED_COOKIE}{session.study_id[:8]}",
            token,
            max_age=max(0, int((session.expires_at - utc_now()).total_seconds())),
            path="/join",
            httponly=True,
            samesite="lax",
            secure=request.url.scheme == "https",
        )
    return response


@router.get("/back")
def code_page(request: Request) -> Response:
    """Where the code of a later appointment is typed, on a device that does not have the link."""
    texts = services_of(request).texts
    language = texts.best(request.headers.get("Accept-Language"), texts.languages)
    return page(request, "participant/back.html", language=language, contact=contact(request))


@router.post("/back")
def go_back(code: Annotated[str, Form()] = "") -> Response:
    """To the session behind the code; a wrong one is told there as a wrong link is."""
    return RedirectResponse(f"/p/{quote(normalise_token(code.strip()), safe='')}", status_code=303)


def _is_lead(kind: str) -> bool:
    """Whether the page people join on begins with what is done there."""
    return STAGES[kind].teaches is not None or STAGES[kind].measures
