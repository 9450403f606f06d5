"""What the experimenters' pages count and list: people, answers, events of one study. Reads only; renders nothing.

A number on a page and the rows behind it come from the same filter here, so they cannot disagree.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.models import (
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
from backend.store.retention import is_overdue

HERE = timedelta(seconds=90)  # (ours) an open page is heard of far more often
SILENT = timedelta(minutes=30)  # (ours) silent for longer without pausing: counted as dropped out until they return
MANY_RESTARTS = 3  # (ours) flags: worth a look, never an exclusion by itself
ONE_SIDED_FROM = 8  # preferences; eight times the same letter by chance: 1 in 128
ROWS_PER_PAGE = 100

DROPPED = ("silent", "withdrawn", "expired")
UNDER_WAY = ("here", "away", "paused")


@dataclass(frozen=True)
class StudyLine:
    """One line of the studies list. `completed`: people; those that are simulated stand apart."""

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
class Person:
    """A participant with the newest session, as one row.

    `presence`: here, away, paused, silent, completed, withdrawn or expired. `progress` in [0, 1].
    """

    id: str
    code: str
    simulated: bool
    pilot: bool
    oracle: Mapping[str, Any] | None
    joined_at: datetime
    excluded_at: datetime | None
    excluded_reason: str | None
    excluded_by: str | None
    session_id: str
    presence: str
    language: str
    stage: str
    step_kind: str
    step_key: str
    position: int
    steps: int
    phase: str | None
    answers: int
    restarts: int
    problems: int
    flags: tuple[str, ...]
    personalisation: str | None
    last_seen_at: datetime | None
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime
    device: Mapping[str, Any]
    views: tuple[str, ...]

    @property
    def progress(self) -> float:
        return 1.0 if self.presence == "completed" else self.position / max(1, self.steps)


@dataclass(frozen=True)
class Answer:
    """One response with whose it is and its trial, where it has one."""

    response: Response
    code: str
    simulated: bool
    excluded: bool
    withdrawn: bool
    trial: Trial | None


@dataclass(frozen=True)
class Page:
    """One page of a long list; `page` counts from 1."""

    rows: Sequence[Any]
    total: int
    page: int
    pages: int


@dataclass(frozen=True)
class AnswerFilter:
    """Which answers; a field that is None means any. `who`: people or simulated. `usable`: what analyses use."""

    kind: str | None = None
    role: str | None = None
    choice: str | None = None
    own: str | None = None
    participant: str | None = None
    item: str | None = None
    who: str | None = None
    usable: bool = False


def study_lines(s: DatabaseSession) -> list[StudyLine]:
    """Every study, newest first."""
    people = _counted(s, select(Participant.study_id, func.count()).where(~Participant.simulated))
    simulated = _counted(s, select(Participant.study_id, func.count()).where(Participant.simulated))
    finished = select(Session.study_id, func.count()).where(Session.state == "completed")
    completed = _counted(s, finished.where(~Session.simulated), Session.study_id)
    completed_simulated = _counted(s, finished.where(Session.simulated), Session.study_id)
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
        for study in s.scalars(select(Study).order_by(Study.created_at.desc(), Study.id))
    ]


def people(s: DatabaseSession, study_id: str, now: datetime) -> list[Person]:
    """Every participant of a study, in the order in which they joined."""
    of_study = Session.study_id == study_id
    answers = _counted(s, select(Response.session_id, func.count()).join(Session).where(of_study), Response.session_id)
    restarts = _counted(
        s, select(Trial.session_id, func.sum(Trial.restarts)).join(Session).where(of_study), Trial.session_id
    )
    problems = _counted(
        s, select(ProblemReport.session_id, func.count()).join(Session).where(of_study), ProblemReport.session_id
    )
    sides: dict[str, Counter[str]] = {}
    for session_id, value in s.execute(
        select(Response.session_id, Response.value)
        .join(Session, Response.session_id == Session.id)
        .join(Trial, Response.trial_id == Trial.id)
        .where(of_study, Trial.kind == "query", Trial.role != "learning")
    ):
        sides.setdefault(session_id, Counter())[str(value.get("choice"))] += 1
    phases = {
        (session_id, key): phase
        for session_id, key, phase in s.execute(
            select(Trial.session_id, Trial.step_key, Trial.phase)
            .join(Session)
            .where(of_study, Trial.phase != "answered")
        )
    }
    newest: dict[str, tuple[Participant, Session]] = {}
    for participant, session in s.execute(
        select(Participant, Session)
        .join(Session, Session.participant_id == Participant.id)
        .where(Participant.study_id == study_id)
        .order_by(Participant.created_at, Participant.code, Session.created_at)
    ):
        newest[participant.id] = (participant, session)
    rows = []
    for participant, session in newest.values():
        step = session.plan[min(session.position, len(session.plan) - 1)] if session.plan else {}
        flags = []
        if problems.get(session.id):
            flags.append("problem")
        if restarts.get(session.id, 0) >= MANY_RESTARTS:
            flags.append("restarts")
        given = sides.get(session.id, Counter())
        if given.total() >= ONE_SIDED_FROM and len(given) == 1:
            flags.append("one_sided")
        rows.append(
            Person(
                id=participant.id,
                code=participant.code,
                simulated=participant.simulated,
                pilot=participant.pilot,
                oracle=participant.oracle,
                joined_at=participant.created_at,
                excluded_at=participant.excluded_at,
                excluded_reason=participant.excluded_reason,
                excluded_by=participant.excluded_by,
                session_id=session.id,
                presence=_presence(participant, session, now),
                language=session.language,
                stage=str(step.get("stage", "")),
                step_kind=str(step.get("kind", "")),
                step_key=str(step.get("key", "")),
                position=session.position,
                steps=len(session.plan),
                phase=phases.get((session.id, str(step.get("key", "")))),
                answers=answers.get(session.id, 0),
                restarts=restarts.get(session.id, 0),
                problems=problems.get(session.id, 0),
                flags=tuple(flags),
                personalisation=session.personalisation,
                last_seen_at=session.last_seen_at,
                started_at=session.started_at,
                finished_at=session.finished_at,
                expires_at=session.expires_at,
                device=session.device,
                views=tuple(dict.fromkeys(str(one["view"]) for one in session.plan if one.get("view"))),
            )
        )
    return rows


def shown(everyone: Sequence[Person], show: str) -> list[Person]:
    """The people a filter names, several filters with commas: all, a presence, under_way, dropped, excluded, kept
    (neither excluded nor withdrawn), simulated, people, flagged, stage:NAME, dropped:STAGE, personalisation:OUTCOME,
    views:ORDER. An unknown one shows nobody."""
    found = list(everyone)
    for one in show.split(","):
        found = [person for person in found if _fits(person, *one.partition(":")[::2])]
    return found


def _fits(p: Person, kind: str, value: str) -> bool:
    match kind:
        case "all":
            return True
        case "under_way":
            return p.presence in UNDER_WAY
        case "dropped":
            return p.presence in DROPPED and (not value or p.stage == value)
        case "excluded":
            return p.excluded_at is not None
        case "kept":
            return p.excluded_at is None and p.presence != "withdrawn"
        case "simulated":
            return p.simulated
        case "people":  # pilot participants stand apart, as in every number of the study
            return not (p.simulated or p.pilot)
        case "pilot":
            return p.pilot and not p.simulated
        case "flagged":
            return bool(p.flags)
        case "stage":
            return p.stage == value and p.presence in UNDER_WAY
        case "personalisation":
            return p.personalisation == value
        case "views":
            return "-".join(p.views) == value
    return p.presence == kind


def stages_of(everyone: Sequence[Person], plan_stages: Sequence[str]) -> list[tuple[str, int, int]]:
    """(stage, under way in it, dropped out in it) in the protocol's order; stages nobody is in are kept."""
    order = list(dict.fromkeys([*plan_stages, *(p.stage for p in everyone)]))
    return [
        (stage, len(shown(everyone, f"stage:{stage}")), len(shown(everyone, f"dropped:{stage}"))) for stage in order
    ]


def orders_of(everyone: Sequence[Person]) -> list[tuple[str, int, int]]:
    """(order of the views, completed, under way) of the people who count for the balance: neither lost nor excluded."""
    counted = [p for p in everyone if p.views and p.excluded_at is None and p.presence not in DROPPED]
    orders = sorted({"-".join(p.views) for p in counted})
    done = Counter("-".join(p.views) for p in counted if p.presence == "completed")
    total = Counter("-".join(p.views) for p in counted)
    return [(order, done[order], total[order] - done[order]) for order in orders]


def answers(s: DatabaseSession, study_id: str, where: AnswerFilter) -> list[Answer]:
    """The answers a filter names, newest first."""
    query: Any = (
        select(Response, Participant, Trial)
        .join(Session, Response.session_id == Session.id)
        .join(Participant, Session.participant_id == Participant.id)
        .outerjoin(Trial, Response.trial_id == Trial.id)
        .where(Session.study_id == study_id)
        .order_by(Response.created_at.desc(), Response.id)
    )
    if where.kind:
        query = query.where(Response.kind == where.kind)
    if where.role:
        query = query.where(Trial.role == where.role)
    if where.participant:
        query = query.where(Participant.code == where.participant)
    if where.who in ("people", "simulated"):
        query = query.where(Participant.simulated == (where.who == "simulated"))
    if where.usable:
        query = query.where(Participant.excluded_at.is_(None), Participant.withdrawn_at.is_(None))
    found = [
        Answer(
            response,
            participant.code,
            participant.simulated,
            participant.excluded_at is not None,
            participant.withdrawn_at is not None,
            trial,
        )
        for response, participant, trial in s.execute(query)
    ]
    if where.choice:
        found = [a for a in found if a.response.value.get("choice") == where.choice]
    if where.own in ("chosen", "not_chosen"):
        found = [a for a in found if own_chosen(a) is not None and own_chosen(a) == (where.own == "chosen")]
    if where.item:
        found = [a for a in found if where.item in a.response.value]
    return found


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


def own_chosen(answer: Answer) -> bool | None:
    """Whether a comparison or a guess named the drive made from the participant's own answers; None for others."""
    if answer.response.kind == "guess":
        right: bool | None = answer.response.value.get("right")
        return right
    own = (answer.trial.arms or {}).get("own") if answer.trial else None
    return None if own is None else answer.response.value.get("choice") == own


def events(
    s: DatabaseSession, study_id: str, *, kind: str | None = None, participant: str | None = None, page: int = 1
) -> Page:
    """Pages of (Event, participant code or None), newest first."""
    session_of = select(Session.id).where(Session.study_id == study_id)
    query = (
        select(Event, Participant.code)
        .outerjoin(Session, Event.session_id == Session.id)
        .outerjoin(Participant, Session.participant_id == Participant.id)
        .where((Event.study_id == study_id) | Event.session_id.in_(session_of))
    )
    if kind:
        query = query.where(Event.kind == kind)
    if participant:
        query = query.where(Participant.code == participant)
    total = s.scalar(select(func.count()).select_from(query.subquery())) or 0
    page, pages = page_of(page, total)
    rows = s.execute(query.order_by(Event.id.desc()).offset((page - 1) * ROWS_PER_PAGE).limit(ROWS_PER_PAGE)).all()
    return Page(rows, total, page, pages)


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


def cut(rows: Sequence[Any], page: int) -> Page:
    """One page of rows that are in memory already."""
    page, pages = page_of(page, len(rows))
    return Page(rows[(page - 1) * ROWS_PER_PAGE : page * ROWS_PER_PAGE], len(rows), page, pages)


def _presence(participant: Participant, session: Session, now: datetime) -> str:
    if participant.withdrawn_at is not None or session.state == "withdrawn":
        return "withdrawn"
    if session.state != "completed" and session.expires_at <= now:
        return "expired"
    if session.state != "active":
        return session.state
    silent_for = now - (session.last_seen_at or session.created_at)
    return "here" if silent_for <= HERE else "away" if silent_for <= SILENT else "silent"


def page_of(page: int, total: int) -> tuple[int, int]:
    pages = max(1, -(-total // ROWS_PER_PAGE))
    return min(max(1, page), pages), pages


def _counted(s: DatabaseSession, query: Any, by: Any = Participant.study_id) -> dict[str, int]:
    return {key: int(count or 0) for key, count in s.execute(query.group_by(by))}
