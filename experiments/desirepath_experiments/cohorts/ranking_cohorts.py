"""Studies of chapter 8 with simulated people: how often each effect is found, where it was put in and where nothing
was.

Everything here is simulated. The people are `report/simulated_rankers.py`'s, the analysis is the report's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Annotated, Any

import numpy as np
import pydantic
from pydantic import Field

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.explanation_findings import analyse_rankings
from desirepath.report.rating_findings import measures
from desirepath.report.simulated_power import Rate
from desirepath.report.simulated_rankers import PUBLISHED, RankerCohort, simulate_rankings
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.cohorts.counting import count

PLAN = AnalysisPlan()
ANY = "any of tau's effects, corrected"
ANY_RATED = "any effect on what was rated, corrected"


@pydantic.dataclasses.dataclass(frozen=True)
class RankingConfig:
    """How many studies of how many people, and whether anything differs."""

    cohorts: Annotated[int, Field(ge=1, description="Studies, 12 rankings in each of 2 x 2 conditions.")] = 1_000
    participants: Annotated[int, Field(ge=3)] = 24
    published: Annotated[bool, Field(description="What chapter 8 found is put in; else nothing differs.")] = False
    seed: Annotated[int, Field(ge=0)] = 0


def benchmark_ranking_cohorts(config: RankingConfig, progress: Progress | None = None) -> dict[str, Any]:
    """As `ranking_cohorts`."""
    cohort = replace(PUBLISHED if config.published else RankerCohort(), seed=config.seed)
    rates, taus = ranking_cohorts(cohort, config.cohorts, config.participants)
    return {
        "simulated": True,
        "cohorts": config.cohorts,
        "participants": config.participants,
        "alpha": PLAN.alpha,
        "correction": PLAN.correction,
        "cohort": asdict(cohort),
        "mean_tau": taus,
        "rates": [asdict(rate) for rate in rates],
    }


def ranking_cohorts(cohort: RankerCohort, cohorts: int, participants: int) -> tuple[list[Rate], dict[str, float]]:
    """How often each test is significant by itself, and any of a family after correction; each condition's mean tau.

    A test's name ends in `, aligned ranks` where it is the one that stands beside.
    """
    means: dict[str, list[float]] = {}

    def said(number: int) -> Iterator[tuple[str, bool]]:
        data = simulate_rankings(cohort, participants, first=number * participants)
        of = analyse_rankings(data.importance, measures(data, PLAN, []), PLAN, intervals=False)
        assert of is not None  # noqa: S101  everybody ranked
        for outcome in (of.agreement, *of.rated):
            for test, check in zip(outcome.tests, outcome.checks, strict=True):
                yield test.about, test.p <= PLAN.alpha
                yield f"{test.about}, aligned ranks", check.ranks.p <= PLAN.alpha
        rated = [test for outcome in of.rated for test in outcome.tests]
        for name, tests in ((ANY, of.agreement.tests), (ANY_RATED, rated)):
            yield name, any(test.significant(PLAN.alpha) for test in tests)
        for name, mean in of.agreement.means.items():
            means.setdefault(name, []).append(mean.mean)

    rates = count(cohorts, said)
    return rates, {name: round(float(np.mean(values)), 4) for name, values in means.items()}
