"""Chapter 5 as tasks: which there are for a budget, with all that their results depend on. No task is computed here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from desirepath.learning.adaptable.objectives import NAMES
from desirepath_experiments.reproduction.driver import read_budgets
from desirepath_experiments.reproduction.tasks import Task

OURS, NO_PERSON, SAC, SAC_DISCOUNTED = "ours", "no_person", "sac", "sac_0.98"
PROGRAMMED, DRAWN = "programmed", "drawn"
SECONDS_PER_UPDATE = 0.009
SECONDS_PER_SAC_UPDATE = 0.03


@dataclass(frozen=True)
class AdaptableBudget:
    """How much is computed. layouts: obstacle layouts of the demonstration; updates: of each training, baselines'
    too; rollouts: per vector; elsewhere: per vector with a walking person and at the intersection; baselines:
    of what else is trained, with the first seed; per_pair: drawn paths of each pair of places in the room; alone:
    whether single-objective policies are trained, with the first seed."""

    name: str
    seeds: tuple[int, ...]
    layouts: int
    cloning_updates: int
    reward_updates: int
    updates: int
    rollouts: int
    elsewhere: int
    baselines: tuple[str, ...] = (NO_PERSON, SAC, SAC_DISCOUNTED)
    per_pair: int = 4
    alone: bool = False


BUDGETS = read_budgets("adaptable", AdaptableBudget)


@dataclass(frozen=True)
class AdaptablePlan:
    """learned: demonstration reward by (source, seed); trained and judged: by (variant, seed); alone: the
    single-objective policy of each objective, rolled out under its own weight."""

    budget: AdaptableBudget
    learned: dict[tuple[str, int], Task]
    trained: dict[tuple[str, int], Task]
    judged: dict[tuple[str, int], Task]
    alone: dict[str, Task]


def make_plan(budget: AdaptableBudget, seeds: Sequence[int] | None = None) -> AdaptablePlan:
    """Which tasks a budget has. seeds: of ours, others than the budget's."""
    plan = AdaptablePlan(budget, {}, {}, {}, {})
    for seed in budget.seeds if seeds is None else seeds:
        for source in (PROGRAMMED, DRAWN):
            plan.learned[source, seed] = _learn_reward(budget, source, seed)
        _add(plan, OURS, seed, plan.learned[PROGRAMMED, seed])
    if seeds is not None:
        return plan
    first = budget.seeds[0]
    for variant in budget.baselines:
        demonstration = plan.learned[PROGRAMMED, first]
        if variant == NO_PERSON:
            plan.learned[NO_PERSON, first] = demonstration = _learn_reward(
                budget, PROGRAMMED, first, without_person=True
            )
        _add(plan, variant, first, demonstration)
    for name in NAMES if budget.alone else ():
        learned = plan.learned[PROGRAMMED, first]
        config = {"seed": first, "updates": budget.updates, "alone": name}
        trained = Task("adaptable", {"config": config}, (learned,), SECONDS_PER_UPDATE * budget.updates)
        rolled = {"rollouts": budget.rollouts, "seed": first, "objective": name}
        plan.alone[name] = Task("alone", rolled, (trained, learned), 0.01 * budget.rollouts)
    return plan


def _learn_reward(budget: AdaptableBudget, source: str, seed: int, *, without_person: bool = False) -> Task:
    params: dict[str, Any] = {"source": source, "seed": seed, "without_person": without_person}
    fewer = 3 if source == DRAWN else 1  # a few hundred steps are cloned, of 16 paths
    params |= {count: getattr(budget, count) // fewer for count in ("cloning_updates", "reward_updates")}
    if source == DRAWN:
        params |= {"environment": "room", "style": "field_of_view", "per_pair": budget.per_pair}
    else:
        params |= {"layouts": budget.layouts}
    return Task("demonstration", params, seconds=0.005 * budget.cloning_updates + 0.03 * budget.reward_updates)


def _add(plan: AdaptablePlan, variant: str, seed: int, demonstration: Task) -> None:
    budget = plan.budget
    if variant in (SAC, SAC_DISCOUNTED):
        params: dict[str, Any] = {"seed": seed, "updates": budget.updates, "gamma": 1.0 if variant == SAC else 0.98}
        task = Task("sac", params, (demonstration,), SECONDS_PER_SAC_UPDATE * budget.updates)
    else:
        config = {"seed": seed, "updates": budget.updates, "without_person": variant == NO_PERSON}
        task = Task("adaptable", {"config": config}, (demonstration,), SECONDS_PER_UPDATE * budget.updates)
    rolled = {"rollouts": budget.rollouts, "elsewhere": budget.elsewhere, "seed": seed}
    plan.trained[variant, seed] = task
    # The rewards of the programmed demonstration judge all, whatever a policy was trained by.
    judge = plan.learned[PROGRAMMED, seed]
    plan.judged[variant, seed] = Task("judged", rolled, (task, judge), 0.01 * 33 * budget.rollouts)
