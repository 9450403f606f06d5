"""Chapter 6 as tasks: which there are for a budget, with all that their results depend on. No task is computed here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.relabelling import RelabellingConfig
from desirepath.learning.alignment.thesis import thesis_config
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import FAST_HEADS
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.shipped_files import shipped_names
from desirepath.learning.td3.base import BaseConfig
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath_experiments.reproduction.enquery.alignment_settings import stored_alignment
from desirepath_experiments.reproduction.enquery.budgets import (
    CONDITIONED,
    CONDITIONS,
    FIRST_SEED,
    FROM_CONDITIONED,
    RECIPES,
    SEEDS_PER_RUN,
    SETUP,
    TEST_SEED,
    EnqueryBudget,
    Source,
)
from desirepath_experiments.reproduction.tasks import Task


@dataclass(frozen=True)
class Speed:
    """Seconds of one TD3 update on this machine, by heads, for the estimate."""

    per_update: dict[tuple[int, int], float]


@dataclass(frozen=True)
class EnqueryPlan:
    """All tasks of one reproduction, by what they are for. alignments: (recipe, condition) -> one task per run."""

    budget: EnqueryBudget
    seed: int
    base: Task
    ensemble: Task
    sweep: dict[float, Task]
    accuracies: list[Task]
    raw: Task
    alignments: dict[tuple[str, str], list[Task]]

    @property
    def recipes(self) -> dict[str, str]:
        """The recipes that are compared, with what they are called."""
        return {recipe: RECIPES[recipe] for recipe in dict.fromkeys(recipe for recipe, _ in self.alignments)}

    def tasks(self) -> list[Task]:
        runs = [task for tasks in self.alignments.values() for task in tasks]
        return [self.base, self.ensemble, *self.sweep.values(), self.raw, *self.accuracies, *runs]


def query_seed(seed: int, run: int) -> int:
    """Seed of the queries of one repetition or alignment; both conditions of a source share them, 15 being the first
    of 60."""
    return FIRST_SEED + SEEDS_PER_RUN * seed + run


def align_config(recipe: str, budget: EnqueryBudget, run: int) -> RelabellingConfig:
    """The configuration of one alignment: the thesis's recipe or ours, with the budget's number of updates."""
    if recipe == "thesis":
        config: RelabellingConfig = replace(
            thesis_config(seed=run, epochs=budget.thesis_epochs), updates=budget.thesis_updates * budget.thesis_epochs
        )
    else:
        config = FineTuningConfig(
            seed=run, updates=budget.fine_tuning_updates, checkpoints=budget.fine_tuning_checkpoints
        )
    return replace(
        config,
        selection_scenes=budget.selection_scenes,
        gate=GateRule(scenes=budget.gate_scenes),
        replay_transitions=budget.replay_transitions,
    )


def search_config(budget: EnqueryBudget, run: int) -> ConditioningSearchConfig:
    """The configuration of one conditioning search, as long as the budget says."""
    usual = ConditioningSearchConfig(seed=run, tried=budget.search_tried)
    return replace(usual, selection_scenes=min(budget.selection_scenes, usual.selection_scenes))


def make_plan(budget: EnqueryBudget, seed: int, speed: Speed) -> EnqueryPlan:
    """The tasks. Raises ValueError for a seed without scenes of its own."""
    if not 0 <= seed < SEEDS_PER_RUN:
        raise ValueError(f"seed = {seed}: between 0 and {SEEDS_PER_RUN - 1}")
    fast, own = speed.per_update[FAST_HEADS], speed.per_update[budget.heads]
    shipped = _shipped("base", f"{SETUP}/base", [load_policy(f"{SETUP}/base")])
    base, ensemble = shipped, _shipped("ensemble", f"{SETUP}/ensemble", load_ensemble(SETUP))
    if budget.train:
        config = BaseConfig(SETUP, seed=seed, heads=budget.heads, updates=budget.base_updates)
        base = Task("train_base", config.as_dict(), seconds=60 + own * config.updates)
        members = PolicyEnsembleConfig(seed=seed, steps=budget.ensemble_steps, base_transitions=budget.base_transitions)
        ensemble = Task("train_ensemble", members.as_dict(), (base,), seconds=10 + own * 4 * members.steps)
    sweep = {
        kappa: Task(
            "sweep",
            {
                "config": PolicyEnsembleConfig(
                    seed=seed, kappa=kappa, steps=max(budget.marks), base_transitions=budget.base_transitions
                ).as_dict(),
                "marks": list(budget.marks),
                "states": budget.states,
                "scenes": {"seed": FIRST_SEED + seed, "n": budget.sweep_scenes},
            },
            (shipped,),
            seconds=2 + fast * 4 * max(budget.marks) + 0.01 * len(budget.marks) * budget.sweep_scenes,
        )
        for kappa in budget.kappas
    }
    accuracies = [
        Task(
            "accuracy",
            {
                "query_seed": query_seed(seed, run),
                "test_seed": query_seed(seed, TEST_SEED),
                "test_pairs": budget.test_pairs,
                "answers": list(budget.answers),
                "heads": list(budget.heads),
                "seed": run,
            },
            (base, ensemble),
            seconds=4 + len(budget.answers) * own / fast,
        )
        for run in range(budget.repetitions)
    ]
    alignments = {
        (recipe, condition): [
            _alignment(recipe, source, queries, run, budget, seed, own, (base, ensemble))
            for run in range(budget.alignments)
        ]
        for recipe in budget.recipes
        for condition, (source, queries) in CONDITIONS.items()
        if recipe not in FROM_CONDITIONED or CONDITIONED in shipped_names()
    }
    scenes = {"seed": FIRST_SEED + seed, "n": budget.rollouts}
    raw = Task("raw", {"scenes": scenes}, (base,), seconds=1)
    return EnqueryPlan(budget, seed, base, ensemble, sweep, accuracies, raw, alignments)


def _alignment(
    recipe: str,
    source: Source,
    queries: int,
    run: int,
    budget: EnqueryBudget,
    seed: int,
    seconds_per_update: float,
    policies: tuple[Task, Task],
) -> Task:
    asked = {"source": source, "queries": queries, "query_seed": query_seed(seed, run)}
    scenes = {"seed": FIRST_SEED + seed, "n": budget.rollouts}
    if recipe in FROM_CONDITIONED:
        params = asked | {
            "conditioned": CONDITIONED,
            "sha256": load_conditioned(CONDITIONED).digest(),
            "scenes": scenes,
        }
        if recipe == "instant":
            return Task("instant", params, policies, seconds=3)
        search = search_config(budget, run)
        seconds = 6 + 0.0003 * search.tried * search.selection_scenes
        return Task("refined", params | {"config": search.as_dict()}, policies, seconds=seconds)
    config = align_config(recipe, budget, run)
    return Task(
        "alignment",
        asked | {"heads": list(budget.heads), "config": stored_alignment(config), "scenes": scenes},
        policies,
        seconds=4 + 0.8 * config.checkpoints + seconds_per_update * config.updates,
    )


def _shipped(kind: str, name: str, policies: Sequence[Policy]) -> Task:
    return Task(f"shipped_{kind}", {"name": name, "sha256": [policy.digest() for policy in policies]}, seconds=1)
