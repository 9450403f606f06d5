"""Whether the analysis finds what was put into a cohort, and nothing that was not, counted over many cohorts.

Everything here is simulated. Cohorts in which nothing differs, and power: `simulated_power.py`.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings
from desirepath.report.simulated_cohorts import CONDITIONS, ITEMS, RANKINGS, Cohort, simulate_data
from desirepath.report.simulated_power import FEW_QUERIES, Rate, Tell, analyse_simulated, rate

OTHER_ITEM = "any item in which nothing was put, corrected"
OTHER_RANKING = "any ranking in which nothing was put, corrected"
OTHER_PAIR = "any pair of conditions that do not differ, of an item in which something was put"


def known_cohorts(
    cohort: Cohort,
    cohorts: int = 500,
    participants: int = 31,
    *,
    plan: AnalysisPlan | None = None,
    tell: Tell = lambda done: None,
) -> list[Rate]:
    """Share of cohorts in which each item and ranking with something in it is found, then in which anything else is.

    Items and rankings are those of chapter 7. Raises ValueError for an item or ranking that it does not have.
    """
    known = {"ratings": ITEMS, "first_choice": RANKINGS}
    for name, there in known.items():
        for key in getattr(cohort, name):
            if key not in there:
                raise ValueError(f"{name}.{key}: known are {', '.join(there)}")
    plan = plan or AnalysisPlan()
    found: Counter[str] = Counter()
    for k in range(cohorts):
        data = simulate_data(cohort, participants, first=k * participants, queries=FEW_QUERIES)
        found.update(_found(analyse_simulated(data, plan), cohort, plan.alpha))
        tell((k + 1) / cohorts)
    tests = [*cohort.ratings, *cohort.first_choice, OTHER_ITEM, OTHER_RANKING, OTHER_PAIR]
    return [rate(test, found[test], cohorts) for test in tests]


def _found(findings: Findings, cohort: Cohort, alpha: float) -> set[str]:
    names: set[str] = set()
    for one in findings.items:
        shifts = cohort.ratings.get(one.item.key)
        if one.test.significant(alpha):
            names.add(OTHER_ITEM if shifts is None else one.item.key)
        if shifts is None:
            continue
        for (first, second), test in zip(combinations(CONDITIONS, 2), one.pairs, strict=False):  # none: not significant
            if shifts.get(first, 0.0) == shifts.get(second, 0.0) and test.significant(alpha):
                names.add(OTHER_PAIR)
    for ranking in findings.rankings:
        if ranking.test.significant(alpha):
            names.add(ranking.item.key if ranking.item.key in cohort.first_choice else OTHER_RANKING)
    return names
