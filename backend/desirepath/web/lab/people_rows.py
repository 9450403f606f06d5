"""The participants of a study as the experimenters' pages count and list them. Reads only; renders nothing.

A number on a page and the rows behind it come from the same filter here, so they cannot disagree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median
from typing import Any

from sqlalchemy import and_, func, select, true
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Participant, ProblemReport, Response, Session, Trial
from desirepath.store.who_counts import group_of, left_out
from desirepath.study.personalising.clicking import PositionBias
from desirepath.study.plan.assignment import OrderLine
from desirepath.web.lab import monitoring
from desirepath.web.lab.answer_rows import PAGES_READ
from desirepath.web.lab.study_rows import count_by

HERE = timedelta(seconds=90)  # (ours) an open page is heard of far more often
SILENT = timedelta(minutes=30)  # (ours) silent for longer without pausing: counted as dropped out until they return

DROPPED = ("silent", "withdrawn", "expired", "screened_out")
UNDER_WAY = ("here", "away", "paused")


@dataclass(frozen=True)
class PersonRow:
    """A participant with the newest session, as one row.

    `presence`: here, away, paused, silent, completed, withdrawn, screened_out or expired. `progress` in [0, 1].
    `answers` (without pages that were only read), `restarts`, `problems` and flags are over all sessions. `sides`: of
    their preferences, how often the same letter. `trial_s`: median time from answer to answer.
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
    sides: PositionBias
    hasty: tuple[int, int]
    personalisation: str | None
    predictive_check: Mapping[str, Any] | None
    last_seen_at: datetime | None
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime
    device: Mapping[str, Any]
    views: tuple[str, ...]
    trial_s: float | None
    order: str

    @property
    def progress(self) -> float:
        return 1.0 if self.presence == "completed" else self.position / max(1, self.steps)


def people(s: DatabaseSession, study_id: str, now: datetime, *, only: str | None = None) -> list[PersonRow]:
    """Every participant of a study, in the order in which they joined; only: the participant of that id."""
    of_study = and_(Session.study_id == study_id, true() if only is None else Session.participant_id == only)
    whose = Session.participant_id
    given = select(whose, func.count()).select_from(Response).join(Session)
    answers = count_by(s, given.where(of_study, Response.kind.not_in(PAGES_READ)), whose)
    restarts = count_by(
        s, select(whose, func.sum(Trial.restarts)).select_from(Trial).join(Session).where(of_study), whose
    )
    problems = count_by(s, select(whose, func.count()).select_from(ProblemReport).join(Session).where(of_study), whose)
    signs = monitoring.signs(s, study_id, only=only)
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
        .where(Participant.study_id == study_id, of_study)
        .order_by(Participant.created_at, Participant.code, Session.appointment)
    ):
        newest[participant.id] = (participant, session)
    rows = []
    for participant, session in newest.values():
        step = session.plan[min(session.position, len(session.plan) - 1)] if session.plan else {}
        seen = signs.get(participant.id, monitoring.NOTHING)
        flags = ["problem"] if problems.get(participant.id) else []
        if restarts.get(participant.id, 0) >= monitoring.MANY_RESTARTS:
            flags.append("restarts")
        flags += [flag for flag in seen.flags if not (flag == "too_fast" and participant.simulated)]
        rows.append(
            PersonRow(
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
                answers=answers.get(participant.id, 0),
                restarts=restarts.get(participant.id, 0),
                problems=problems.get(participant.id, 0),
                flags=tuple(flags),
                sides=seen.sides,
                hasty=seen.hasty,
                trial_s=seen.trial_s,
                order=_order_of(session.assignment),
                personalisation=session.personalisation,
                predictive_check=session.predictive_check,
                last_seen_at=session.last_seen_at,
                started_at=session.started_at,
                finished_at=session.finished_at,
                expires_at=session.expires_at,
                device=session.device,
                views=tuple(dict.fromkeys(str(planned["view"]) for planned in session.plan if planned.get("view"))),
            )
        )
    return rows


def filter_people(everyone: Sequence[PersonRow], show: str) -> list[PersonRow]:
    """The people a filter names, several filters with commas: all, a presence, under_way, dropped, excluded, kept
    (neither excluded nor withdrawn), simulated, people, flagged, stage:NAME, dropped:STAGE, personalisation:OUTCOME,
    order:ORDER, flag:FLAG. An unknown one shows nobody."""
    found = list(everyone)
    for one in show.split(","):
        found = [person for person in found if _fits(person, *one.partition(":")[::2])]
    return found


def _fits(p: PersonRow, kind: str, value: str) -> bool:
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
            return left_out(excluded=p.excluded_at is not None, withdrawn=p.presence == "withdrawn") is None
        case "simulated" | "people" | "pilot":
            return group_of(simulated=p.simulated, pilot=p.pilot) == kind
        case "flagged":
            return bool(p.flags)
        case "stage":
            return p.stage == value and p.presence in UNDER_WAY
        case "personalisation":
            return p.personalisation == value
        case "order":
            return p.order == value
        case "flag":
            return value in p.flags
    return p.presence == kind


SORTS: dict[str, Callable[[PersonRow], Any]] = {
    "code": lambda p: p.code,
    "presence": lambda p: p.presence,
    "progress": lambda p: p.progress,
    "answers": lambda p: p.answers,
    "trial_s": lambda p: p.trial_s,
    "joined": lambda p: p.joined_at,
    "seen": lambda p: p.last_seen_at,
    "flags": lambda p: len(p.flags),
}


def search_people(everyone: Sequence[PersonRow], searched: str, sort: str) -> list[PersonRow]:
    """Those whose code holds what was searched for, sorted by a column (`-` before it: the largest first), by when they
    joined where it is none of SORTS. People without a value stand last."""
    wanted = [p for p in everyone if searched.strip().lower() in p.code.lower()]
    key = SORTS.get(sort.removeprefix("-"))
    if key is None:
        return wanted
    there = [p for p in wanted if key(p) is not None]
    missing = [p for p in wanted if key(p) is None]
    return sorted(there, key=key, reverse=sort.startswith("-")) + missing


def stages_of(everyone: Sequence[PersonRow], plan_stages: Sequence[str]) -> list[tuple[str, int, int]]:
    """(stage, under way in it, dropped out in it) in the protocol's order; stages nobody is in are kept."""
    order = list(dict.fromkeys([*plan_stages, *(p.stage for p in everyone)]))
    return [
        (stage, len(filter_people(everyone, f"stage:{stage}")), len(filter_people(everyone, f"dropped:{stage}")))
        for stage in order
    ]


def order_name(line: OrderLine) -> str:
    """An order of conditions as one word, `top_down-first_person`; levels between participants follow behind a bar."""
    return _order_name(line.order, line.groups)


def median_trial_s(everyone: Sequence[PersonRow]) -> float | None:
    """The median over people of their median time per trial (s); simulated participants do not count."""
    times = [p.trial_s for p in everyone if p.trial_s is not None and not p.simulated]
    return median(times) if times else None


def _presence(participant: Participant, session: Session, now: datetime) -> str:
    if participant.withdrawn_at is not None or session.state == "withdrawn":
        return "withdrawn"
    if session.state != "completed" and session.expires_at <= now:
        return "expired"
    if session.state != "active":
        return session.state
    silent_for = now - (session.last_seen_at or session.created_at)
    return "here" if silent_for <= HERE else "away" if silent_for <= SILENT else "silent"


def _order_of(assignment: Mapping[str, Any] | None) -> str:
    """What `order_name` calls the order that a session got; empty where the protocol has no conditions."""
    if not assignment or not assignment.get("blocks"):
        return ""
    order = [name for names in assignment["blocks"].values() for name in names]
    return _order_name(order, list(assignment.get("groups", {}).values()))


def _order_name(order: Sequence[str], groups: Sequence[str]) -> str:
    return "-".join(order) + ("|" + "-".join(groups) if groups else "")
