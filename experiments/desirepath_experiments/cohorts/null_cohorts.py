"""How often the analysis finds something in cohorts in which nothing differs: every test by itself, and whole families.

Everything here is simulated. Cohorts in which something differs: `known_cohorts.py`.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np

from desirepath.analysis.repeated_measures import pairs_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings
from desirepath.report.simulated_cohorts import CONDITIONS, ITEMS, OPPONENTS, RANKINGS, Cohort, simulate_data
from desirepath.report.simulated_power import COMPARISONS, FEW_QUERIES, Rate, Tell, analyse_simulated, rate
from desirepath.report.study_data import StudyData


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
        data = simulate_data(
            Cohort(seed=seed), participants, first=k * participants, queries=FEW_QUERIES, comparisons=COMPARISONS
        )
        found.update(_rejected(data, analyse_simulated(data, plan), plan.alpha))
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
    names = [f"Friedman, {one.item.key}" for one in found.items if one.test.p <= alpha]
    names += [f"Chi-square, {one.item.key}" for one in found.rankings if one.test.p <= alpha]
    names += [f"Sign test, own against {one.against}" for one in found.personalised if one.test.p <= alpha]
    for words, family in (
        ("Friedman, any item, corrected", [one.test for one in found.items]),
        ("Wilcoxon, any pair of any item, after Friedman and Bonferroni", [t for o in found.items for t in o.pairs]),
        ("Chi-square, any ranking, corrected", [one.test for one in found.rankings]),
        ("z, any pair of any ranking, after chi-square and Bonferroni", [t for o in found.rankings for t in o.pairs]),
        ("Sign test, either, corrected", [one.test for one in found.personalised]),
    ):
        names += [words] if any(test.significant(alpha) for test in family) else []
    rated = {(one.item, one.person, one.condition): one.value for one in data.ratings if one.condition}
    people = [one.code for one in data.people]
    for item in ITEMS:
        ratings = np.array([[rated[item, person, name] for name in CONDITIONS] for person in people])
        for pair, test in zip(combinations(CONDITIONS, 2), pairs_of(ratings, CONDITIONS, about=item), strict=True):
            names += [f"Wilcoxon, {'/'.join(pair)}"] if test.p <= alpha else []
    return names
