"""How often the analysis finds what a cohort was made with: power before recruiting, false findings of null cohorts.

Everything here is simulated: people are made up (`made_up_cohorts.py`), studies of them are analysed as real ones are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from backend.analysis.repeated_measures import pairs_of
from backend.learning.policies.evaluate import wilson
from backend.report.analysis_plan import AnalysisPlan
from backend.report.findings import Findings, analyse
from backend.report.made_up_cohorts import CONDITIONS, ITEMS, OPPONENTS, RANKINGS, Cohort, made_up_study
from backend.report.study_data import StudyData

Tell = Callable[[float], None]
FEW_QUERIES = 2  # of null cohorts: what is tested there are ratings, rankings and comparisons
COMPARISONS = 3
WANTED = 0.8  # power that is usually asked for (Cohen 1988)


@dataclass(frozen=True)
class Rate:
    """How often something was found in `n` cohorts, with the 95 % Wilson interval."""

    test: str
    found: int
    n: int
    rate: float
    low: float
    high: float


def rate(test: str, found: int, n: int) -> Rate:
    estimate = wilson(found, n)
    return Rate(test, found, n, found / n, estimate.low, estimate.high)


def no_trajectories(trajectory: str) -> Any:
    """Made-up studies have no trajectories; their plans ask for no metrics."""
    raise LookupError(f"trajectory {trajectory!r}: made-up people saw none")


def analysed(data: StudyData, plan: AnalysisPlan) -> Findings:
    """A made-up study's analysis, as a real one's, without what needs trajectories. It has no other questionnaires."""
    return analyse(
        data,
        no_trajectories,
        "simulated",
        plan.model_copy(update={"metrics": (), "items": None, "ranking": None}),
        intervals=False,
    )


# ---- null cohorts ----------------------------------------------------------------------------------------------------


def null_cohorts(
    cohorts: int = 1_000,
    participants: int = 31,
    *,
    seed: int = 0,
    plan: AnalysisPlan | None = None,
    tell: Tell = lambda done: None,
) -> list[Rate]:
    """Rejection rates in cohorts in which nothing differs: every test by itself at alpha, and whole families after
    correction, which must stay at alpha."""
    plan = plan or AnalysisPlan()
    found: Counter[str] = Counter()
    for k in range(cohorts):
        data = made_up_study(
            Cohort(seed=seed), participants, first=k * participants, queries=FEW_QUERIES, comparisons=COMPARISONS
        )
        found.update(_rejected(data, analysed(data, plan), plan.alpha))
        tell((k + 1) / cohorts)
    return [rate(test, found[test], n * cohorts) for test, n in _null_tests()]


def _null_tests() -> list[tuple[str, int]]:
    """Every row of the table of null cohorts, with how many tests of it a cohort has."""
    pairs = ["/".join(pair) for pair in combinations(CONDITIONS, 2)]
    return [
        *((f"Friedman, {item}", 1) for item in ITEMS),
        ("Friedman, any item, corrected", 1),
        *((f"Wilcoxon, {pair}", len(ITEMS)) for pair in pairs),
        ("Wilcoxon, any pair of any item, after Friedman and Bonferroni", 1),
        *((f"Chi-square, {ranking}", 1) for ranking in RANKINGS),
        ("Chi-square, any ranking, corrected", 1),
        ("z, any pair of any ranking, after chi-square and Bonferroni", 1),
        *((f"Sign test, own against {against}", 1) for against in OPPONENTS),
        ("Sign test, either, corrected", 1),
    ]


def _rejected(data: StudyData, found: Findings, alpha: float) -> list[str]:
    """The rows of `_null_tests` that this cohort counts for, once per rejection."""
    told = [f"Friedman, {one.item.key}" for one in found.items if one.test.p <= alpha]
    told += [f"Chi-square, {one.item.key}" for one in found.rankings if one.test.p <= alpha]
    told += [f"Sign test, own against {one.against}" for one in found.personalised if one.test.p <= alpha]
    for words, family in (
        ("Friedman, any item, corrected", [one.test for one in found.items]),
        ("Wilcoxon, any pair of any item, after Friedman and Bonferroni", [t for o in found.items for t in o.pairs]),
        ("Chi-square, any ranking, corrected", [one.test for one in found.rankings]),
        ("z, any pair of any ranking, after chi-square and Bonferroni", [t for o in found.rankings for t in o.pairs]),
        ("Sign test, either, corrected", [one.test for one in found.personalised]),
    ):
        told += [words] if any(test.significant(alpha) for test in family) else []
    rated = {(one.item, one.person, one.condition): one.value for one in data.ratings if one.condition}
    people = [one.code for one in data.people]
    for item in ITEMS:
        ratings = np.array([[rated[item, person, name] for name in CONDITIONS] for person in people])
        for pair, test in zip(combinations(CONDITIONS, 2), pairs_of(ratings, CONDITIONS, about=item), strict=True):
            told += [f"Wilcoxon, {'/'.join(pair)}"] if test.p <= alpha else []
    return told


# ---- power -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Assumed:
    """What a planned study is assumed to find, stated by who plans it.

    effect: standard deviations by which one item's ratings are higher under `condition`. first_choice: share of people
    who put that condition first (a third is no effect). consistency: chance of the same answer to the same query. own:
    mean chance that the own policy is preferred.
    """

    condition: str
    item: str
    ranking: str
    effect: float = 0.5
    first_choice: float = 0.5
    consistency: float = 0.8
    own: float = 0.65
    seed: int = 0

    def cohort(self) -> Cohort:
        """Raises CohortError for what no cohort can have."""
        return Cohort(
            ratings={self.item: {self.condition: self.effect}},
            first_choice={self.ranking: {self.condition: self.first_choice}},
            steady=self.consistency,
            own=self.own,
            seed=self.seed,
        )


@dataclass(frozen=True)
class PlannedDesign:
    """What of a study the power depends on, read from its protocol."""

    conditions: tuple[str, ...]
    items: tuple[str, ...]
    rankings: tuple[str, ...]
    queries: int
    comparisons: int
    opponents: tuple[str, ...] = OPPONENTS

    def study(self, cohort: Cohort, participants: int, first: int) -> StudyData:
        """A made-up study of this design."""
        return made_up_study(
            cohort,
            participants,
            first=first,
            items=self.items,
            rankings=self.rankings,
            conditions=self.conditions,
            queries=self.queries,
            comparisons=self.comparisons,
            opponents=self.opponents,
        )


@dataclass(frozen=True)
class Power:
    """One number of participants. agreement_half_width: of the 95 % interval of an agreement between conditions, mean
    over cohorts; None with fewer than two conditions."""

    participants: int
    rates: Sequence[Rate]
    agreement_half_width: float | None

    def rows(self) -> list[dict[str, object]]:
        """For a table or figure, one per test."""
        return [
            {"test": r.test, "participants": self.participants, "power": r.rate, "low": r.low, "high": r.high,
             "cohorts": r.n, "agreement_half_width": self.agreement_half_width}
            for r in self.rates
        ]  # fmt: skip


def power(
    design: PlannedDesign,
    assumed: Assumed,
    participants: Iterable[int],
    *,
    cohorts: int = 500,
    plan: AnalysisPlan | None = None,
    tell: Callable[[str], None] = lambda words: None,
) -> list[Power]:
    """Share of cohorts in which the analysis finds what was assumed, for each number of participants."""
    plan, cohort = plan or AnalysisPlan(), assumed.cohort()
    results: list[Power] = []
    for size in participants:
        tell(f"{cohorts} studies of {size} participants are made up and analysed")
        found: Counter[str] = Counter()
        widths = []
        for k in range(cohorts):
            findings = analysed(design.study(cohort, size, first=k * size), plan)
            found.update(_found(findings, assumed, plan.alpha))
            widths += [of.share.high - of.share.mean for of in findings.between.values()]
        rates = [rate(test, found[test], cohorts) for test in _power_tests(design, assumed)]
        results.append(Power(size, rates, float(np.mean(widths)) if widths else None))
    return results


def enough(found: Sequence[Power]) -> dict[str, int | None]:
    """Of each test, the smallest number of participants tried that has a power of `WANTED`; None where none has."""
    tried = sorted(found, key=lambda one: one.participants)
    reached = [(r.test, one.participants) for one in tried for r in one.rates if r.rate >= WANTED]
    return {r.test: next((n for test, n in reached if test == r.test), None) for one in tried[:1] for r in one.rates}


def _over(number: int, what: str) -> str:
    return f"(over {number} {what}{'s' if number != 1 else ''})"


def _power_tests(design: PlannedDesign, assumed: Assumed) -> list[str]:
    tests = []
    if design.items and len(design.conditions) > 2:
        tests += [f"Friedman, {assumed.item} {_over(len(design.items), 'item')}", "Wilcoxon, against both others"]
    if design.rankings and len(design.conditions) > 1:
        tests.append(f"Chi-square, {assumed.ranking} {_over(len(design.rankings), 'ranking')}")
    if design.comparisons:
        tests += [f"Sign test, own against {opponent}" for opponent in design.opponents]
    return tests


def _found(findings: Findings, assumed: Assumed, alpha: float) -> list[str]:
    told = []
    pairs = list(combinations(findings.conditions, 2))  # as `item_results` tests them
    for one in findings.items:
        if one.item.key == assumed.item and one.test.significant(alpha):
            told.append(f"Friedman, {assumed.item} {_over(len(findings.items), 'item')}")
            mine = [test for pair, test in zip(pairs, one.pairs, strict=True) if assumed.condition in pair]
            if all(test.significant(alpha) for test in mine):
                told.append("Wilcoxon, against both others")
    for ranking in findings.rankings:
        if ranking.item.key == assumed.ranking and ranking.test.significant(alpha):
            told.append(f"Chi-square, {assumed.ranking} {_over(len(findings.rankings), 'ranking')}")
    return told + [
        f"Sign test, own against {one.against}" for one in findings.personalised if one.test.significant(alpha)
    ]
