"""Every test of every design over many simulated studies: how often it finds something where nothing differs (at most
alpha), and where something does, by number of people.

Everything here is simulated. Whole studies like the interface study are in `null_cohorts.py` and `known_cohorts.py`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings
from desirepath.report.planned_design import PlannedDesign
from desirepath.report.simulated_cohorts import CONDITIONS, Cohort
from desirepath.report.simulated_power import Rate, Tell, analyse_simulated, rate

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


def design_cohorts(
    cohorts: int = 1_000,
    participants: Sequence[int] = (6, 12, 31),
    *,
    effect: float = 0.0,
    seed: int = 0,
    alpha: float = 0.05,
    tell: Tell = lambda done: None,
) -> list[dict[str, object]]:
    """How often each test is significant by itself (uncorrected), a row per design, test and number of people.

    effect: standard deviations by which the item is rated higher under `immersive`; then also 60 % rank it first, and
    the own policy is preferred in 75 % (both arms). 0: nothing differs.
    """
    cohort = Cohort(
        ratings={ITEM: {"immersive": effect}},
        first_choice={RANKING: {"immersive": 0.6}} if effect else {},
        own=0.75 if effect else 0.5,
        seed=seed,
    )
    rows = []
    sizes = [(name, size) for name in DESIGNS for size in participants]
    for done, (name, size) in enumerate(sizes):
        found, seen = Counter[str](), Counter[str]()
        for k in range(cohorts):
            findings = analyse_simulated(DESIGNS[name].study(cohort, size, first=k * size), AnalysisPlan(alpha=alpha))
            for test, p in _every_p(findings):
                seen[test] += 1
                found[test] += p <= alpha
        rows += [_row(name, size, rate(test, found[test], seen[test])) for test in seen]
        tell((done + 1) / len(sizes))
    return rows


def _every_p(findings: Findings) -> Iterator[tuple[str, float]]:
    for one in findings.items:
        for test in one.tests:
            yield f"{test.test}, {test.about.removeprefix(f'rating of {ITEM}, ')}", test.p
    for ranking in findings.rankings:
        yield "Chi-square of first choices", ranking.test.p
    for of in findings.personalised:
        for test in (of.test, of.beside):
            yield f"{test.test}, own against {of.against}", test.p


def _row(design: str, size: int, of: Rate) -> dict[str, object]:
    return {
        "design": design, "participants": size, "test": of.test, "rate": of.rate, "low": of.low, "high": of.high,
        "cohorts": of.n,
    }  # fmt: skip
