"""What a planned study compares, what is assumed to differ in it, and which tests should then find it.

How often they do is counted in `simulated_power.py`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Annotated

from pydantic import Field

from desirepath.analysis.scales import Scale
from desirepath.report.findings import Findings
from desirepath.report.item_tests import ItemResult
from desirepath.report.made_up_cohorts import OPPONENTS, Cohort, made_up_study
from desirepath.report.ranking_power import RankedDesign
from desirepath.report.study_data import StudyData
from desirepath.report.study_design import CONDITION, StudyDesign

Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class Assumed:
    """What a planned study is assumed to find, stated by who plans it.

    condition: or a level of a factor. effect: of a scale, every item's. first_choice: a third is no effect. own:
    against the base policy. shown: the others compare nothing. tau, tau_gain: Kendall's; outlines, or the lidar where
    outlines are no factor; the defaults are chapter 8's.
    """

    condition: Annotated[str, Field(description="The condition with the effect; default the last by name.")] = ""
    item: Annotated[str, Field(description="The item with the effect; default the first.")] = ""
    ranking: Annotated[str, Field(description="The ranking with the effect; default the first.")] = ""
    effect: Annotated[float, Field(description="Standard deviations by which one item is rated higher.")] = 0.5
    first_choice: Annotated[
        float, Field(ge=0.01, le=0.99, description="Share of people who rank that condition first.")
    ] = 0.5
    consistency: Annotated[float, Field(ge=0.5, le=1, description="Chance of the same answer to the same query.")] = 0.8
    own: Annotated[Share, Field(description="Mean chance that the own policy is preferred.")] = 0.65
    own_against_other: Annotated[
        float | None, Field(ge=0, le=1, description="The same against another participant's; default as --own.")
    ] = None
    items_alike: Annotated[Share, Field(description="Correlation between the items.")] = 0.0
    drop_out: Annotated[Share, Field(description="Share of participants who do not finish.")] = 0.0
    shown: Annotated[
        Share, Field(description="Share of those who finish that the gate lets compare their own policy.")
    ] = 1.0
    tau: Annotated[
        float, Field(ge=0, le=0.95, description="Agreement of importance rankings where nothing is shown.")
    ] = 0.42
    tau_gain: Annotated[float, Field(ge=0, le=0.95, description="What outlines (or the lidar) add to it.")] = 0.10
    seed: Annotated[int, Field(ge=0)] = 0

    def cohort(self, cells: Sequence[str] = ()) -> Cohort:
        """Raises CohortError for what no cohort can have. cells: what can be ranked; a level is none of them."""
        ranked = not cells or self.condition in cells
        return Cohort(
            ratings={self.item: {self.condition: self.effect}},
            first_choice={self.ranking: {self.condition: self.first_choice}} if ranked else {},
            steady=self.consistency,
            own=self.own,
            own_against_other=self.own_against_other,
            items_alike=self.items_alike,
            drop_out=self.drop_out,
            shown=self.shown,
            seed=self.seed,
        )


@dataclass(frozen=True)
class PlannedDesign:
    """What of a study the power depends on, read from its protocol. conditions: as answers carry them. within, between:
    factors with their levels; without any the conditions are one that everybody meets. scales: with items of theirs in
    `items`, each by its name. ranked: its importance rankings."""

    conditions: tuple[str, ...]
    items: tuple[str, ...]
    rankings: tuple[str, ...]
    queries: int
    comparisons: int
    opponents: tuple[str, ...] = OPPONENTS
    within: Mapping[str, Sequence[str]] = field(default_factory=dict)
    between: Mapping[str, Sequence[str]] = field(default_factory=dict)
    scales: tuple[Scale, ...] = ()
    ranked: RankedDesign = field(default_factory=RankedDesign)

    def study(self, cohort: Cohort, participants: int, first: int) -> StudyData:
        """A made-up study of this design."""
        scored = {scale.name for scale in self.scales}
        return made_up_study(
            cohort,
            participants,
            first=first,
            items=[item for item in self.items if item not in scored],
            rankings=self.rankings,
            conditions=self.conditions,
            queries=self.queries,
            comparisons=self.comparisons,
            opponents=self.opponents,
            within=self.within or ({} if self.between else self.factors),
            between=self.between,
            scales=self.scales,
        )

    @property
    def factors(self) -> dict[str, Sequence[str]]:
        """Every factor with its levels."""
        found = {**self.within, **self.between}
        return found or ({CONDITION: self.conditions} if len(self.conditions) > 1 else {})

    @property
    def effects(self) -> list[tuple[str, ...]]:
        """What is tested of one item."""
        names = list(self.factors)
        return [effect for size in range(1, len(names) + 1) for effect in combinations(names, size)]

    @property
    def places(self) -> tuple[str, ...]:
        """Where an effect can be put: conditions, and levels of factors."""
        levels = [level for of in self.factors.values() for level in of]
        return tuple(dict.fromkeys((*self.conditions, *levels)))


def power_tests(design: PlannedDesign, assumed: Assumed) -> list[str]:
    """The names of the tests whose power is told, in order."""
    tests: list[str] = []
    if design.items and design.factors:
        number = len(design.items) * len(design.effects)
        for effect in design.effects:
            tests.append(_omnibus(design, effect, assumed, number))
            if len(effect) == 1 and assumed.condition in design.factors[effect[0]]:
                tests += _against_others(design, effect[0])
    if design.rankings and len(design.conditions) > 1:
        tests.append(f"Chi-square, {assumed.ranking} {_over(len(design.rankings), 'ranking')}")
    if design.comparisons:
        tests += [f"Sign test, own against {opponent}" for opponent in design.opponents]
        tests += [f"Signed ranks, own against {opponent}" for opponent in design.opponents]
    return tests


def _omnibus(design: PlannedDesign, effect: tuple[str, ...], assumed: Assumed, number: int) -> str:
    if len(design.factors) > 1:
        return f"{' × '.join(effect)}, {assumed.item} {_over(number, 'test')}"
    two = len(design.factors[effect[0]]) == 2
    name = ("Mann-Whitney" if two else "Kruskal-Wallis") if design.between else ("Wilcoxon" if two else "Friedman")
    return f"{name}, {assumed.item} {_over(number, 'item')}"


def _against_others(design: PlannedDesign, factor: str) -> list[str]:
    levels = design.factors[factor]
    if len(levels) < 3:
        return []
    name = "Mann-Whitney" if factor in design.between else "Wilcoxon"
    others = "both others" if len(levels) == 3 else "all others"
    return [f"{name}, against {others}" if len(design.factors) == 1 else f"{name}, {factor}, against {others}"]


def _over(number: int, what: str) -> str:
    return f"(over {number} {what}{'s' if number != 1 else ''})"


def found_tests(findings: Findings, design: PlannedDesign, assumed: Assumed, alpha: float) -> list[str]:
    """Which of `power_tests` found what was assumed."""
    tests: list[str] = []
    number = len(design.items) * len(design.effects)
    for one in findings.items:
        if one.item.key == assumed.item:
            for effect, test in zip(design.effects, one.tests, strict=True):
                if test.significant(alpha):
                    tests.append(_omnibus(design, effect, assumed, number))
            tests += _pairs_found(one, design, assumed, alpha)
    for ranking in findings.rankings:
        if ranking.item.key == assumed.ranking and ranking.test.significant(alpha):
            tests.append(f"Chi-square, {assumed.ranking} {_over(len(findings.rankings), 'ranking')}")
    for of in findings.personalised:
        names = ("Sign test", "Signed ranks") if of.test.test == "Sign test" else ("Signed ranks", "Sign test")
        tests += [f"{names[0]}, own against {of.against}"] if of.test.significant(alpha) else []
        tests += [f"{names[1]}, own against {of.against}"] if of.beside.p <= alpha else []
    return tests


def _pairs_found(one: ItemResult, design: PlannedDesign, assumed: Assumed, alpha: float) -> list[str]:
    """Whether the assumed level was found to differ from every other one of its factor."""
    tests = []
    for factor, levels in design.factors.items():
        if assumed.condition in levels and len(levels) > 2:
            about = one.tests[design.effects.index((factor,))].about
            pairs = [pair for pair in one.pairs if pair.about.startswith(f"{about}, ")]
            mine = [
                pair for names, pair in zip(combinations(levels, 2), pairs, strict=False) if assumed.condition in names
            ]
            if mine and all(pair.significant(alpha) for pair in mine):
                tests += _against_others(design, factor)
    return tests


def as_planned(design: StudyDesign) -> dict[str, Mapping[str, Sequence[str]]]:
    """The factors of a design that was met, for a `PlannedDesign`, whose conditions are called by their levels alone:
    where a single level of another factor stands in the cells' names, it is told with the level beside it."""
    within = dict(design.within)
    named = len(within) > 0 and list(design.cells) == ["-".join(cell) for cell in product(*within.values())]
    if not design.between and len(within) == 1 and (CONDITION in within or not named):
        within = {}
    elif within and not named:
        first = [levels[0] for levels in within.values()]
        around = re.fullmatch("(.*?)" + "-(.*?)".join(map(re.escape, first)) + "(.*)", design.cells[0])
        before, *after = around.groups() if around else [""] * (len(first) + 1)
        before_each = [before, *after[:-1]]
        within = {
            factor: [before_each[k] + level + (after[-1] if k + 1 == len(first) else "") for level in levels]
            for k, (factor, levels) in enumerate(within.items())
        }
    return {"within": within, "between": dict(design.between)}
