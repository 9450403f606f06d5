"""What stands beside the declared tests, and lent policies, over many simulated studies: how often each finds something
where nothing differs, and where something does; how often intervals hold the truth.

Everything here is simulated. The declared tests of every design are `design_cohorts.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from desirepath.analysis.choices import binomial_test, share_over_people
from desirepath.analysis.equivalence import equivalence
from desirepath.analysis.reliability import reliability
from desirepath.report.analysis_plan import AnalysisPlan, Equivalence
from desirepath.report.further_findings import Further, analyse_further
from desirepath.report.own_findings import compare_own
from desirepath.report.rating_findings import measures
from desirepath.report.simulated_cohorts import Cohort, rate_opinions, simulate_data
from desirepath.report.study_data import Choice, Comparison, Rating, StudyData
from desirepath.report.study_design import designs_of
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.cohorts.counting import Said, count

ITEM = "fun"
TWO = ("immersive", "top_down")
MARGIN = 1.0  # points of seven, within which a difference counts as none
STEPS = 1.5  # points of seven for a standard deviation of opinions (`rate_opinions`)
STRONG = 3.0  # Bayes factor that is often called evidence (Jeffreys 1961)
GROUP = 10  # people who finish together
QUALITY_SD = 1.0  # of policies, log-odds: some are better whoever looks
ITEMS_ALIKE = 0.4  # correlation of a scale's items


@pydantic.dataclasses.dataclass(frozen=True)
class FurtherConfig:
    """How many studies of how many people."""

    cohorts: Annotated[
        int, Field(ge=1, description="Of each number of people; ten times as many of what needs no mixed model.")
    ] = 200
    participants: Annotated[tuple[int, ...], Field(min_length=1, description="Numbers of people.")] = (6, 12, 31)
    seed: Annotated[int, Field(ge=0)] = 0


def benchmark_further_cohorts(config: FurtherConfig, progress: Progress | None = None) -> dict[str, Any]:
    """`rates`: a row per statement, truth and number of people: how often it was made, with the 95 % interval of
    that."""

    def said(of: Callable[[int, int], Said], size: int, number: int) -> Said:
        return of(size, config.seed * 1_000_000 + number)

    rows = [
        {"truth": truth, "participants": size, "statement": measured_rate.test, "rate": measured_rate.rate}
        | {"low": measured_rate.low, "high": measured_rate.high, "cohorts": measured_rate.n}
        for size in config.participants
        for truth, of in CASES.items()
        for measured_rate in count(
            config.cohorts * (1 if of in (_nothing, _something) else 10), partial(said, of, size)
        )
    ]
    return {"simulated": True, "seed": config.seed, "alpha": PLAN.alpha, "rates": rows}


PLAN = AnalysisPlan(metrics=(), equivalence=Equivalence(rating=MARGIN), bayes_factors=True, models=True)


def _study(size: int, seed: int, cohort: Cohort) -> StudyData:
    """Two conditions, half of the people in either order, repeats, comparisons with two other policies."""
    data = simulate_data(
        replace(cohort, seed=seed), size, items=(ITEM,), rankings=(), conditions=TWO, queries=8, repeats=6,
        comparisons=5,
    )  # fmt: skip
    people = [replace(person, order=TWO[:: 1 if k % 2 else -1]) for k, person in enumerate(data.people)]
    return replace(data, people=people)


def _beside(data: StudyData) -> Further:
    return analyse_further(data, measures(data, PLAN, []), designs_of(data), PLAN, [TWO])


def _statements(further: Further) -> Said:
    """What is said of two conditions and of own against others."""
    for test in further.order_effects:
        yield ("Carry-over" if "carry-over" in test.about else "Period"), test.p <= PLAN.alpha
    if further.against_retest is not None:
        yield "Agreement between conditions is below consistency", further.against_retest.p <= PLAN.alpha
    for weighed in further.weighed:
        what = "own policy" if "own policy" in weighed.about else "rating"
        if not math.isnan(weighed.factor):
            yield f"Bayes factor of at least {STRONG:g}, {what}", weighed.factor >= STRONG
    for model in further.models:
        if model.test is not None:
            yield f"Mixed model, {model.about}", model.test.p <= PLAN.alpha
        elif model.effects:
            _, _, low, high = model.effects[0]
            yield f"Mixed model, {model.about}: interval without one half", not low <= 0.5 <= high
    for worth in further.worths:
        if worth.name == "the own policy" and not math.isnan(worth.low):
            yield "Bradley-Terry: interval of the own policy's worth without 0", not worth.low <= 0 <= worth.high


def _nothing(size: int, seed: int) -> Said:
    yield from _statements(_beside(_study(size, seed, Cohort())))
    random = np.random.default_rng([seed, 1])
    yield "Guess", binomial_test(int(random.binomial(size, 0.5)), size, about="guess").p <= PLAN.alpha


def _something(size: int, seed: int) -> Said:
    """The second condition is rated 1 SD higher, the own policy preferred in 75 %, 80 % guess right; in the other
    condition a quarter of the queries is answered the other way, for good; who meets the conditions in the second order
    rates both 1 SD higher, everybody the second one met 1 SD higher."""
    data = _study(size, seed, Cohort(ratings={ITEM: {TWO[0]: 1.0}}, own=0.75))
    yield from ((name, hit) for name, hit in _statements(_beside(_flip(data, seed))) if name not in ORDER)
    yield from ((name, hit) for name, hit in _statements(_beside(_add_order(data))) if name in ORDER)
    random = np.random.default_rng([seed, 1])
    yield "Guess", binomial_test(int(random.binomial(size, 0.8)), size, about="guess").p <= PLAN.alpha


ORDER = ("Period", "Carry-over")


def _flip(data: StudyData, seed: int) -> StudyData:
    random = np.random.default_rng([seed, 2])
    queries = sorted({choice.query for choice in data.choices})
    other = {query for query, turned in zip(queries, random.random(len(queries)) < 0.25, strict=True) if turned}

    def answered(choice: Choice) -> Choice:
        return (
            replace(choice, chosen=choice.rejected) if choice.query in other and choice.condition == TWO[0] else choice
        )

    return replace(data, choices=[answered(choice) for choice in data.choices])


def _add_order(data: StudyData) -> StudyData:
    order = {person.code: person.order for person in data.people}

    def rated(rating: Rating) -> Rating:
        later = order[rating.person].index(str(rating.condition)) + (order[rating.person][0] == TWO[0])
        return replace(rating, value=min(7, rating.value + round(STEPS) * later))

    return replace(data, ratings=[rated(rating) for rating in data.ratings])


def _at_the_margin(size: int, seed: int) -> Said:
    """Equivalence must not be found where the difference is as large as the margin."""
    yield "Equivalence within the margin", _equivalent(size, seed, MARGIN)


def _no_difference(size: int, seed: int) -> Said:
    yield "Equivalence within the margin", _equivalent(size, seed, 0.0)


def _equivalent(size: int, seed: int, difference: float) -> bool:
    random = np.random.default_rng([seed, 3])
    return equivalence(random.normal(difference, STEPS, size), MARGIN, about="ratings").p <= PLAN.alpha


def _compare_lent(size: int, seed: int, *, own: float) -> Said:
    """Own against another's in groups who finish together, policies of different quality: everybody of a group is lent
    the same one, or each another one."""
    random = np.random.default_rng([seed, 4])
    quality = random.normal(0, QUALITY_SD, size)
    for words, lenders in (("the same policy for a group", False), ("different policies", True)):
        compared: list[Comparison] = []
        for person in range(size):
            group = person // GROUP
            lender = (person + GROUP) % size if lenders else (group + 1) * GROUP % size
            lender = lender if lender != person else (person + 1) % size
            odds = math.log(own / (1 - own)) + quality[person] - quality[lender]
            chance = 1 / (1 + math.exp(-odds))
            for won in random.random(5) < chance:
                arms = ("own", "other") if won else ("other", "own")
                compared.append(Comparison(str(person), *arms, look_alike=False, opponent=str(lender)))
        counted = [
            compare_own(compared, PLAN),
            compare_own([replace(comparison, opponent=None) for comparison in compared], PLAN),
        ]
        for (of,), unit in zip(counted, ("lent policies", "people"), strict=True):
            if lenders and unit == "people":
                continue
            for test in (of.test, of.beside):
                yield f"{test.test}, own against other's, {words}, counted by {unit}", test.p <= PLAN.alpha


def _intervals(size: int, seed: int) -> Said:
    """Whether 95 % intervals hold what is true: shares of people who differ, alpha of a scale of five items."""
    random = np.random.default_rng([seed, 5])
    for share in (0.5, 0.85):
        wins = random.binomial(5, random.beta(4 * share, 4 * (1 - share), size))
        of = share_over_people(wins.tolist(), (5 - wins).tolist())
        yield f"interval of a share of {share:g} holds it", of.low <= share <= of.high
    alpha = reliability(_scale(random, size))
    if not math.isnan(alpha.low):
        yield "interval of Cronbach's alpha holds it", alpha.low <= _true_alpha() <= alpha.high


def _scale(random: np.random.Generator, size: int) -> NDArray[np.int64]:
    common = random.normal(0, math.sqrt(ITEMS_ALIKE), (size, 1))
    return rate_opinions(common + random.normal(0, math.sqrt(1 - ITEMS_ALIKE), (size, 5)), 7)


@cache
def _true_alpha() -> float:
    return reliability(_scale(np.random.default_rng(0), 200_000)).alpha


CASES: dict[str, Callable[[int, int], Said]] = {
    "nothing differs": _nothing,
    "something differs": _something,
    "the difference is the margin": _at_the_margin,
    "no difference": _no_difference,
    "nobody prefers the own policy": lambda size, seed: _compare_lent(size, seed, own=0.5),
    "the own policy is preferred in 75 %": lambda size, seed: _compare_lent(size, seed, own=0.75),
    "intervals": _intervals,
}
