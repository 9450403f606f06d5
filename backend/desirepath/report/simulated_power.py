"""How often the analysis finds what a cohort was made with: power before recruiting. False findings, of cohorts in
which nothing differs, are counted in `experiments/cohorts`.

Everything here is simulated: people are made up (`made_up_cohorts.py`), studies of them are analysed as real ones are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from desirepath.analysis.estimates import wilson
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings, NothingToReport, analyse
from desirepath.report.planned_design import Assumed, PlannedDesign, found_tests, power_tests
from desirepath.report.planned_statements import statements
from desirepath.report.ranking_power import assumed_cohort, ranking_found
from desirepath.report.study_data import StudyData

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


def analyse_simulated(data: StudyData, plan: AnalysisPlan, *, beside: bool = False) -> Findings:
    """A made-up study's analysis, as a real one's, without what needs trajectories. It has no other questionnaires.
    beside: with what stands beside the declared tests."""
    return analyse(
        data,
        no_trajectories,
        "simulated",
        plan.model_copy(update={"metrics": (), "items": None, "ranking": None}),
        intervals=False,
        beside=beside,
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
    plan, cohort = plan or AnalysisPlan(), assumed.cohort(design.conditions)
    ranked = design.ranked
    rankers = assumed_cohort(ranked, assumed.tau, assumed.tau_gain, assumed.seed) if ranked.factors else None
    beside = statements(design, assumed, plan)
    results: list[Power] = []
    for size in participants:
        tell(f"{cohorts} studies of {size} participants are made up and analysed")
        found: Counter[str] = Counter()
        widths = []
        for k in range(cohorts):
            try:
                findings = analyse_simulated(design.study(cohort, size, first=k * size), plan, beside=bool(beside))
            except NothingToReport:  # nobody finished
                continue
            found.update(found_tests(findings, design, assumed, plan.alpha))
            found.update(name for name, is_said in beside.items() if is_said(findings))
            widths += [of.share.high - of.share.mean for of in findings.between.values()]
        if rankers is not None:
            found += ranking_found(ranked, rankers, size, cohorts, plan=plan, drop_out=assumed.drop_out)
        tests = (*ranked.tests, *power_tests(design, assumed), *beside)
        rates = [rate(test, found[test], cohorts) for test in tests]
        results.append(Power(size, rates, float(np.mean(widths)) if widths else None))
    return results


def enough(found: Sequence[Power]) -> dict[str, int | None]:
    """Of each test, the smallest number of participants tried that has a power of `WANTED`; None where none has."""
    tried = sorted(found, key=lambda one: one.participants)
    reached = [(r.test, one.participants) for one in tried for r in one.rates if r.rate >= WANTED]
    return {r.test: next((n for test, n in reached if test == r.test), None) for one in tried[:1] for r in one.rates}
