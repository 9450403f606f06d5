"""Chapter 6 as tasks: how much is compared, and which tasks that takes, with all that their results depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.relabelling import RelabellingConfig
from desirepath.learning.alignment.thesis import ThesisConfig, thesis_config
from desirepath.learning.cards import read_config
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import FAST_HEADS, THESIS_HEADS
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.shipped_files import shipped_names
from desirepath.learning.td3.base import BaseConfig
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath_experiments.reproduction.driver import read_budgets
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Task

PRINTED = published("enquery").numbers
SETUP = "open_field"
CONDITIONED = f"{SETUP}/conditioned"
ORACLE = "min-human-distance"  # 6.4.2
Source = Literal["EnQ", "BL"]
SOURCES: tuple[Source, ...] = ("EnQ", "BL")
CONDITIONS: dict[str, tuple[Source, int]] = {
    "EnQ-15": ("EnQ", 15),
    "EnQ-60": ("EnQ", 60),
    "BL-15": ("BL", 15),
    "BL-60": ("BL", 60),
}
MODELS = {"mlp": "neural", "linear": "linear", "weights": "weights"}  # the thesis's, then ours
TEST_SETS = ("ensemble pairs", "segments")

RECIPES = {
    "thesis": "the thesis's recipe",
    "fine_tuning": "our recipe from RAW",
    "instant": "our conditioned policy at once",
    "conditioning_search": "our conditioned policy, searched on",
}
FROM_CONDITIONED = ("instant", "conditioning_search")

SECONDS_PER_UPDATE = {FAST_HEADS: 0.003, THESIS_HEADS: 0.01}
FIRST_SEED = 20_000  # of query and reporting scenes: beyond those of cards, benchmarks and studies
SEEDS_PER_RUN = 100
TEST_SEED = 99  # of the hundred seeds of a run


@dataclass(frozen=True)
class EnqueryBudget:
    """How much is computed."""

    name: str
    heads: tuple[int, int]  # of base, ensemble, reward models and alignments; the sweep starts from the shipped base
    train: bool  # base and ensemble of these heads; False: the shipped ones
    kappas: tuple[float, ...]
    marks: tuple[int, ...]  # training steps at which the sweep looks
    sweep_scenes: int
    answers: tuple[int, ...]  # numbers of answers of the learning curve
    repetitions: int
    test_pairs: int
    alignments: int
    rollouts: int
    thesis_updates: int  # per epoch
    thesis_epochs: int
    fine_tuning_updates: int
    fine_tuning_checkpoints: int
    search_tried: int = ConditioningSearchConfig.tried  # candidates of the conditioning search
    states: int = 1_000  # 6.5.1.1: in which action diversity is measured
    base_updates: int = BaseConfig(SETUP).updates
    ensemble_steps: int = int(PRINTED["ensemble_steps"])
    base_transitions: int = PolicyEnsembleConfig().base_transitions
    selection_scenes: int = FineTuningConfig().selection_scenes
    gate_scenes: int = GateRule().scenes
    replay_transitions: int = FineTuningConfig().replay_transitions
    starts: int = 6  # per scene with trajectories drawn in it
    recipes: tuple[str, ...] = tuple(RECIPES)  # those from the conditioned policy only where one is shipped
    flow_fields: tuple[str, ...] = ("EnQ-15",)  # conditions by the thesis's recipe, against RAW; by ours only EnQ-15


BUDGETS = read_budgets("enquery", EnqueryBudget)


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


def make_plan(budget: EnqueryBudget, seed: int) -> EnqueryPlan:
    """The tasks. Raises ValueError for a seed without scenes of its own."""
    if not 0 <= seed < SEEDS_PER_RUN:
        raise ValueError(f"seed = {seed}: between 0 and {SEEDS_PER_RUN - 1}")
    fast, own = SECONDS_PER_UPDATE[FAST_HEADS], SECONDS_PER_UPDATE[budget.heads]
    shipped = _shipped_task("base", f"{SETUP}/base", [load_policy(f"{SETUP}/base")])
    base, ensemble = shipped, _shipped_task("ensemble", f"{SETUP}/ensemble", load_ensemble(SETUP))
    if budget.train:
        trained = BaseConfig(SETUP, seed=seed, heads=budget.heads, updates=budget.base_updates)
        base = Task("train_base", trained.as_dict(), seconds=60 + own * trained.updates)
        members = PolicyEnsembleConfig(seed=seed, steps=budget.ensemble_steps, base_transitions=budget.base_transitions)
        ensemble = Task("train_ensemble", members.as_dict(), (base,), seconds=10 + own * 4 * members.steps)
    sweep = {}
    looking = 0.01 * len(budget.marks) * budget.sweep_scenes
    for kappa in budget.kappas:
        config = PolicyEnsembleConfig(
            seed=seed, kappa=kappa, steps=max(budget.marks), base_transitions=budget.base_transitions
        )
        swept = {
            "config": config.as_dict(),
            "marks": list(budget.marks),
            "states": budget.states,
            "scenes": {"seed": FIRST_SEED + seed, "n": budget.sweep_scenes},
        }
        sweep[kappa] = Task("sweep", swept, (shipped,), 2 + fast * 4 * max(budget.marks) + looking)
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
    answers = {"source": source, "queries": queries, "query_seed": query_seed(seed, run)}
    scenes = {"seed": FIRST_SEED + seed, "n": budget.rollouts}
    if recipe in FROM_CONDITIONED:
        params = answers | {
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
        answers | {"heads": list(budget.heads), "config": stored_alignment(config), "scenes": scenes},
        policies,
        seconds=4 + 0.8 * config.checkpoints + seconds_per_update * config.updates,
    )


def _shipped_task(kind: str, name: str, policies: Sequence[Policy]) -> Task:
    return Task(f"shipped_{kind}", {"name": name, "sha256": [policy.digest() for policy in policies]}, seconds=1)


def stored_alignment(config: RelabellingConfig) -> dict[str, Any]:
    """The settings as tasks are named by: flat, with the keys of the first release, so that what was computed before
    the algorithms had settings of their own is found again; those of the other algorithm stand beside at their
    defaults."""
    flat = {**FineTuningConfig().as_dict(), **config.as_dict()}
    flat["preference_weight"] = flat.pop("reward_weight")
    return {**flat, "recipe": "thesis" if isinstance(config, ThesisConfig) else "refine"}


def read_alignment(stored: Mapping[str, Any]) -> RelabellingConfig:
    """Back from `stored_alignment`."""
    algorithm: type[FineTuningConfig] | type[ThesisConfig] = (
        ThesisConfig if stored["recipe"] == "thesis" else FineTuningConfig
    )
    values = read_config({**stored, "reward_weight": stored["preference_weight"]})
    own = {field.name: values[field.name] for field in fields(algorithm) if field.name in values}
    return algorithm(**own, gate=GateRule.of(stored))
