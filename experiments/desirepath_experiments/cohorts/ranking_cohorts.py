"""Studies of chapter 8 with simulated people: how often each effect is found, where it was put in and where nothing
was.

Everything here is simulated. The people are `report/simulated_rankers.py`'s, the analysis is the report's own.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.explanation_findings import analyse_rankings
from desirepath.report.rating_findings import measures
from desirepath.report.simulated_power import Rate, Tell, rate
from desirepath.report.simulated_rankers import RankerCohort, simulate_rankings

ANY = "any of tau's effects, corrected"
ANY_RATED = "any effect on what was rated, corrected"


def ranking_cohorts(
    cohort: RankerCohort,
    cohorts: int = 1_000,
    participants: int = 24,
    *,
    plan: AnalysisPlan | None = None,
    tell: Tell = lambda done: None,
) -> tuple[list[Rate], dict[str, float]]:
    """How often each test is significant by itself, and any of a family after correction; each condition's mean tau.

    A test's name ends in `, aligned ranks` where it is the one that stands beside.
    """
    plan = plan or AnalysisPlan()
    found, seen = Counter[str](), Counter[str]()
    means: dict[str, list[float]] = {}
    for k in range(cohorts):
        data = simulate_rankings(cohort, participants, first=k * participants)
        of = analyse_rankings(data.importance, measures(data, plan, []), plan, intervals=False)
        assert of is not None  # noqa: S101  everybody ranked
        for one in (of.agreement, *of.rated):
            for test, check in zip(one.tests, one.checks, strict=True):
                for name, p in ((test.about, test.p), (f"{test.about}, aligned ranks", check.ranks.p)):
                    seen[name] += 1
                    found[name] += p <= plan.alpha
        families = {ANY: of.agreement.tests, ANY_RATED: [test for one in of.rated for test in one.tests]}
        for name, tests in families.items():
            seen[name] += 1
            found[name] += any(test.significant(plan.alpha) for test in tests)
        for name, mean in of.agreement.means.items():
            means.setdefault(name, []).append(mean.mean)
        tell((k + 1) / cohorts)
    rates = [rate(name, found[name], seen[name]) for name in seen]
    return rates, {name: round(float(np.mean(values)), 4) for name, values in means.items()}
