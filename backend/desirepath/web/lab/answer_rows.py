"""The answers of a study as the experimenters' pages count and list them. Reads only; renders nothing.

A number on a page and the rows behind it come from the same filter here, so they cannot disagree.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Participant, Response, Session, Trial
from desirepath.store.sides import SIDES, is_side
from desirepath.store.who_counts import GROUPS, in_group, not_left_out
from desirepath.web.lab import monitoring
from desirepath.web.lab.study_rows import ROWS_PER_PAGE, Page, page_of

PAGES_READ = ("information", "instruction", "break", "asking_on", "wait", "appointment", "debriefing")
"""Kinds of stored answers that say nothing but that a page was read: no number of answers counts them."""
_NAME = re.compile(r"[A-Za-z0-9_.:-]{1,80}")  # of a questionnaire's item, a step


class GivenAnswer(NamedTuple):
    """A response's columns that pages need."""

    id: str
    step_key: str
    kind: str
    value: dict[str, Any]
    decision_s: float | None
    created_at: datetime


class AskedTrial(NamedTuple):
    """Its trial's, where it has one."""

    id: str
    role: str
    view: str
    query_id: str | None
    trajectory_a: str
    trajectory_b: str
    arms: dict[str, Any] | None
    probe_of: str | None
    restarts: int


@dataclass(frozen=True)
class Answer:
    """One response with whose it is and its trial, where it has one."""

    response: GivenAnswer
    code: str
    simulated: bool
    excluded: bool
    withdrawn: bool
    trial: AskedTrial | None

    @property
    def own_chosen(self) -> bool | None:
        """Whether a comparison with the base policy, or a guess, named the trajectory made from the participant's own
        answers; None for others. Comparisons with other policies are the whole report's."""
        if self.response.kind == "guess":
            right: bool | None = self.response.value.get("right")
            return right
        arms = (self.trial.arms or {}) if self.trial else {}
        own = None if {"other", "neutral", "population"} & arms.keys() else arms.get("own")
        return None if own is None else self.response.value.get("choice") == own

    @property
    def replayed(self) -> bool:
        """Whether it is about trajectories, so that it can be shown as its participant saw it (`answer_replay.py`)."""
        value = self.response.value
        return self.trial is not None or "stroke" in value or (self.response.kind == "guess" and "about" in value)


@dataclass(frozen=True)
class AnswerFilter:
    """Which answers; a field that is None means any.

    choice: a, b or `either` of them. who: people (of the live study), pilot or simulated. usable: what analyses use.
    sign: those behind a flag of `monitoring.py`. own: of comparisons with the base policy and guesses `asked` all,
    `chosen` or `not_chosen`. item: questionnaires in which this item was answered. under: steps whose key begins so, as
    those of one condition. again: of repeated queries `asked` all whose first answer is there, `same` or `other`.
    given: without pages that were only read.
    """

    kind: str | None = None
    role: str | None = None
    choice: str | None = None
    own: str | None = None
    participant: str | None = None
    step: str | None = None
    under: str | None = None
    item: str | None = None
    again: str | None = None
    who: str | None = None
    sign: str | None = None
    usable: bool = False
    given: bool = False


def answers(s: DatabaseSession, study_id: str, where: AnswerFilter) -> list[Answer]:
    """The answers a filter names, newest first."""
    return _in_memory(s, study_id, where, [_answer(row) for row in s.execute(_query(s, study_id, where))])


def answers_page(s: DatabaseSession, study_id: str, where: AnswerFilter, page: int) -> Page:
    """One page of them; the nearest one there is, where it has fewer."""
    query = _query(s, study_id, where)
    if where.own or where.again:
        found = _in_memory(s, study_id, where, [_answer(row) for row in s.execute(query)])
        page, pages = page_of(page, len(found), ROWS_PER_PAGE)
        return Page(found[(page - 1) * ROWS_PER_PAGE : page * ROWS_PER_PAGE], len(found), page, pages)
    total = s.scalar(select(func.count()).select_from(query.order_by(None).subquery())) or 0
    page, pages = page_of(page, total, ROWS_PER_PAGE)
    rows = s.execute(query.offset((page - 1) * ROWS_PER_PAGE).limit(ROWS_PER_PAGE))
    return Page([_answer(row) for row in rows], total, page, pages)


def agreement(regular: Sequence[Answer], repeats: Sequence[Answer]) -> dict[str, bool]:
    """Id of a repeated query's answer -> whether it is the one that was given first, in the same view; those of which
    the first answer is not among the regular ones, or where one of the two was no choice, are left out."""
    first = _choices(regular)
    given = ((a.response.id, key, choice) for a in repeats for key, choice in _choices([a]).items())
    return {response: first[key] == choice for response, key, choice in given if key in first}


def _choices(given: Sequence[Answer]) -> dict[tuple[str, str, str | None], str]:
    """(whose, view, query) -> what was chosen, where something was."""
    return {
        (a.code, a.trial.view, a.trial.query_id): choice
        for a in given
        if a.trial is not None and is_side(choice := a.response.value.get("choice"))
    }


def _query(s: DatabaseSession, study_id: str, where: AnswerFilter) -> Select[*tuple[Any, ...]]:
    query: Any = (
        select(
            *(getattr(Response, name).label(f"response_{name}") for name in GivenAnswer._fields),
            *(Participant.code, Participant.simulated, Participant.excluded_at, Participant.withdrawn_at),
            *(getattr(Trial, name).label(f"trial_{name}") for name in AskedTrial._fields),
        )
        .select_from(Response)
        .join(Session, Response.session_id == Session.id)
        .join(Participant, Session.participant_id == Participant.id)
        .outerjoin(Trial, Response.trial_id == Trial.id)
        .where(Session.study_id == study_id)
        .order_by(Response.created_at.desc(), Response.id)
    )
    equal = {Response.kind: where.kind, Trial.role: where.role, Participant.code: where.participant}
    for column, value in (equal | {Response.step_key: where.step}).items():
        if value:
            query = query.where(column == value)
    if where.who in GROUPS:
        query = query.where(in_group(where.who))
    if where.usable:
        query = query.where(not_left_out())
    if where.given:
        query = query.where(Response.kind.not_in(PAGES_READ))
    if where.under:
        query = query.where(Response.step_key.startswith(f"{where.under}.", autoescape=True))
    if where.choice:
        wanted = SIDES if where.choice == "either" else (where.choice,)
        query = query.where(Response.value["choice"].as_string().in_(wanted))
    if where.item:
        known = where.item if _NAME.fullmatch(where.item) else "-"
        query = query.where(Response.kind == "questionnaire", Response.value[known].as_string() != "")
    if where.own:
        query = query.where(Response.kind.in_(("comparison", "guess")))
    if where.again:
        query = query.where(Trial.role == "repeat")
    if where.sign:
        query = query.where(Response.id.in_(monitoring.answers_behind(s, study_id, where.sign)))
    found: Select[*tuple[Any, ...]] = query
    return found


def _answer(row: Any) -> Answer:
    responses, trials = len(GivenAnswer._fields), len(AskedTrial._fields)
    code, simulated, excluded_at, withdrawn_at = row[responses:-trials]
    trial = AskedTrial(*row[-trials:]) if row[-trials] is not None else None
    given = GivenAnswer(*row[:responses])
    return Answer(given, code, simulated, excluded_at is not None, withdrawn_at is not None, trial)


def _in_memory(s: DatabaseSession, study_id: str, where: AnswerFilter, found: list[Answer]) -> list[Answer]:
    """What no database can tell by itself."""
    if where.own:
        found = [a for a in found if a.own_chosen is not None]
        if where.own != "asked":
            found = [a for a in found if a.own_chosen == (where.own == "chosen")]
    if where.again:
        regular = AnswerFilter(role="regular", kind=where.kind, who=where.who, usable=where.usable)
        same = agreement(answers(s, study_id, regular), found)
        wanted = {"same": (True,), "other": (False,)}.get(where.again, (True, False))
        found = [a for a in found if same.get(a.response.id) in wanted]
    return found
