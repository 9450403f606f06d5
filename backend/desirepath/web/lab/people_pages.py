"""One participant's page and what may be done there: notes, exclusion, erasure. The list is `study_pages.py`'s."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.learning.preferences.predictive_power import CONVINCING
from desirepath.store.erasure import erase_participant
from desirepath.store.events import log_event
from desirepath.store.models import Note, Participant, Session, Study, utc_now
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal
from desirepath.web.lab import people_rows, study_rows
from desirepath.web.lab.answer_rows import AnswerFilter, answers
from desirepath.web.lab.learnt_pages import answers_teach
from desirepath.web.lab.study_tabs import study_tab, the_participant, the_study

LONGEST_REASON = 1000  # characters of a reason for an exclusion
LONGEST_NOTE = 4000

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])


@router.get("/lab/studies/{study_id}/people/{code}")
def person(request: Request, study_id: str, code: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return _person_page(request, s, study, code)


def _person_page(
    request: Request, s: DatabaseSession, study: Study, code: str, *, status: int = 200, problem: str | None = None
) -> Response:
    participant = the_participant(s, study, code)
    rows = people_rows.people(s, study.id, utc_now(), only=participant.id)
    where = AnswerFilter(participant=code)
    of_participant = select(Session).where(Session.participant_id == participant.id).order_by(Session.created_at)
    sessions = list(s.scalars(of_participant))
    return study_tab(
        request,
        study,
        "people",
        "lab/person.html",
        status=status,
        person=rows[0] if rows else None,
        participant=participant,
        answers=list(reversed(answers(s, study.id, where))),
        reports=study_rows.problems(s, study.id, participant=code),
        notes=study_rows.notes(s, participant.id),
        sessions=sessions,
        answers_teach=bool(sessions) and answers_teach(s, sessions[-1]),
        log=study_rows.events(s, study.id, participant=code),
        problem=problem,
        convincing=CONVINCING,
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
    erase_participant(database, files, participant_id, by=user.name, data=services_of(request).settings.data)
    return RedirectResponse(f"/lab/studies/{study_id}/erased?done=erased", status_code=303)


@router.post("/lab/studies/{study_id}/people/{code}/notes")
def write_note(
    request: Request,
    study_id: str,
    code: str,
    database: Db,
    user: CheckedCsrf,
    text: Annotated[str, Form()] = "",
    session: Annotated[str, Form()] = "",
) -> Response:
    """Write a note about a participant, or about one session of theirs."""
    text = text.strip()[:LONGEST_NOTE]
    with database.transaction() as s:
        study = the_study(s, study_id)
        participant = the_participant(s, study, code)
        if not text:
            return _person_page(request, s, study, code, status=422, problem="note_missing")
        about = s.get(Session, session) if session else None
        if session and (about is None or about.participant_id != participant.id):
            raise LabRefusal(404, "no_session")
        s.add(Note(participant_id=participant.id, session_id=session or None, text=text, written_by=user.name))
    return RedirectResponse(f"/lab/studies/{study_id}/people/{code}?done=note_written#notes", status_code=303)


@router.post("/lab/studies/{study_id}/people/{code}/notes/{note_id}/remove")
def remove_note(study_id: str, code: str, note_id: str, database: Db, user: CheckedCsrf) -> Response:
    """Remove a note, e.g. one that says who somebody is; the audit log keeps that it was removed, not what it said."""
    with database.transaction() as s:
        participant = the_participant(s, the_study(s, study_id), code)
        note = s.get(Note, note_id)
        if note is None or note.participant_id != participant.id:
            raise LabRefusal(404, "no_note")
        s.delete(note)
    return RedirectResponse(f"/lab/studies/{study_id}/people/{code}?done=note_removed#notes", status_code=303)


@router.get("/lab/studies/{study_id}/erased")
def erased(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return study_tab(request, study, "people", "lab/erased.html", stones=study_rows.tombstones(s, study.id))


def _log_about(s: DatabaseSession, kind: str, participant: Participant, **data: Any) -> None:
    """Log under the participant's session, so that an erasure takes the entry (and the reason's words) with it."""
    sessions = select(Session.id).where(Session.participant_id == participant.id).order_by(Session.created_at.desc())
    log_event(s, kind, study_id=participant.study_id, session_id=s.scalars(sessions).first(), **data)
