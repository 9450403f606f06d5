"""What a planned study compares, and what is assumed to differ in it.

Which tests should then find it, and how often they do, is `simulated_power.py`'s.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Annotated

from pydantic import Field

from desirepath.analysis.scales import Scale
from desirepath.report.simulated_cohorts import OPPONENTS, Cohort, simulate_data
from desirepath.report.simulated_rankers import TRIALS
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
        """A simulated study of this design."""
        scored = {scale.name for scale in self.scales}
        return simulate_data(
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
        factors = {**self.within, **self.between}
        return factors or ({CONDITION: self.conditions} if len(self.conditions) > 1 else {})

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


def plan_factors(design: StudyDesign) -> dict[str, Mapping[str, Sequence[str]]]:
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
