"""Every test of every design over many simulated studies: how often it finds something where nothing differs (at most
alpha), and where something does, by number of people.

Everything here is simulated. Whole studies like the interface study are in `interface_cohorts.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from typing import Annotated, Any

import pydantic
from pydantic import Field

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings
from desirepath.report.planned_design import PlannedDesign
from desirepath.report.simulated_cohorts import CONDITIONS, Cohort
from desirepath.report.simulated_power import analyse_simulated
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.cohorts.counting import Said, count

ITEM, RANKING, COMPARED = "fun", "usefulness", 5
TWO = ("immersive", "top_down")
VIEW, VIEWS = {"view": TWO}, {"view": CONDITIONS}
SPEED = {"speed": ("fast", "slow")}
CELLS = tuple(f"{view}-{speed}" for view in TWO for speed in SPEED["speed"])
PLAIN = PlannedDesign(TWO, (ITEM,), (), 1, 0)
DESIGNS: dict[str, PlannedDesign] = {
    "two conditions": replace(PLAIN, within=VIEW),
    "three conditions": replace(PLAIN, conditions=CONDITIONS, within=VIEWS, rankings=(RANKING,), comparisons=COMPARED),
    "two groups": replace(PLAIN, between=VIEW),
    "three groups": replace(PLAIN, conditions=CONDITIONS, between=VIEWS),
    "2 x 2 within": replace(PLAIN, conditions=CELLS, within={**VIEW, **SPEED}),
    "3 x 2 within": replace(PLAIN, conditions=CELLS, within={**VIEWS, **SPEED}),
    "2 within x 2 groups": replace(PLAIN, within=VIEW, between=SPEED),
    "2 x 2 groups": replace(PLAIN, conditions=CELLS, between={**VIEW, **SPEED}),
}
"""Each with one item; the one of three conditions with a ranking and comparisons of the own policy, too."""


@pydantic.dataclasses.dataclass(frozen=True)
class DesignConfig:
    """How many studies of every design, and how much differs."""

    cohorts: Annotated[int, Field(ge=1, description="Of each design and number of people.")] = 1_000
    participants: Annotated[tuple[int, ...], Field(min_length=1, description="Numbers of people.")] = (6, 12, 31)
    effect: Annotated[
        float, Field(description="Standard deviations by which one condition is rated higher; 0: nothing differs.")
    ] = 0.0
    seed: Annotated[int, Field(ge=0)] = 0


def benchmark_design_cohorts(config: DesignConfig, progress: Progress | None = None) -> dict[str, Any]:
    """`rates`: how often each test is significant by itself (uncorrected), a row per design, test and number of people.

    With an effect also 60 % rank `immersive` first, and the own policy is preferred in 75 % (both arms).
    """
    plan, effect = AnalysisPlan(alpha=0.05), config.effect
    cohort = Cohort(
        ratings={ITEM: {"immersive": effect}},
        first_choice={RANKING: {"immersive": 0.6}} if effect else {},
        own=0.75 if effect else 0.5,
        seed=config.seed,
    )

    def said(design: PlannedDesign, size: int, number: int) -> Said:
        findings = analyse_simulated(design.study(cohort, size, first=number * size), plan)
        return ((test, p <= plan.alpha) for test, p in _every_p(findings))

    rows = [
        {"design": name, "participants": size, "test": of.test, "rate": of.rate, "low": of.low, "high": of.high}
        | {"cohorts": of.n}
        for name, design in DESIGNS.items()
        for size in config.participants
        for of in count(config.cohorts, partial(said, design, size))
    ]
    return {"simulated": True, **asdict(config), "alpha": plan.alpha, "rates": rows}


def _every_p(findings: Findings) -> Iterator[tuple[str, float]]:
    for item in findings.items:
        for test in item.tests:
            yield f"{test.test}, {test.about.removeprefix(f'rating of {ITEM}, ')}", test.p
    for ranking in findings.rankings:
        yield "Chi-square of first choices", ranking.test.p
    for of in findings.personalised:
        for test in (of.test, of.beside):
            yield f"{test.test}, own against {of.against}", test.p
