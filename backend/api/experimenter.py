"""The experimenters' pages: the studies, one study's tabs, what may be done to a participant. Making a study lives in
`new_study.py`, the numbers of the Report tab in `study_report.py`, accounts in `auth.py`."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.background import BackgroundTask
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response

from backend.api import new_study, preview, settings_pages, study_rows
from backend.api.auth import CheckedCsrf, SignedIn, checked_csrf
from backend.api.dependencies import Db, Files, contact, house, public_url
from backend.api.lab import LabRefusal, lab_page
from backend.api.preview import first_steps
from backend.api.study_report import study_report
from backend.store.dataset import data_dictionary
from backend.store.erasure import erase_participant
from backend.store.events import log_event
from backend.store.export import export_study
from backend.store.models import Participant, Session, Study, utc_now
from backend.study.protocol import describe_stages, thaw

TABS = ("now", "people", "protocol", "recruit", "data", "report")
LONGEST_REASON = 1000  # characters of a reason for an exclusion

router = APIRouter(dependencies=[Depends(checked_csrf)], tags=["experimenter"])
router.include_router(new_study.router)
router.include_router(preview.router)
router.include_router(settings_pages.router)


def the_study(s: DatabaseSession, study_id: str) -> Study:
    """The study with this id. Raises LabRefusal 404."""
    study = s.get(Study, study_id)
    if study is None:
        raise LabRefusal(404, "no_study")
    return study


def the_participant(s: DatabaseSession, study: Study, code: str) -> Participant:
    found = s.scalars(select(Participant).where(Participant.study_id == study.id, Participant.code == code)).first()
    if found is None:
        raise LabRefusal(404, "no_participant", code=code)
    return found


def _tab(request: Request, study: Study, tab: str, template: str | None = None, **context: Any) -> Response:
    return lab_page(request, template or f"lab/study_{tab}.html", study=study, tab=tab, tabs=TABS, **context)


@router.get("/lab/studies")
def studies(request: Request, database: Db) -> Response:
    with database.session() as s:
        return lab_page(request, "lab/studies.html", lines=study_rows.study_lines(s))


@router.get("/lab/studies/{study_id}")
def study_home(study_id: str, database: Db) -> Response:
    with database.session() as s:
        return RedirectResponse(f"/lab/studies/{the_study(s, study_id).id}/now", status_code=303)


@router.get("/lab/studies/{study_id}/now")
def now(request: Request, study_id: str, database: Db) -> Response:
    """Who is where. With the header `X-Fragment`, only the part that changes."""
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = study_rows.people(s, study.id, utc_now())
        template = "lab/now_part.html" if request.headers.get("X-Fragment") else None
        return _tab(
            request,
            study,
            "now",
            template,
            everyone=everyone,
            shown=study_rows.shown,
            stages=study_rows.stages_of(everyone, _stage_keys(study)),
            orders=study_rows.orders_of(everyone),
            erased=len(study_rows.tombstones(s, study.id)),
        )


@router.get("/api/lab/studies/{study_id}/monitor")
def monitor(study_id: str, database: Db) -> dict[str, Any]:
    """The Now tab as data: one object per participant, and how many are in and were lost at each stage."""
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = study_rows.people(s, study.id, utc_now())
        return {
            "study": study.id,
            "state": study.state,
            "people": [
                {
                    "code": p.code,
                    "simulated": p.simulated,
                    "excluded": p.excluded_at is not None,
                    "presence": p.presence,
                    "stage": p.stage,
                    "step": p.step_key,
                    "phase": p.phase,
                    "progress": round(p.progress, 3),
                    "answers": p.answers,
                    "restarts": p.restarts,
                    "flags": p.flags,
                    "last_seen_at": p.last_seen_at,
                }
                for p in everyone
            ],
            "stages": [
                {"stage": stage, "under_way": here, "dropped": gone}
                for stage, here, gone in study_rows.stages_of(everyone, _stage_keys(study))
            ],
        }


@router.get("/lab/studies/{study_id}/people")
def people(request: Request, study_id: str, database: Db, show: str = "all", page: int = 1) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = study_rows.people(s, study.id, utc_now())
        return _tab(
            request,
            study,
            "people",
            everyone=everyone,
            show=show,
            count=study_rows.shown,
            listed=study_rows.cut(study_rows.shown(everyone, show), page),
            erased=len(study_rows.tombstones(s, study.id)),
        )


@router.get("/lab/studies/{study_id}/people/{code}")
def person(request: Request, study_id: str, code: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return _person_page(request, s, study, code)


def _person_page(
    request: Request, s: DatabaseSession, study: Study, code: str, *, status: int = 200, problem: str | None = None
) -> Response:
    participant = the_participant(s, study, code)
    rows = [p for p in study_rows.people(s, study.id, utc_now()) if p.id == participant.id]
    where = study_rows.AnswerFilter(participant=code)
    return lab_page(
        request,
        "lab/person.html",
        status=status,
        study=study,
        tab="people",
        tabs=TABS,
        person=rows[0] if rows else None,
        participant=participant,
        answers=list(reversed(study_rows.answers(s, study.id, where))),
        reports=study_rows.problems(s, study.id, participant=code),
        log=study_rows.events(s, study.id, participant=code),
        problem=problem,
    )


@router.post("/lab/studies/{study_id}/people/{code}/exclude")
def exclude(
    request: Request, study_id: str, code: str, database: Db, user: CheckedCsrf, reason: Annotated[str, Form()] = ""
) -> Response:
    """Leave a participant out of snapshots and analyses; the data stay. A reason is required and kept."""
    reason = reason.strip()[:LONGEST_REASON]
    if not reason:
        with database.session() as s:
            return _person_page(request, s, the_study(s, study_id), code, status=422, problem="reason_missing")
    with database.transaction() as s:
        participant = the_participant(s, the_study(s, study_id), code)
        participant.excluded_at, participant.excluded_reason, participant.excluded_by = utc_now(), reason, user.name
        _log_about(s, "participant_excluded", participant, by=user.name, reason=reason)
    return RedirectResponse(f"/lab/studies/{study_id}/people/{code}?done=excluded", status_code=303)


@router.post("/lab/studies/{study_id}/people/{code}/include")
def include(study_id: str, code: str, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        participant = the_participant(s, the_study(s, study_id), code)
        participant.excluded_at = participant.excluded_reason = participant.excluded_by = None
        _log_about(s, "participant_included", participant, by=user.name)
    return RedirectResponse(f"/lab/studies/{study_id}/people/{code}?done=included", status_code=303)


@router.post("/lab/studies/{study_id}/people/{code}/erase")
def erase(
    request: Request,
    study_id: str,
    code: str,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    typed: Annotated[str, Form()] = "",
) -> Response:
    """Erase a participant for good. The study's name has to be typed."""
    with database.session() as s:
        study = the_study(s, study_id)
        participant = the_participant(s, study, code)
        if typed.strip() != study.name:
            return _person_page(request, s, study, code, status=422, problem="name_differs")
        participant_id = participant.id
    erase_participant(database, files, participant_id, by=user.name, data=house(request).settings.data)
    return RedirectResponse(f"/lab/studies/{study_id}/erased?done=erased", status_code=303)


@router.get("/lab/studies/{study_id}/erased")
def erased(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return _tab(request, study, "people", "lab/erased.html", stones=study_rows.tombstones(s, study.id))


@router.get("/lab/studies/{study_id}/answers")
def answers(
    request: Request,
    study_id: str,
    database: Db,
    kind: str | None = None,
    role: str | None = None,
    choice: str | None = None,
    own: str | None = None,
    participant: str | None = None,
    item: str | None = None,
    who: str | None = None,
    usable: bool = False,
    page: int = 1,
) -> Response:
    """The rows behind every number of answers."""
    where = study_rows.AnswerFilter(
        kind=kind or None,
        role=role or None,
        choice=choice or None,
        own=own or None,
        participant=participant or None,
        item=item or None,
        who=who or None,
        usable=usable,
    )
    with database.session() as s:
        study = the_study(s, study_id)
        listed = study_rows.cut(study_rows.answers(s, study.id, where), page)
        return _tab(
            request, study, "data", "lab/answers.html", listed=listed, where=where, own_chosen=study_rows.own_chosen
        )


@router.get("/lab/studies/{study_id}/events")
def events(
    request: Request, study_id: str, database: Db, kind: str = "", participant: str = "", page: int = 1
) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return _tab(
            request,
            study,
            "data",
            "lab/events.html",
            listed=study_rows.events(s, study.id, kind=kind or None, participant=participant or None, page=page),
            kinds=study_rows.event_kinds(s, study.id),
            kind=kind,
            participant=participant,
        )


@router.get("/lab/studies/{study_id}/problems")
def problems(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return _tab(request, study, "people", "lab/problems.html", reports=study_rows.problems(s, study.id))


@router.get("/lab/studies/{study_id}/protocol")
def protocol(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        stages = describe_stages(study.protocol, study.files)
        frozen = thaw(study)
        return _tab(request, study, "protocol", frozen=frozen, stages=stages, first_steps=first_steps(frozen))


@router.get("/lab/studies/{study_id}/protocol.yaml")
def protocol_file(study_id: str, database: Db) -> Response:
    """The study's frozen copy, byte for byte."""
    with database.session() as s:
        study = the_study(s, study_id)
        return PlainTextResponse(
            study.protocol_yaml,
            media_type="application/yaml",
            headers={"Content-Disposition": f'attachment; filename="{study.protocol_name}.yaml"'},
        )


@router.get("/lab/studies/{study_id}/recruit")
def recruit(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        link = f"{public_url(request)}/join/{study.recruiting_token}"
        helper = thaw(study).protocol.contact or contact(request)
        return _tab(request, study, "recruit", link=link, loopback=_is_loopback(link), contact=helper)


@router.post("/lab/studies/{study_id}/state")
def set_state(study_id: str, database: Db, user: CheckedCsrf, state: Annotated[str, Form()] = "") -> Response:
    """Close a study to new participants, or open it again. Who has begun may finish either way."""
    if state not in ("open", "closed"):
        raise LabRefusal(422, "bad_state", state=state)
    with database.transaction() as s:
        study = the_study(s, study_id)
        if study.state != state:
            study.state = state
            log_event(s, f"study_{state}", study_id=study.id, by=user.name)
    return RedirectResponse(f"/lab/studies/{study_id}/recruit?done=study_{state}", status_code=303)


@router.get("/lab/studies/{study_id}/data")
def data(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = study_rows.people(s, study.id, utc_now())
        return _tab(
            request,
            study,
            "data",
            everyone=everyone,
            shown=study_rows.shown,
            kinds=study_rows.answer_kinds(s, study.id),
            event_kinds=study_rows.event_kinds(s, study.id),
        )


@router.post("/lab/studies/{study_id}/export")
def export(study_id: str, database: Db, files: Files, user: CheckedCsrf) -> Response:
    """The data set of `desirepath export` as one zip file."""
    with database.session() as s:
        study = the_study(s, study_id)
        name = f"{study.protocol_name}-{study.id[:8]}-{utc_now():%Y%m%d-%H%M}"
    folder = Path(tempfile.mkdtemp(prefix="desirepath-export-"))
    try:
        export_study(database, files, study_id, folder / name)
        packed = shutil.make_archive(str(folder / "export"), "zip", folder, name)
        shutil.rmtree(folder / name)
        with database.transaction() as s:
            log_event(s, "study_exported", study_id=study_id, by=user.name)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return FileResponse(
        packed,
        media_type="application/zip",
        filename=f"{name}.zip",
        background=BackgroundTask(shutil.rmtree, folder, ignore_errors=True),
    )


@router.get("/lab/data-dictionary")
def dictionary(request: Request) -> Response:
    """What every column of an export means; the file that the export holds too."""
    return lab_page(request, "lab/dictionary.html", text=data_dictionary())


@router.get("/lab/studies/{study_id}/report")
def report(request: Request, study_id: str, database: Db, who: str = "people") -> Response:
    """The summary numbers, each linked to its rows; `who`: people or simulated, never both in one number."""
    who = "simulated" if who == "simulated" else "people"
    with database.session() as s:
        study = the_study(s, study_id)
        return _tab(request, study, "report", report=study_report(s, study, who, utc_now()), who=who)


@router.get("/api/lab/studies/{study_id}/report")
def report_data(study_id: str, database: Db, user: SignedIn, who: str = "people") -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return JSONResponse(
            study_report(s, study, "simulated" if who == "simulated" else "people", utc_now()).as_dict()
        )


def _log_about(s: DatabaseSession, kind: str, participant: Participant, **data: Any) -> None:
    """Log under the participant's session, so that an erasure takes the entry (and the reason's words) with it."""
    sessions = select(Session.id).where(Session.participant_id == participant.id).order_by(Session.created_at.desc())
    log_event(s, kind, study_id=participant.study_id, session_id=s.scalars(sessions).first(), **data)


def _stage_keys(study: Study) -> list[str]:
    return [stage.key for stage in describe_stages(study.protocol, study.files)]


def _is_loopback(address: str) -> bool:
    return any(f"//{host}" in address for host in ("127.0.0.1", "localhost", "[::1]"))
