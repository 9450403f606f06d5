"""Chapter 2 as tasks: which there are for a budget, with all that their results depend on. No task is computed here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from desirepath.demonstrations.controllers import BASELINES
from desirepath.demonstrations.demonstrators import STYLES
from desirepath.demonstrations.judging import KINDS
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath_experiments.reproduction.driver import read_budgets
from desirepath_experiments.reproduction.tasks import Task

OURS = "ours"
WITHOUT = "no_demonstrations"
CONTROLLERS = (OURS, *BASELINES)
VARIANTS: dict[str, dict[str, Any]] = {  # what training is without one of its parts
    OURS: {},
    "no_cloning": {"bc_weight": [0.0, 0.0]},
    "no_boost": {"goal_boost": DemonstrationConfig().explored_goal},
    "neither": {"bc_weight": [0.0, 0.0], "goal_boost": DemonstrationConfig().explored_goal},
    # As base policies are trained: the goal's whole reward where it is reached, progress, and a long random beginning.
    WITHOUT: {
        "demonstrations": False,
        "near": 0.0,
        "mixed": 0.0,
        "explored_goal": 5.0,
        "progress_weight": 1.0,
        "random_transitions": 50_000,
    },
}
PER_PAIR = 4  # demonstrations; the thesis's participants gave three to five
SECONDS_PER_UPDATE = 0.0025
SECONDS_PER_BASELINE_SCENE = 0.05
JUDGED_S = 1.0


@dataclass(frozen=True)
class DemonstrationsBudget:
    """How much is computed. ablated: the style for which every variant is trained, in the first environment.
    controls: ablation and training without demonstrations; else ours alone is trained.
    """

    name: str
    environments: tuple[str, ...]
    seeds: tuple[int, ...]
    updates: int
    ablated: str
    unseen: int
    styles: tuple[str, ...] = tuple(STYLES)
    per_pair: int = PER_PAIR
    controls: bool = True


BUDGETS = read_budgets("demonstrations", DemonstrationsBudget)


class ControllerCell(NamedTuple):
    """One controller of one demonstrator's: environment, style, variant or baseline, seed."""

    environment: str
    style: str
    controller: str
    seed: int


@dataclass(frozen=True)
class DemonstrationsPlan:
    """trained: the training of a cell; judged: its rollouts from demonstrated starts; unseen: those elsewhere, for a
    baseline the same task in every style's cell, because it knows of none.
    """

    budget: DemonstrationsBudget
    trained: dict[ControllerCell, Task]
    judged: dict[ControllerCell, Task]
    unseen: dict[ControllerCell, Task]

    def cells(self, environment: str, style: str, controller: str) -> list[ControllerCell]:
        """Of every seed."""
        return [ControllerCell(environment, style, controller, seed) for seed in self.budget.seeds]


def make_plan(budget: DemonstrationsBudget) -> DemonstrationsPlan:
    """Which tasks a budget has."""
    plan = DemonstrationsPlan(budget, {}, {}, {})
    for environment, style, seed in product(budget.environments, budget.styles, budget.seeds):
        variants: Sequence[str] = (OURS, WITHOUT) if budget.controls else (OURS,)
        if budget.controls and (environment, style) == (budget.environments[0], budget.ablated):
            variants = tuple(VARIANTS)
        shown = {"environment": environment, "style": style, "per_pair": budget.per_pair, "seed": seed}
        elsewhere = {"environment": environment, "seed": seed, "scenes": budget.unseen}
        for variant in variants:
            cell = ControllerCell(environment, style, variant, seed)
            config = {"seed": seed, "updates": budget.updates, **VARIANTS[variant]}
            # Who learns without demonstrations is one controller for all styles; the style only tells beside which
            # demonstrations its curve is measured.
            beside = budget.ablated if variant == WITHOUT else style
            learned = {**shown, "style": beside, "config": config}
            training = Task("controller", learned, seconds=budget.updates * SECONDS_PER_UPDATE)
            plan.trained[cell] = training
            plan.judged[cell] = Task("judged", {**shown, "controller": OURS}, (training,), JUDGED_S)
            plan.unseen[cell] = Task("unseen", {**elsewhere, "controller": OURS}, (training,), JUDGED_S)
        for baseline in BASELINES:
            cell = ControllerCell(environment, style, baseline, seed)
            seconds = SECONDS_PER_BASELINE_SCENE * len(KINDS) * budget.unseen
            plan.judged[cell] = Task("judged", {**shown, "controller": baseline}, seconds=JUDGED_S)
            plan.unseen[cell] = Task("unseen", {**elsewhere, "controller": baseline}, seconds=seconds)
    return plan
