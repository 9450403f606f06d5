"""Simulated people who rank objects by how much they mattered to the robot, agreeing with the scores as well as stated.

Marked as such; so that what the analysis of chapter 8 must find is known. Other simulated people are
`simulated_cohorts.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import kendall_tau_b
from desirepath.report.simulated_cohorts import CohortError, rate_opinions
from desirepath.report.study_data import (
    AWARENESS,
    FACTORS,
    ImportanceRanking,
    ItemText,
    ParticipantRow,
    Rating,
    StudyData,
)

Doubles = NDArray[np.float64]
OBJECTS = ("couch", "table", "cupboard", "box", "pillar")
QUESTIONNAIRE = "explanation_items"
ITEMS = (*(f"{part}_{k}" for part in AWARENESS for k in (1, 2)), "trust", "plausibility")
TRIALS = 12  # per condition, as in chapter 8
UNSEEN = (0.65, 0.25, 0.10)  # ours: chance that 0, 1 or 2 of the five objects have no score
PERSON_SHARE, ALIKE = 0.4, 0.5  # ours: of ratings' variance, the person's; of items of one score, in common
Effect = tuple[float, float, float]
"""What outlines, the lidar, and both beyond their sum add."""


def _effect(gain: Effect, outline: bool, lidar: bool) -> float:
    return gain[0] * outline + gain[1] * lidar + gain[2] * (outline and lidar)


@dataclass(frozen=True)
class RankerCohort:
    """What is put in; the default is nothing but agreement above chance (a null cohort).

    tau: mean agreement (Kendall's tau, of objects without ties) where nothing is shown. gain: what is added to it.
    person_sd, effect_sd: of people's own tau, and of what a factor adds to it for each. ratings: score -> shifts in
    standard deviations of opinions: `awareness`, `trust`, `plausibility`. seed: of everything.

    The deviations are those that chapter 8's numbers leave for people after what 12 trials per condition make by
    themselves (SD of a single tau about 0.35): SD of a mean 0.11 to 0.12, of the difference 0.126 (F = 15.2, n = 24).
    """

    tau: float = 0.42
    gain: Effect = (0.0, 0.0, 0.0)
    person_sd: float = 0.07
    effect_sd: float = 0.075
    ratings: Mapping[str, Effect] = field(default_factory=dict)
    seed: int = 0

    def __post_init__(self) -> None:
        for lidar, outline in product((False, True), repeat=2):
            mean = self.tau + _effect(self.gain, outline, lidar)
            if not 0 <= mean <= 0.95:
                raise CohortError(f"tau = {self.tau}, gain = {self.gain}: a mean agreement lies between 0 and 0.95")


PUBLISHED = RankerCohort(
    tau=0.42, gain=(0.10, 0.0, 0.0), ratings={"awareness": (0.55, 0.55, -0.5), "plausibility": (0.0, 0.9, 0.0)}
)
"""Chapter 8: tau .52 with outlines, .42 without; awareness 4.6 with neither, 5.5 to 5.6 with any; plausibility with the
lidar alone."""


def simulate_rankings(
    cohort: RankerCohort, participants: int, *, first: int = 0, trials: int = TRIALS, factors: Sequence[str] = FACTORS
) -> StudyData:
    """A data set of the cohort's people `first`, `first` + 1, ..., as the study of chapter 8 would leave it."""
    people, ratings, rankings = [], [], []
    cells = list(product((False, True), repeat=len(factors)))
    for number in range(first, first + participants):
        code = f"S{number + 1:03d}"
        of_cell = [dict.fromkeys(FACTORS, False) | dict(zip(factors, cell, strict=True)) for cell in cells]
        names = [condition_name(**of) for of in of_cell]
        people.append(ParticipantRow(code, True, None, False, "completed", tuple(names)))
        random = np.random.default_rng([cohort.seed, number, 8])
        own = random.normal(0, cohort.person_sd)
        more = random.normal(0, cohort.effect_sd, len(FACTORS))
        for name, of in zip(names, of_cell, strict=True):
            mean = cohort.tau + _effect(cohort.gain, **of) + own
            mean += sum(sd * (of[factor] - 0.5) for factor, sd in zip(FACTORS, more, strict=True))
            scores = draw_scores(random, trials)
            places = draw_ranking(scores, mean, random)
            for k in range(trials):
                sliders = dict(zip(OBJECTS, np.round(scores[k], 4).tolist(), strict=True))
                order = tuple(OBJECTS[thing] for thing in np.argsort(places[k], kind="stable"))
                rankings.append(
                    ImportanceRanking(code, name, f"{name}-{k}", "regular", ranking=order, scores=sliders, **of)
                )
        ratings += _rate(cohort, code, number, names, of_cell)
    protocol = {"protocol": "simulated", "version": 1}
    return StudyData(
        "simulated", "simulated", protocol, "", item_texts(), people, [], ratings, [], importance=rankings
    )  # fmt: skip


def condition_name(*, outline: bool, lidar: bool) -> str:
    """A condition as protocols name it: its levels."""
    return f"{'outline' if outline else 'plain'}-{'lidar' if lidar else 'bare'}"


def item_texts() -> list[ItemText]:
    """The eight items; every second one of the awareness score is reversed."""
    return [
        ItemText(QUESTIONNAIRE, key, "scale", key.replace("_", " "), 7, {}, reversed=key.endswith("_2"))
        for key in ITEMS
    ]


def draw_scores(random: np.random.Generator, trials: int) -> Doubles:
    """(trials, 5) scores: uniform, the greatest 1, of none to two objects 0."""
    scores = random.random((trials, len(OBJECTS)))
    hidden = random.choice(len(UNSEEN), trials, p=UNSEEN)
    scores[random.random(scores.shape).argsort(axis=1).argsort(axis=1) < hidden[:, None]] = 0.0
    return np.asarray(scores / scores.max(axis=1, keepdims=True))


def draw_ranking(scores: Doubles, tau: float, random: np.random.Generator) -> NDArray[np.int64]:
    """(n, k) places 0, 1, ... that somebody gives to objects by scores (n, k) whose order they perceive through noise,
    so that their tau with orders without ties is `tau` on average."""
    order = scores.argsort(axis=1).argsort(axis=1).astype(float)
    order += random.normal(0, noise_for(tau), scores.shape)
    return (-order).argsort(axis=1).argsort(axis=1)


def noise_for(tau: float) -> float:
    """Standard deviation of the noise, in places, at which rankings of five have that mean tau (0.01 to 0.98)."""
    noise, taus = _curve()
    return float(np.interp(-min(max(tau, 0.01), 0.98), -taus, noise))


@cache
def _curve() -> tuple[Doubles, Doubles]:
    """Noise (increasing) and the mean tau that it leaves (decreasing), of 40,000 rankings each."""
    random = np.random.default_rng(0)
    noise = np.concatenate([np.linspace(0.2, 8, 60), np.geomspace(8.5, 400, 12)])
    places = np.tile(np.arange(float(len(OBJECTS))), (40_000, 1))
    drawn = random.normal(size=places.shape)
    taus = np.array([kendall_tau_b(places, places + sd * drawn).mean() for sd in noise])
    return noise, np.minimum.accumulate(taus)


def simulate_ratings(cohort: RankerCohort, code: str, number: int) -> list[Rating]:
    """What somebody says after each of the four blocks of outline x lidar, whatever they ranked."""
    of_cell = [dict(zip(FACTORS, cell, strict=True)) for cell in product((False, True), repeat=len(FACTORS))]
    return _rate(cohort, code, number, [condition_name(**of) for of in of_cell], of_cell)


def _rate(
    cohort: RankerCohort, code: str, number: int, names: Sequence[str], of_cell: Sequence[Mapping[str, bool]]
) -> list[Rating]:
    random = np.random.default_rng([cohort.seed, number, 9])
    ratings = []
    for score, items in (("awareness", ITEMS[:-2]), ("trust", ("trust",)), ("plausibility", ("plausibility",))):
        own = random.normal(0, PERSON_SHARE**0.5)
        for name, of in zip(names, of_cell, strict=True):
            opinion = own + _effect(cohort.ratings.get(score, (0.0, 0.0, 0.0)), **of)
            common = random.normal(0, (ALIKE * (1 - PERSON_SHARE)) ** 0.5)
            for item in items:
                at = opinion + common + random.normal(0, ((1 - ALIKE) * (1 - PERSON_SHARE)) ** 0.5)
                value = int(rate_opinions(at, 7))
                ratings.append(Rating(code, name, QUESTIONNAIRE, item, 8 - value if item.endswith("_2") else value))
    return ratings
