"""What the experimenters' pages count and list: studies, events, notes. People are `people_rows.py`'s, answers
`answer_rows.py`'s. Reads only; renders nothing.

A number on a page and the rows behind it come from the same filter here, so they cannot disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import (
    Event,
    Note,
    Participant,
    ProblemReport,
    Response,
    Session,
    Study,
    Tombstone,
    Trial,
    utc_now,
)
from desirepath.store.retention import is_overdue
from desirepath.store.who_counts import FINISHED, GROUPS, Group, in_group

ROWS_PER_PAGE = 100


@dataclass(frozen=True)
class StudyLine:
    """One line of the studies list. `people`, `completed`: of the live study; pilot participants are not counted, and
    those that are simulated stand apart."""

    study: Study
    people: int
    simulated: int
    completed: int
    completed_simulated: int
    answers: int
    last_answer_at: datetime | None

    @property
    def overdue(self) -> bool:
        """Whether the data were to be erased by now."""
        return is_overdue(self.study, utc_now())


@dataclass(frozen=True)
class Page:
    """One page of a long list; `page` counts from 1."""

    rows: Sequence[Any]
    total: int
    page: int
    pages: int


def count_joined(s: DatabaseSession, study_id: str) -> dict[Group, int]:
    """How many joined a study, by group."""
    of_study = select(func.count()).select_from(Participant).where(Participant.study_id == study_id)
    return {group: s.scalar(of_study.where(in_group(group))) or 0 for group in GROUPS}


def study_lines(s: DatabaseSession, seen: ColumnElement[bool]) -> list[StudyLine]:
    """Every study that may be seen, newest first."""
    joined = select(Participant.study_id, func.count())
    people = count_by(s, joined.where(in_group("people")))
    simulated = count_by(s, joined.where(in_group("simulated")))
    newest = (
        select(Session.participant_id, func.max(Session.appointment).label("last"))
        .group_by(Session.participant_id)
        .subquery()
    )
    finished = (
        joined.join(Session, Session.participant_id == Participant.id)
        .join(newest, (newest.c.participant_id == Participant.id) & (newest.c.last == Session.appointment))
        .where(Session.state == FINISHED)
    )
    completed = count_by(s, finished.where(in_group("people")))
    completed_simulated = count_by(s, finished.where(in_group("simulated")))
    answers = {
        study: (count, last)
        for study, count, last in s.execute(
            select(Session.study_id, func.count(), func.max(Response.created_at))
            .join(Session, Response.session_id == Session.id)
            .group_by(Session.study_id)
        )
    }
    return [
        StudyLine(
            study,
            people.get(study.id, 0),
            simulated.get(study.id, 0),
            completed.get(study.id, 0),
            completed_simulated.get(study.id, 0),
            *answers.get(study.id, (0, None)),
        )
        for study in s.scalars(select(Study).where(seen).order_by(Study.created_at.desc(), Study.id))
    ]


def answer_kinds(s: DatabaseSession, study_id: str) -> list[tuple[str, str | None, int]]:
    """(kind, role of the trial or None, how many) of a study's answers."""
    query = (
        select(Response.kind, Trial.role, func.count())
        .join(Session, Response.session_id == Session.id)
        .outerjoin(Trial, Response.trial_id == Trial.id)
        .where(Session.study_id == study_id)
        .group_by(Response.kind, Trial.role)
        .order_by(Response.kind, Trial.role)
    )
    return [(kind, role, count) for kind, role, count in s.execute(query)]


def events(
    s: DatabaseSession, study_id: str, *, kind: str | None = None, participant: str | None = None, page: int = 1
) -> Page:
    """Pages of (Event, participant code or None), newest first. kind: one, or several with commas."""
    session_of = select(Session.id).where(Session.study_id == study_id)
    query = (
        select(Event, Participant.code)
        .outerjoin(Session, Event.session_id == Session.id)
        .outerjoin(Participant, Session.participant_id == Participant.id)
        .where((Event.study_id == study_id) | Event.session_id.in_(session_of))
    )
    if kind:
        query = query.where(Event.kind.in_(kind.split(",")))
    if participant:
        query = query.where(Participant.code == participant)
    return find_page(s, query.order_by(Event.id.desc()), page)


def event_kinds(s: DatabaseSession, study_id: str) -> list[tuple[str, int]]:
    """(kind, how many) of a study's events, most frequent first."""
    session_of = select(Session.id).where(Session.study_id == study_id)
    query = (
        select(Event.kind, func.count())
        .where((Event.study_id == study_id) | Event.session_id.in_(session_of))
        .group_by(Event.kind)
        .order_by(func.count().desc(), Event.kind)
    )
    return [(kind, count) for kind, count in s.execute(query)]


def problems(s: DatabaseSession, study_id: str, *, participant: str | None = None) -> list[tuple[ProblemReport, str]]:
    """(report, participant code), newest first."""
    query = (
        select(ProblemReport, Participant.code)
        .join(Session, ProblemReport.session_id == Session.id)
        .join(Participant, Session.participant_id == Participant.id)
        .where(Session.study_id == study_id)
        .order_by(ProblemReport.created_at.desc())
    )
    if participant:
        query = query.where(Participant.code == participant)
    return [(report, code) for report, code in s.execute(query)]


def notes(s: DatabaseSession, participant_id: str) -> list[Note]:
    """What was noted about a participant, oldest first."""
    return list(s.scalars(select(Note).where(Note.participant_id == participant_id).order_by(Note.created_at, Note.id)))


def tombstones(s: DatabaseSession, study_id: str) -> list[Tombstone]:
    """What is left of erased participants, newest first."""
    return list(s.scalars(select(Tombstone).where(Tombstone.study_id == study_id).order_by(Tombstone.erased_at.desc())))


def find_page(s: DatabaseSession, query: Select[*tuple[Any, ...]], page: int, per_page: int = ROWS_PER_PAGE) -> Page:
    """One page of what an ordered query finds; the nearest one there is, where it has fewer."""
    total = s.scalar(select(func.count()).select_from(query.order_by(None).subquery())) or 0
    page, pages = page_of(page, total, per_page)
    return Page(s.execute(query.offset((page - 1) * per_page).limit(per_page)).all(), total, page, pages)


def slice_page(rows: Sequence[Any], page: int) -> Page:
    """One page of rows that are in memory already."""
    page, pages = page_of(page, len(rows), ROWS_PER_PAGE)
    return Page(rows[(page - 1) * ROWS_PER_PAGE : page * ROWS_PER_PAGE], len(rows), page, pages)


def page_of(page: int, total: int, per_page: int) -> tuple[int, int]:
    """The page that is shown for one that was asked for, and how many there are."""
    pages = max(1, -(-total // per_page))
    return min(max(1, page), pages), pages


def count_by(s: DatabaseSession, query: Any, by: Any = Participant.study_id) -> dict[str, int]:
    """What a query for (key, number) finds, one entry for each value of `by`."""
    return {key: int(count or 0) for key, count in s.execute(query.group_by(by))}
