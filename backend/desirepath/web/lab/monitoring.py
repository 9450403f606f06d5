"""What stands out in the answers of a study: flags, time per trial, and the answers behind each flag. Reads only.

A flag asks for a look and excludes nobody. The rules stand at their names; all numbers are ours.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from statistics import median
from typing import Any

from sqlalchemy import func, select, true
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.analysis.triads import CHANCE_CIRCULAR, is_circular, whole_triads
from desirepath.report.study_data import TRIAD
from desirepath.store.models import Event, Response, Session, Trial
from desirepath.store.sides import is_side, is_tie, shown_on
from desirepath.store.who_counts import is_practice
from desirepath.study.personalising.clicking import (
    FAST_FROM,
    FAST_SHARE,
    NO_CHOICES,
    ONE_SIDED_P,
    ONE_SIDED_SHARE,
    TOO_FAST_S,
    PositionBias,
    is_too_fast,
    position_bias,
)

SEEN_FAST_FROM = 2  # choices, so that somebody is noticed before `FAST_FROM`, from which on nothing is learned
INCONSISTENT_FROM = 4  # repeats and swaps; half of so many differ by chance in most cases: a hint, no proof
INCONSISTENT_SHARE = 0.5
CIRCULAR_FROM = 2  # triads of transitivity probes in which A was chosen over B, B over C and C over A ...
CIRCULAR_SHARE = CHANCE_CIRCULAR  # ... and as large a share of all as by three coins
MANY_RESTARTS = 3  # trajectories that were interrupted and started over
LOST_FOCUS_FROM = 3  # trajectories that stopped because the window was hidden
FOCUS_REASONS = ("hidden",)
STOPPED = ("trial_interrupted", "stroke_interrupted")  # events: a pair's trajectory, the trajectory of a drawn path

ANSWER_SIGNS = ("too_fast", "one_sided", "failed_checks", "inconsistent")
"""Flags with answers behind them; those behind the others are events."""


RULES: dict[str, dict[str, float]] = {
    "problem": {},
    "restarts": {"from": MANY_RESTARTS},
    "too_fast": {"share": FAST_SHARE, "seconds": TOO_FAST_S, "from": SEEN_FAST_FROM, "untaught": FAST_FROM},
    "one_sided": {"share": ONE_SIDED_SHARE, "p": ONE_SIDED_P},
    "failed_checks": {},
    "inconsistent": {"share": INCONSISTENT_SHARE, "from": INCONSISTENT_FROM, "circular": CIRCULAR_FROM},
    "lost_focus": {"from": LOST_FOCUS_FROM},
}
"""Every flag with the numbers of its rule, for the words that explain it (`lab.people.rules` of the catalogue)."""


@dataclass(frozen=True)
class Signs:
    """What stands out in one participant's answers. `trial_s`: median seconds from answer to answer, over trials.
    sides: of their preferences, how often the same letter. hasty: how many choices were too fast, of how many."""

    flags: tuple[str, ...] = ()
    trial_s: float | None = None
    sides: PositionBias = NO_CHOICES
    hasty: tuple[int, int] = (0, 0)


NOTHING = Signs()


@dataclass(frozen=True)
class _Given:
    """One answer. `chosen`: the trajectory that a choice named; None for other answers and choices that timed out."""

    response: str
    session: str
    kind: str
    value: Mapping[str, Any]
    decision_s: float | None
    at: datetime
    role: str | None
    trial: str | None
    probe_of: str | None
    chosen: str | None
    block: str | None = None
    shown: frozenset[str] = frozenset()

    @property
    def rejected(self) -> str:
        """The trajectory of the two that a choice did not name."""
        (other,) = self.shown - {self.chosen}
        return other


def signs(s: DatabaseSession, study_id: str, *, only: str | None = None) -> dict[str, Signs]:
    """participant id -> what stands out, for everybody who has answered something or looked away; only: of one."""
    lost, answers = _lost_focus(s, study_id, only), _answers(s, study_id, only)
    found = {}
    for participant in {*answers, *lost}:
        given = answers[participant]
        flags = [sign for sign in ANSWER_SIGNS if _behind(sign, given)]
        if lost[participant] >= LOST_FOCUS_FROM:
            flags.append("lost_focus")
        hasty = (len(_behind("too_fast", given)), len(_timed(given)))
        found[participant] = Signs(tuple(flags), _trial_s(given), _sides(given), hasty)
    return found


def answers_behind(s: DatabaseSession, study_id: str, sign: str) -> set[str]:
    """Ids of the answers for which participants of a study have this flag. An unknown flag has none."""
    if sign not in ANSWER_SIGNS:
        return set()
    return {answer.response for given in _answers(s, study_id).values() for answer in _behind(sign, given)}


def _behind(sign: str, given: Sequence[_Given]) -> list[_Given]:
    """One participant's answers behind a flag; none where there is no reason for it."""
    match sign:
        case "too_fast":
            timed = _timed(given)
            hasty = is_too_fast([seconds for _, seconds in timed], SEEN_FAST_FROM)
            return [a for a, seconds in timed if seconds < TOO_FAST_S] if hasty else []
        case "one_sided":
            chosen = _preferences(given)
            return chosen if _sides(given).is_found else []
        case "failed_checks":
            return [a for a in given if a.value.get("passed") is False]
    probes = [(a, same) for a in given if (same := _agrees(a, given)) is not None]
    differing = [a for a, same in probes if not same]
    enough = len(probes) >= INCONSISTENT_FROM and len(differing) >= INCONSISTENT_SHARE * len(probes)
    return (differing if enough else []) + _going_round(given)


def _timed(given: Sequence[_Given]) -> list[tuple[_Given, float]]:
    """The choices, of no difference too, with how long each took, s."""
    return [(a, a.decision_s) for a in given if (a.chosen is not None or is_tie(a.value)) and a.decision_s is not None]


def _preferences(given: Sequence[_Given]) -> list[_Given]:
    """The choices between two trajectories, practice apart."""
    return [a for a in given if a.kind == "preference" and not is_practice(a.role) and a.chosen is not None]


def _sides(given: Sequence[_Given]) -> PositionBias:
    return position_bias([str(a.value["choice"]) for a in _preferences(given)])


def _going_round(given: Sequence[_Given]) -> list[_Given]:
    """The answers of circular triads, where there are too many of them."""
    asked: dict[tuple[str, str | None], dict[frozenset[str], _Given]] = defaultdict(dict)
    for answer in given:
        if answer.role == TRIAD and answer.chosen is not None:
            asked[answer.session, answer.block][answer.shown] = answer
    triads = [three for pairs in asked.values() for three in whole_triads(pairs)]
    circular = [three for three in triads if is_circular([(a.chosen or "", a.rejected) for a in three])]
    too_many = len(circular) >= max(CIRCULAR_FROM, CIRCULAR_SHARE * len(triads))
    return [answer for three in circular for answer in three] if too_many else []


def _agrees(answer: _Given, given: Sequence[_Given]) -> bool | None:
    """Whether a repeat or a swap named the same trajectory as the first time; None for what is no such probe."""
    if answer.probe_of is None or answer.chosen is None:
        return None
    first = next((a for a in given if a.trial == answer.probe_of), None)
    return None if first is None or first.chosen is None else answer.chosen == first.chosen


def _trial_s(given: Sequence[_Given]) -> float | None:
    """Median seconds from the answer before to a trial's answer, in the same session; pauses weigh little in it."""
    steps = [
        (after.at - before.at).total_seconds()
        for before, after in pairwise(given)
        if after.trial is not None and not is_practice(after.role) and before.session == after.session
    ]
    return median(steps) if steps else None


def _answers(s: DatabaseSession, study_id: str, only: str | None = None) -> dict[str, list[_Given]]:
    """participant id -> answers in the order in which they came."""
    asked = (
        select(
            *(Session.participant_id, Response.id, Response.session_id, Response.kind, Response.value),
            *(Response.decision_s, Response.created_at, Trial.role, Trial.id, Trial.probe_of),
            *(Trial.trajectory_a, Trial.trajectory_b, Trial.block),
        )
        .select_from(Response)
        .join(Session, Response.session_id == Session.id)
        .outerjoin(Trial, Response.trial_id == Trial.id)
        .where(Session.study_id == study_id, true() if only is None else Session.participant_id == only)
        .order_by(Response.created_at, Response.id)
    )
    found: dict[str, list[_Given]] = defaultdict(list)
    for row in s.execute(asked):
        participant, response, session, kind, value, decision_s, at, role, trial, probe_of, a, b, block = row
        choice = value.get("choice")
        chosen = shown_on(choice, a, b) if trial is not None and is_side(choice) else None
        shown = frozenset({a, b} - {None})
        found[participant].append(
            _Given(response, session, kind, value, decision_s, at, role, trial, probe_of, chosen, block, shown)
        )
    return found


def _lost_focus(s: DatabaseSession, study_id: str, only: str | None) -> Counter[str]:
    """participant id -> how often a trajectory stopped because the window was not in front."""
    asked = (
        select(Session.participant_id, func.count())
        .select_from(Event)
        .join(Session, Event.session_id == Session.id)
        .where(
            Session.study_id == study_id,
            true() if only is None else Session.participant_id == only,
            Event.kind.in_(STOPPED),
            Event.data["reason"].as_string().in_(FOCUS_REASONS),
        )
        .group_by(Session.participant_id)
    )
    return Counter({whose: int(times) for whose, times in s.execute(asked)})
