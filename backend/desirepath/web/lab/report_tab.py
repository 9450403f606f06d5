"""The numbers of a study's Report tab, each with the filter that lists the answers behind it. Renders nothing.

People and simulated participants are never mixed in a number. Learning trials, excluded and withdrawn participants are
left out everywhere. Answers of one person are not independent of each other, so intervals are over people.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import mean, median, quantiles
from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.analysis.estimates import wilson
from desirepath.store.models import Study
from desirepath.store.sides import is_side
from desirepath.study.kinds.rating import RATING, RatingStage
from desirepath.study.protocol.freezing import thaw
from desirepath.web.lab import people_rows
from desirepath.web.lab.answer_rows import Answer, AnswerFilter, agreement, answers
from desirepath.web.lab.answer_words import find_questionnaire
from desirepath.web.lab.people_rows import PersonRow


@dataclass(frozen=True)
class Share:
    """`hits` of `n`; `low` and `high` are a 95 % Wilson interval, None where the n are not independent (or none)."""

    hits: int
    n: int
    low: float | None = None
    high: float | None = None

    @property
    def value(self) -> float | None:
        return self.hits / self.n if self.n else None


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of `n` numbers; None without any."""

    n: int
    median: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Item:
    """One questionnaire item. `text` by language; `counts`: answer -> how often (in a ranking: how often first);
    `spread` where answers are numbers; `labels`: answer -> its words; `mean_ranks` of a ranking, 1 is best."""

    step: str
    key: str
    text: dict[str, str]
    n: int
    counts: dict[str, int]
    spread: Spread | None
    labels: dict[str, dict[str, str]]
    mean_ranks: dict[str, float] | None = None


@dataclass(frozen=True)
class Rated:
    """What was rated after watching, under one condition. under: how the keys of its steps begin; question by language;
    n: ratings; people; points: of the scale; spread over people, of the mean of what each of them rated."""

    under: str
    question: dict[str, str]
    points: int
    n: int
    people: int
    spread: Spread


@dataclass(frozen=True)
class Report:
    """All numbers of one kind of participant."""

    who: str
    joined: int
    completed: int
    excluded: int
    preferences: int
    second_chosen: Share
    repeats_agree: Share
    decision_s: Spread
    session_min: Spread
    restarts: int
    own_chosen: Share
    people_mostly_own: Share
    guesses_right: Share
    personalisation: dict[str, int]
    items: list[Item]
    ratings: list[Rated]


def study_report(s: DatabaseSession, study: Study, who: str, now: datetime) -> Report:
    """The report over `who`: people or simulated."""
    everyone = people_rows.filter_people(people_rows.people(s, study.id, now), who)
    kept = people_rows.filter_people(everyone, "kept")

    def pick(**where: Any) -> list[Answer]:
        return answers(s, study.id, AnswerFilter(who=who, usable=True, **where))

    regular = pick(kind="preference", role="regular")
    chosen = [choice for a in regular if is_side(choice := a.response.value.get("choice"))]
    compared = [a for a in pick(kind="comparison") if a.own_chosen is not None]
    guesses = [a for a in pick(kind="guess") if a.own_chosen is not None]
    own = sum(bool(a.own_chosen) for a in compared)
    return Report(
        who=who,
        joined=len(everyone),
        completed=sum(p.presence == "completed" for p in kept),
        excluded=sum(p.excluded_at is not None for p in everyone),
        preferences=len(regular),
        second_chosen=Share(chosen.count("b"), len(chosen)),
        repeats_agree=_repeats(regular, pick(kind="preference", role="repeat")),
        decision_s=_spread([a.response.decision_s for a in regular if a.response.decision_s is not None]),
        session_min=_spread([minutes for p in kept if (minutes := _minutes(p)) is not None]),
        restarts=sum(p.restarts for p in kept),
        own_chosen=Share(own, len(compared)),
        people_mostly_own=_over_people(compared),
        guesses_right=_share_of_people(sum(bool(a.own_chosen) for a in guesses), len(guesses)),
        personalisation=dict(Counter(p.personalisation for p in kept if p.personalisation)),
        items=_items(study, pick(kind="questionnaire")),
        ratings=_ratings(study, pick(kind=RATING)),
    )


def _minutes(person: PersonRow) -> float | None:
    """How long a completed session took, pauses included."""
    if person.presence != "completed" or person.started_at is None or person.finished_at is None:
        return None
    return (person.finished_at - person.started_at).total_seconds() / 60


def _spread(values: Sequence[float]) -> Spread:
    if not values:
        return Spread(0, None, None, None)
    low, _, high = quantiles(values, n=4, method="inclusive") if len(values) > 1 else (values[0],) * 3
    return Spread(len(values), median(values), low, high)


def _share_of_people(hits: int, n: int) -> Share:
    """A share whose n are different people, so that an interval means something."""
    if not n:
        return Share(0, 0)
    interval = wilson(hits, n)
    return Share(hits, n, interval.low, interval.high)


def _over_people(compared: Sequence[Answer]) -> Share:
    """People who chose their own robot's trajectory in more than half of their comparisons."""
    per_person: dict[str, list[bool]] = defaultdict(list)
    for answer in compared:
        per_person[answer.code].append(bool(answer.own_chosen))
    mostly = sum(2 * sum(chosen) > len(chosen) for chosen in per_person.values())
    return _share_of_people(mostly, len(per_person))


def _repeats(regular: Sequence[Answer], repeats: Sequence[Answer]) -> Share:
    """How often a repeated query got the same answer as the first time, in the same view."""
    same = agreement(regular, repeats)
    return Share(sum(same.values()), len(same))


def _mean_ranks(ranked: Sequence[list[Any]], choices: Sequence[str]) -> dict[str, float]:
    places = {choice: [ranking.index(choice) + 1 for ranking in ranked if choice in ranking] for choice in choices}
    return {choice: mean(found) for choice, found in places.items() if found}


def _items(study: Study, given: Sequence[Answer]) -> list[Item]:
    """Every item of every questionnaire step, in the order in which they were asked."""
    by_step: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for answer in sorted(given, key=lambda a: a.response.created_at):
        by_step[answer.response.step_key].append(answer.response.value)
    items = []
    for step, values in by_step.items():
        asked = find_questionnaire([thaw(study)], dict.fromkeys(set().union(*values)))
        for item in asked.items if asked else ():
            answered = [value[item.key] for value in values if value.get(item.key) not in (None, "")]
            ranked = [value for value in answered if isinstance(value, list)]
            numeric = item.type in ("scale", "number")
            countable = [ranking[0] for ranking in ranked if ranking] if ranked else answered
            counts = {} if item.type in ("number", "text") else dict(Counter(map(str, countable)))
            choices = (
                [str(n) for n in range(1, item.points + 1)] if item.type == "scale" else [o.value for o in item.options]
            )
            items.append(
                Item(
                    step=step,
                    key=item.key,
                    text=item.text,
                    n=len(answered),
                    counts={choice: counts.get(choice, 0) for choice in choices} if counts else {},
                    spread=_spread([float(value) for value in answered]) if numeric else None,
                    labels={option.value: option.label for option in item.options},
                    mean_ranks=_mean_ranks(ranked, choices) if ranked else None,
                )
            )
    return items


def _ratings(study: Study, given: Sequence[Answer]) -> list[Rated]:
    """Every condition in which trajectories were rated one by one, as asked first to last."""
    rated: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for answer in sorted(given, key=lambda a: a.response.created_at):
        under = answer.response.step_key.rpartition(".")[0]
        rated[under][answer.code].append(float(answer.response.value[RATING]))
    scales = {key: one.scale for key, one in thaw(study).protocol.keyed_stages if isinstance(one, RatingStage)}
    found = []
    for under, people in rated.items():
        scale = scales.get(under) or scales.get(under.rpartition(".")[0])
        spread = _spread([mean(values) for values in people.values()])
        question, points = (scale.question, scale.points) if scale else ({}, 0)
        found.append(Rated(under, question, points, sum(map(len, people.values())), len(people), spread))
    return found
