"""Simulated people with stated effects: what they rate, rank and how steadily they choose. Marked as such.

The same people walk through the state machine (`study/simulated/in_process.py`,
`study/simulated/participant.py`) and, by themselves, make whole data sets here, so that what a report must find is
known. Their answers depend only on seed, number and what is asked, not on the order of asking.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError

from desirepath.analysis.scales import Scale, ScaleItem
from desirepath.grammar.source import ProtocolError, Source, file_text
from desirepath.report.study_data import Choice, Comparison, ParticipantRow, Rating, StudyData

PERSONAL_SHARE = 0.4  # ours: share of a rating's variance that belongs to the person
ALIKE = 4.0  # ours: of the beta distribution of people's shares; small: people differ much
CONDITIONS = ("first_person", "immersive", "top_down")
ITEMS = (
    *("ease", "confidence", "mental_effort", "clarity", "naturalness"),
    *("spatial_understanding", "realism", "presence", "fun", "boredom"),
)
RANKINGS = ("usefulness", "ease_of_use", "intention_to_use")
OPPONENTS = ("base", "other")  # the base policy, another participant's
QUERIES = 25
Levels = Mapping[str, Sequence[str]]


class CohortError(ValueError):
    """Effects that no cohort can have; names the field and what would work."""


@dataclass(frozen=True)
class Cohort:
    """What is put into a cohort; the default is nothing: conditions differ in nothing (a null cohort).

    ratings: item -> condition -> shift in standard deviations of the ratings behind the scale's steps (people and
    moments together have 1). first_choice: ranking -> condition -> share of people who put it first; the others share
    the rest. consistency: condition -> chance of the same answer when the same query is asked again; missing: `steady`.
    preferences: condition -> oracle whose preference decides, where it is not everybody's own. second_shown: chance
    that the second trajectory is taken whatever is asked. own: mean chance that the own policy is preferred to another;
    only of data sets made here, since bots that see rollouts decide by preference.
    own_against_other: the same against another participant's policy, where it differs. items_alike: correlation of a
    person's opinions on two items about the same condition. drop_out: share of people who do not finish. shown: share
    of those who are shown a policy as theirs, and so compare; the gate refuses the others.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    ratings: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    first_choice: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    consistency: Mapping[str, float] = field(default_factory=dict)
    steady: float = 0.8  # ours
    preferences: Mapping[str, str] = field(default_factory=dict)
    second_shown: float = 0.0
    own: float = 0.5
    own_against_other: float | None = None
    items_alike: float = 0.0
    drop_out: float = 0.0
    seed: int = 0
    shown: float = 1.0

    def __post_init__(self) -> None:
        steadiness = {"steady": self.steady, **{f"consistency.{c}": v for c, v in self.consistency.items()}}
        for name, value in steadiness.items():
            if not 0.5 <= value <= 1:
                raise CohortError(f"{name} = {value}: the chance of the same answer lies between 0.5 (guessing) and 1")
        probabilities: dict[str, float | None] = {
            "second_shown": self.second_shown,
            "own": self.own,
            "own_against_other": self.own_against_other,
        }
        probabilities |= {"items_alike": self.items_alike, "drop_out": self.drop_out, "shown": self.shown}
        for name, chance in probabilities.items():
            if chance is not None and not 0 <= chance <= 1:
                raise CohortError(f"{name} = {chance}: a chance lies between 0 and 1")
        for ranking, shares in self.first_choice.items():
            if any(not 0 < share < 1 for share in shares.values()) or sum(shares.values()) >= 1:
                raise CohortError(
                    f"first_choice.{ranking} = {dict(shares)}: shares lie between 0 and 1 and leave some to the others"
                )

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def person(self, number: int) -> SimulatedPerson:
        """The simulated person of that number."""
        return SimulatedPerson(self, number)

    def lapse_rate(self, condition: str) -> float:
        """Chance that one answer is not what the person would usually say: c = (1 - e)^2 + e^2, solved for e."""
        return (1 - math.sqrt(2 * self.consistency.get(condition, self.steady) - 1)) / 2


VIEWS_DIFFER = Cohort(
    ratings={"fun": {"immersive": 1.2}, "mental_effort": {"first_person": 1.2}},
    first_choice={"usefulness": {"top_down": 0.75}},
    consistency={"top_down": 0.95, "first_person": 0.9, "immersive": 0.9},
    preferences={"top_down": "shortest", "first_person": "smoothest", "immersive": "min-human-distance"},
)
"""People whose views differ by construction."""


def rate_opinions(opinions: ArrayLike, points: int) -> NDArray[np.int64]:
    """1 to points, of opinions in standard deviations, of which one is a quarter of the scale: answers use all of it,
    few at the ends."""
    steps = (points + 1) / 2 + (points - 1) / 4 * np.asarray(opinions)
    return np.clip(np.floor(steps + 0.5), 1, points).astype(np.int64)


@dataclass(frozen=True)
class SimulatedPerson:
    """One of a cohort; knows only what is asked."""

    cohort: Cohort
    number: int

    def _random(self, *about: str) -> np.random.Generator:
        words = int.from_bytes(hashlib.sha256("\0".join(about).encode()).digest()[:8], "big")
        return np.random.default_rng([self.cohort.seed, self.number, words])

    def rate(
        self, item: str, condition: str | None, points: int = 7, *, levels: Sequence[str] = (), scale: str | None = None
    ) -> int:
        """1 to points: the person's own level, the moment, and the shift of the condition and of each of its levels.

        scale: the validated scale that the item is of, whose shift the item has.
        """
        own = self._opinion("level", item) * math.sqrt(PERSONAL_SHARE)
        moment = self._opinion("rating", item, condition or "") * math.sqrt(1 - PERSONAL_SHARE)
        shifts = self.cohort.ratings.get(scale or item, {})
        shift = sum(shifts.get(name, 0.0) for name in dict.fromkeys((condition or "", *levels)))
        return int(rate_opinions(own + moment + shift, points))

    def _opinion(self, what: str, item: str, *about: str) -> float:
        """Standard normal, correlated between items by `items_alike`."""
        alike = self.cohort.items_alike
        own = self._random(what, item, *about).normal()
        return own if not alike else math.sqrt(1 - alike) * own + math.sqrt(alike) * self._random(what, *about).normal()

    @property
    def drops_out(self) -> bool:
        """Whether the person does not finish."""
        return bool(self._random("drop out").random() < self.cohort.drop_out)

    @property
    def is_shown_own(self) -> bool:
        """Whether a policy is shown as theirs: one that the gate finds surely better for them."""
        return bool(self._random("shown").random() < self.cohort.shown)

    def rank(self, ranking: str, options: Sequence[str]) -> list[str]:
        """All options, best first, by Luce's rule: each place goes to one that is left, by shares of first choices."""
        first_choice, names = self.cohort.first_choice.get(ranking, {}), sorted(options)
        rest = (1 - sum(first_choice.values())) / max(1, sum(name not in first_choice for name in names))
        shares = np.array([first_choice.get(name, rest) for name in names])
        utility = np.log(shares) + self._random("ranking", ranking).gumbel(size=len(names))
        return [names[k] for k in np.argsort(-utility)]

    def slips(self, condition: str, query: str, role: str) -> bool:
        """Whether this answer is not what the person would usually say."""
        return bool(self._random("slip", condition, query, role).random() < self.cohort.lapse_rate(condition))

    def takes_second(self, condition: str, query: str, role: str) -> bool:
        """Whether the second trajectory is taken whatever it is."""
        return bool(self._random("second", condition, query, role).random() < self.cohort.second_shown)

    def usual(self, query: str) -> int:
        """Which of a query's two trajectories the person usually prefers where no oracle decides: 0 or 1."""
        return int(self._random("usual", query).integers(2))

    def prefers_own(self, scene: str, against: str) -> bool:
        """Whether the own policy's rollout is preferred in this comparison. People differ in how much they like theirs,
        so that answers of one person depend on each other."""
        other = self.cohort.own_against_other
        share = self.cohort.own if other is None or against != "other" else other
        if 0 < share < 1:
            share = self._random("own").beta(share * ALIKE, (1 - share) * ALIKE)
        return bool(self._random("own", scene, against).random() < share)


def simulate_data(
    cohort: Cohort,
    participants: int,
    *,
    first: int = 0,
    items: Sequence[str] = ITEMS,
    rankings: Sequence[str] = RANKINGS,
    conditions: Sequence[str] = CONDITIONS,
    queries: int = QUERIES,
    repeats: int = 0,
    comparisons: int = 0,
    opponents: Sequence[str] = OPPONENTS,
    within: Levels | None = None,
    between: Levels | None = None,
    scales: Sequence[Scale] = (),
) -> StudyData:
    """A data set of the cohort's people `first`, `first` + 1, ..., as the interface study would leave it.

    repeats: queries asked again in every condition. comparisons: so many of the own policy against each opponent.
    within, between: factors, of which everybody meets every combination or their group's, in place of conditions; a
    group's people come in turn. scales: asked under every condition. Trajectories have names only, so nothing that
    measures them can be computed.
    """
    protocol = {"stages": [{"block": {"each": within, "one_of": between}}]} if within or between else {}
    cells = _cells(within) if within else _cells({"condition": conditions})
    groups = _cells(between or {})
    people: list[ParticipantRow] = []
    choices: list[Choice] = []
    ratings: list[Rating] = []
    compared: list[Comparison] = []
    for number in range(first, first + participants):
        person, code = cohort.person(number), f"S{number + 1:03d}"
        group, of_group = list(groups.items())[number % len(groups)]
        mine = cells if within or not between else {group: of_group}
        state = "expired" if person.drops_out else "completed"
        of = {"block": group} if between else {}
        own = ("shown" if person.is_shown_own else "not_surely_better") if comparisons else None
        people.append(ParticipantRow(code, True, None, False, state, tuple(mine), of, own))
        for condition, levels in mine.items():
            at = (*levels, *(of_group if between else ()))
            ratings += [
                Rating(code, condition, "interface_items", i, person.rate(i, condition, levels=at)) for i in items
            ]
            ratings += [
                Rating(code, condition, scale.name, item.key, _rate_agreement(person, item, scale, condition, at))
                for scale in scales
                for item in scale.items
            ]
            roles = [("regular", k) for k in range(queries)] + [("repeat", k) for k in range(repeats)]
            choices += [_choice(person, code, condition, role, f"{code}-{k}") for role, k in roles]
        ratings += [Rating(code, None, "view_ranking", r, person.rank(r, list(cells))) for r in rankings]
        for against in opponents if comparisons and person.is_shown_own else ():
            for k in range(comparisons):
                won = person.prefers_own(str(k), against)
                compared.append(Comparison(code, *(("own", against) if won else (against, "own")), look_alike=False))
    of_scales = [(scale.name, scale) for scale in scales]
    return StudyData("simulated", "simulated", protocol, "", [], people, choices, ratings, compared, scales=of_scales)


def _cells(factors: Levels) -> dict[str, tuple[str, ...]]:
    """Every combination of levels by its name; one without a name where there are no factors."""
    return {"-".join(levels): levels for levels in product(*factors.values())}


def _rate_agreement(
    person: SimulatedPerson, item: ScaleItem, scale: Scale, condition: str, levels: Sequence[str]
) -> int:
    """An answer to an item of a scale, turned round where agreeing lowers the score."""
    points = person.rate(item.key, condition, scale.points, levels=levels, scale=scale.name)
    return scale.points + 1 - points if item.reversed else points


def _choice(person: SimulatedPerson, code: str, condition: str, role: str, query: str) -> Choice:
    shown = f"{query}-a", f"{query}-b"
    prefers = person.usual(query) ^ person.slips(condition, query, role)
    if person.takes_second(condition, query, role):
        prefers = 1
    return Choice(code, condition, condition, query, role, *shown, chosen=shown[prefers], decision_s=None)


def read_cohort(file: Path) -> Cohort:
    """A cohort written as YAML, its keys those of `Cohort`. Raises CohortError naming what cannot be."""
    try:
        data = Source(file.name, file_text(file)).data
        return _COHORT.validate_json(json.dumps(data), strict=True)
    except ProtocolError as problem:
        raise CohortError(f"cohort = {file.name!r}: cannot be read ({problem})") from None
    except ValidationError as wrong:
        problems = "; ".join(f"{'.'.join(map(str, error['loc'])) or 'it'}: {error['msg']}" for error in wrong.errors())
        known = ", ".join(field.name for field in fields(Cohort))
        raise CohortError(f"cohort = {file.name!r}: {problems}; a mapping with some of the keys {known}") from None


_COHORT = TypeAdapter(Cohort)
