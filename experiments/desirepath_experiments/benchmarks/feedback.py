"""`desirepath benchmark feedback`: how much each way of answering tells the posterior of a session in a participant's
time, and how well it then predicts them. People are simulated, of the families of `people/card.yaml`; nobody is real.

All ways ask about the same drives, drawn at random, by the one posterior over the nine objectives. An answer takes as
long as its drives play with their letters, `CHOICE_S`, and for every further judgement `DEGREE_S`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import cycle
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from desirepath.analysis.estimates import mean_estimate
from desirepath.learning.errors import LearningError
from desirepath.learning.people.asked_people import NINE, people_of
from desirepath.learning.people.card import people_card
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.families.mixture import ObjectiveMember
from desirepath.learning.preferences.evidence.evidence import Evidence
from desirepath.learning.preferences.evidence.graded_pair import Degree, GradedPair, Possible
from desirepath.learning.preferences.evidence.marked_moment import MarkedMoment
from desirepath.learning.preferences.evidence.ranking import Ranking
from desirepath.learning.preferences.evidence.rating import Rating
from desirepath.learning.preferences.marked_steps import MOMENT_S
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import NAMES, gains
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig
from desirepath.learning.preferences.spans import moments, part_measures, seen_measures
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.trajectory import Trajectory, arrived
from desirepath.study.kinds.order import PLACE_S
from desirepath.study.kinds.trial import DEGREE_S
from desirepath.study.simulated.participant import MORE_TO_BE_CLEAR, NOTICES, SEES_WITHIN
from desirepath_experiments.benchmarks.people_room import RobotOfLibrary, true_scores
from desirepath_experiments.benchmarks.results import Progress

Doubles = NDArray[np.float64]
SEED = 9_300  # of scenes, of no card
LETTER_S, CHOICE_S = 2.0, 5.0  # before each drive, for an answer, as in `study/steps.py`
IN_A_RANKING = 4
POINTS = 7


@pydantic.dataclasses.dataclass(frozen=True)
class FeedbackConfig:
    """Who answers how."""

    setup: Annotated[str, Field(description="With a policy library, whose rollouts are shown.")] = "study_room"
    family: Annotated[str, Field(description="Families of the card, comma-separated; held_out, tuning, nine.")] = (
        "held_out"
    )
    people: Annotated[int, Field(ge=1, le=1_000, description="Of each family.")] = 4
    kinds: Annotated[str, Field(description="Ways to answer, comma-separated; default all.")] = ""
    minutes: Annotated[tuple[int, ...], Field(min_length=1, description="After which it is measured.")] = (2, 5, 10)
    scenes: Annotated[int, Field(ge=20, description="Half of them are asked about, half predicted.")] = 200
    particles: Annotated[int, Field(ge=500, description="Of the posterior.")] = 4_000
    seed: int = 0


@dataclass(frozen=True)
class Drives:
    """Several rollouts in each of n scenes. measured (n, k, spans, 7); seconds (n, k); value (n, k): to one person, in
    typical differences."""

    measured: Doubles
    seconds: Doubles
    value: Doubles
    moments: Sequence[Sequence[tuple[Doubles, Doubles]]]
    """By scene and rollout: measured (m, spans, 7) and value (m,) of its parts of `MOMENT_S` each."""


@dataclass
class Person:
    """What one simulated person makes of drives: sees their worth with noise, has criteria of their own."""

    drives: Drives
    random: np.random.Generator

    def __post_init__(self) -> None:
        self.noticed = self.random.uniform(*NOTICES)
        self.clear = self.noticed + self.random.uniform(*MORE_TO_BE_CLEAR)
        self.rated: list[tuple[Doubles, float]] = []

    def look(self, count: int) -> tuple[Doubles, Doubles, float]:
        """At so many drives of one scene: what they measure, what they seem worth, and seconds until they are seen."""
        scene = self.random.integers(len(self.drives.value))
        rows = self.random.choice(self.drives.value.shape[1], count, replace=False)
        noise = self.random.normal(0, SEES_WITHIN / math.sqrt(2), count)
        watched = float(self.drives.seconds[scene, rows].sum()) + LETTER_S * count
        return self.drives.measured[scene, rows], self.drives.value[scene, rows] + noise, watched


Answered = tuple[list[Evidence], float]
"""What was answered, and how long it took, seconds."""


def _pair(possible: Possible) -> Callable[[Person], Answered]:
    def answer(person: Person) -> Answered:
        measured, seems, watched = person.look(2)
        advantage = float(seems[0] - seems[1])
        tied = possible % 2 == 1 and abs(advantage) < person.noticed
        clearly: Degree = "clear" if abs(advantage) > person.clear else "slight"
        degree: Degree | None = "no_difference" if tied else clearly if possible >= 4 else None
        judged = CHOICE_S + DEGREE_S * (possible >= 4 and not tied)
        better: Literal[-1, 0, 1] = 0 if tied else 1 if advantage > 0 else -1
        return [GradedPair(measured, better, degree, possible)], watched + judged

    return answer


def _order(said: int, of: int = IN_A_RANKING) -> Callable[[Person], Answered]:
    def answer(person: Person) -> Answered:
        measured, seems, watched = person.look(of)
        return [Ranking(measured[np.argsort(-seems)], said)], watched + CHOICE_S + PLACE_S * (min(said, of - 1) - 1)

    return answer


def _piles(piles: int, of: int = IN_A_RANKING) -> Callable[[Person], Answered]:
    """As many in each pile as in every other, as simulated participants do it."""

    def answer(person: Person) -> Answered:
        measured, seems, watched = person.look(of)
        order = np.argsort(seems)
        said: list[Evidence] = [
            Rating(np.roll(measured, -1 - row, axis=0), 1 + place * piles // of, piles)
            for place, row in enumerate(order.tolist())
        ]
        return said, watched + CHOICE_S + PLACE_S * (of - 1)

    return answer


def _rating(person: Person) -> Answered:
    measured, seems, watched = person.look(1)
    person.rated.append((measured[0], float(seems[0])))
    everything = np.array([worth for _, worth in person.rated])
    place = float((everything < seems[0]).mean()) + 0.5 / len(everything)
    rating = 1 + min(int(POINTS * place), POINTS - 1)
    return [Rating(np.stack([drive for drive, _ in person.rated]), rating, POINTS)], watched + CHOICE_S


def _mark(person: Person) -> Answered:
    """The worst moment of one drive is marked while it plays, then it is said what was bad about it."""
    scene = int(person.random.integers(len(person.drives.value)))
    row = int(person.random.integers(person.drives.value.shape[1]))
    measured, value = person.drives.moments[scene][row]
    seems = value + person.random.normal(0, SEES_WITHIN / math.sqrt(2), len(value))
    return [MarkedMoment(measured[np.argsort(seems)])], float(person.drives.seconds[scene, row]) + DEGREE_S


KINDS: Mapping[str, tuple[Callable[[Person], Answered], ...]] = {
    "choice": (_pair(2),),
    "choice_or_tie": (_pair(3),),
    "choice_and_degree": (_pair(4),),
    "all_of_a_pair": (_pair(5),),
    "best_of_four": (_order(1),),
    "order_of_three": (_order(3, 3),),
    "order_of_four": (_order(IN_A_RANKING),),
    "order_of_five": (_order(5, 5),),
    "three_piles_of_five": (_piles(3, 5),),
    "rating": (_rating,),
    "worst_moment": (_mark,),
    "pairs_and_orders": (_pair(5), _order(IN_A_RANKING)),
    "ratings_and_orders": (_rating, _order(IN_A_RANKING)),
}
"""Each way, or several in turn."""


def benchmark_feedback(config: FeedbackConfig, progress: Progress) -> dict[str, Any]:
    """{"simulated", "setup", "config", "rows", "persons"}: by family ("all" first) and kind, `bits_per_minute` that
    answers move what is believed by, answers per minute, and by minutes the share of pairs in other scenes that is
    predicted, each with 95 % over people. Raises LearningError for an unknown family or kind."""
    kinds = [name for name in config.kinds.split(",") if name] or list(KINDS)
    if unknown := [name for name in kinds if name not in KINDS]:
        raise LearningError(f"kinds = {unknown[0]!r}: known are {', '.join(KINDS)}")
    everybody = list(_everybody(config))
    rollouts = _roll_out(config)
    persons: list[dict[str, Any]] = []
    for number, (family, name, person) in enumerate(everybody):
        drives = _valued(person, rollouts, config.setup)
        for kind in kinds:
            random = np.random.default_rng([config.seed, number, 71])
            measured = _ask(KINDS[kind], drives, config, random)
            persons.append({"family": family, "person": name, "kind": kind, **measured})
        progress.tell(f"{number + 1} of {len(everybody)}: {name}")
        progress.keep(_result(config, kinds, persons))
    return _result(config, kinds, persons)


def _everybody(config: FeedbackConfig) -> Iterator[tuple[str, str, FamilyMember]]:
    card = people_card()
    groups = {"held_out": card.held_out, "tuning": card.tuning}
    for family in groups.get(config.family) or config.family.split(","):
        if family not in (*card.families, NINE):
            raise LearningError(f"family = {family!r}: known are {', '.join((*card.families, NINE))}")
        for name, person in people_of(family, config.people, config.setup, config.seed * config.people).items():
            yield family, name, person


def _roll_out(config: FeedbackConfig) -> list[list[Trajectory]]:
    """Scene by scene, what the base policy and those of the library that arrive in all scenes do; at least four."""
    scenes = scene_set(config.setup, config.scenes, purpose=Purpose.REPORT, seed=SEED + config.seed)
    found = RobotOfLibrary.load(config.setup).roll_out_library(scenes)
    by_policy = [found.usual, *found.trajectories]
    success = np.array([arrived(of_one) for of_one in by_policy])
    usual = [k for k in np.argsort(-success.mean(1), kind="stable") if success[k].mean() > 0.5]
    kept = usual[: max(IN_A_RANKING + 1, len(usual) // 2)]
    return [[by_policy[k][n] for k in kept] for n in range(len(scenes)) if success[kept, n].all()]


def _valued(person: FamilyMember, rollouts: Sequence[Sequence[Trajectory]], setup: str) -> Drives:
    flat = [one for of_scene in rollouts for one in of_scene]
    shape = len(rollouts), len(rollouts[0])
    seen = seen_measures(flat)
    seconds = np.array([one.duration_s for one in flat]).reshape(shape)
    value = np.asarray(true_scores(person, flat)) / person.unit(setup)
    parts = [[part for part in moments(one, MOMENT_S) if 2 * part.duration_s >= MOMENT_S] or [one] for one in flat]
    together = [part for of_one in parts for part in of_one]
    seen_parts = part_measures(together)
    worth_parts = _worth_of_parts(person, together, seen_parts[:, 0] / typical_differences(setup)) / person.unit(setup)
    ends = np.cumsum([len(of_one) for of_one in parts])[:-1]
    marked = list(zip(np.split(seen_parts, ends), np.split(worth_parts, ends), strict=True))
    by_scene = [marked[k * shape[1] : (k + 1) * shape[1]] for k in range(shape[0])]
    return Drives(seen.reshape(*shape, *seen.shape[1:]), seconds, value.reshape(shape), by_scene)


def _worth_of_parts(person: FamilyMember, parts: Sequence[Trajectory], measured: Doubles) -> Doubles:
    """(n,) measured: (n, 7) of parts, in typical differences: who has one objective judges a part by these."""
    if isinstance(person, ObjectiveMember):
        of_objective: Doubles = gains(measured)[:, NAMES.index(person.objective)]
        return of_objective
    return np.asarray(true_scores(person, parts))


def _ask(
    ways: Sequence[Callable[[Person], Answered]], drives: Drives, config: FeedbackConfig, random: np.random.Generator
) -> dict[str, Any]:
    """One person in one way, until the last of the minutes."""
    half = len(drives.value) // 2
    asked = Drives(drives.measured[:half], drives.seconds[:half], drives.value[:half], drives.moments[:half])
    pairs = np.random.default_rng([config.seed, 72]).permuted(
        np.tile(np.arange(len(drives.value[0])), (half, 1)), axis=1
    )
    rows, (first, second) = np.arange(half, 2 * half), pairs[:, :2].T
    tested = drives.measured[rows, first] - drives.measured[rows, second]
    better = drives.value[rows, first] - drives.value[rows, second]
    truth, differ = better > 0, better != 0
    person, posterior = Person(asked, random), Posterior.prior(config.setup, PosteriorConfig(config.particles))
    seconds, bits, answers, accuracy = 0.0, 0.0, 0, {}
    turns, left = cycle(ways), list(config.minutes)
    while left:
        evidence, took = next(turns)(person)
        while left and seconds + took > 60 * left[0]:
            right = (posterior.predict(tested) > 0.5) == truth
            accuracy[str(left.pop(0))] = float(right[differ].mean())
        if left:
            for one in evidence:
                bits += posterior.bits_of(one)
                posterior = posterior.observed(one)
            seconds, answers = seconds + took, answers + 1
    minutes = seconds / 60
    return {"bits_per_minute": bits / minutes, "answers_per_minute": answers / minutes, "predicted": accuracy}


def _result(config: FeedbackConfig, kinds: Sequence[str], persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    families = list(dict.fromkeys(str(one["family"]) for one in persons))
    rows = [
        {"family": family, "kind": kind} | _row([one for one in persons if one["kind"] == kind and one["family"] in of])
        for family, of in (("all", families), *((name, [name]) for name in families))
        for kind in kinds
    ]
    return {
        "simulated": True,
        "setup": config.setup,
        "config": asdict(config),
        "rows": rows,
        "persons": list(persons),
    }


def _row(persons: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    numbers = ("bits_per_minute", "answers_per_minute")
    row: dict[str, Any] = {name: _spread([one[name] for one in persons]) for name in numbers}
    minutes = persons[0]["predicted"] if persons else {}
    return row | {"predicted": {m: _spread([one["predicted"][m] for one in persons]) for m in minutes}}


def _spread(values: Sequence[float]) -> list[float]:
    """Mean, and its 95 % where there are several people."""
    if len(values) < 2:
        return [round(float(value), 4) for value in values]
    found = mean_estimate(values)
    return [round(float(value), 4) for value in (found.value, found.low, found.high)]
