"""How often a planned study's importance rankings show what is assumed: outlines, or the lidar, raise agreement.

The people are `made_up_rankers.py`'s; power of everything else is `simulated_power.py`'s.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.explanation_findings import FACTORS, explained
from desirepath.report.made_up_rankers import TRIALS, RankerCohort, made_up_rankings

STANDS_FOR = {"attention": "outline"}  # either shows the scores, so that the made-up people are the same
FEWEST = 3  # people whom an analysis of variance can be made of


@dataclass(frozen=True)
class RankedDesign:
    """What of a study its rankings' power depends on. factors: of outline, attention and lidar those that vary, within
    people; trials: rankings of everybody in each condition."""

    factors: tuple[str, ...] = ()
    trials: int = TRIALS

    @property
    def tests(self) -> list[str]:
        """What the power is told of, in order."""
        effects = [*self.factors, " × ".join(self.factors)] if len(self.factors) > 1 else list(self.factors)
        return [f"tau, {effect} (over {len(effects)} test{'s' if len(effects) > 1 else ''})" for effect in effects]


def assumed_cohort(design: RankedDesign, tau: float, tau_gain: float, seed: int) -> RankerCohort:
    """People whose agreement rises from `tau` by `tau_gain` where the first factor that varies is shown. Raises
    CohortError for agreements that cannot be."""
    at = FACTORS.index(STANDS_FOR.get(design.factors[0], design.factors[0]))
    return RankerCohort(tau=tau, gain=(tau_gain * (at == 0), tau_gain * (at == 1), 0.0), seed=seed)


def ranking_found(
    design: RankedDesign,
    cohort: RankerCohort,
    participants: int,
    cohorts: int,
    *,
    plan: AnalysisPlan | None = None,
    drop_out: float = 0.0,
) -> Counter[str]:
    """In how many of so many made-up studies each test finds its effect after correction."""
    plan = plan or AnalysisPlan()
    factors = tuple(STANDS_FOR.get(factor, factor) for factor in design.factors)
    found = Counter[str]()
    for k in range(cohorts):
        random = np.random.default_rng([cohort.seed, participants, k])
        finished = int(random.binomial(participants, 1 - drop_out))
        if finished < FEWEST:
            continue
        data = made_up_rankings(
            cohort, finished, first=k * participants, trials=design.trials, factors=factors
        )  # fmt: skip
        of = explained(data.importance, (), plan, intervals=False)
        tests: Sequence[bool] = [test.significant(plan.alpha) for test in of.agreement.tests] if of else []
        found.update(name for name, said in zip(design.tests, tests, strict=False) if said)
    return found
