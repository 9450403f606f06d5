"""How much of chapter 6 is computed, by name, and what is compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.policies.shape import FAST_HEADS, THESIS_HEADS
from desirepath.learning.td3.base import BaseConfig
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath_experiments.reproduction.enquery import published_numbers as thesis

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

FIRST_SEED = 20_000  # of query and reporting scenes: beyond those of cards, benchmarks and studies
SEEDS_PER_RUN = 100
TEST_SEED = 99  # of the hundred seeds of a run


@dataclass(frozen=True)
class EnqueryBudget:
    """How much is computed. `full` is the thesis's own amount, where the text gives one."""

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
    ensemble_steps: int = thesis.ENSEMBLE_STEPS
    base_transitions: int = PolicyEnsembleConfig().base_transitions
    selection_scenes: int = FineTuningConfig().selection_scenes
    gate_scenes: int = GateRule().scenes
    replay_transitions: int = FineTuningConfig().replay_transitions
    starts: int = 6  # per scene with trajectories drawn in it
    recipes: tuple[str, ...] = tuple(RECIPES)  # those from the conditioned policy only where one is shipped
    flow_fields: tuple[str, ...] = ("EnQ-15",)  # conditions by the thesis's recipe, against RAW; by ours only EnQ-15


SMALL = EnqueryBudget(
    name="small",
    heads=FAST_HEADS,
    train=False,
    kappas=(0.0, thesis.KAPPA, 0.125),
    marks=(500, 1_000, 2_000),
    sweep_scenes=100,
    answers=(1, 2, 5, 10, 15, 20, 30, 60),
    repetitions=3,
    test_pairs=150,
    alignments=3,
    rollouts=100,
    thesis_updates=1_000,
    thesis_epochs=2,
    fine_tuning_updates=1_500,
    fine_tuning_checkpoints=3,
    search_tried=32,
)
MEDIUM = replace(
    SMALL,
    name="medium",  # the thesis's amounts with our smaller heads, our conditioning search short
    kappas=(0.0, 0.03125, thesis.KAPPA, 0.125),
    marks=(5_000, 10_000, 15_000, 20_000, 25_000),
    sweep_scenes=500,
    answers=(1, 2, 4, 6, 8, 10, 15, 20, 30, 40, 60),
    repetitions=10,
    test_pairs=200,
    alignments=10,
    thesis_updates=10_000,
    thesis_epochs=3,
    fine_tuning_updates=FineTuningConfig().updates,
    fine_tuning_checkpoints=FineTuningConfig().checkpoints,
    flow_fields=tuple(CONDITIONS),
)
FULL = EnqueryBudget(
    name="full",
    heads=THESIS_HEADS,
    train=True,
    kappas=(0.0, 0.015625, 0.03125, 0.046875, thesis.KAPPA, 0.078125, 0.09375, 0.125),
    marks=(5_000, 10_000, 15_000, 20_000, 25_000),
    sweep_scenes=500,
    answers=(1, 2, 4, 6, 8, 10, 12, 15, 18, 21, 25, 30, 36, 42, 50, 60),
    repetitions=10,
    test_pairs=200,
    alignments=10,
    rollouts=100,
    thesis_updates=10_000,
    thesis_epochs=3,
    fine_tuning_updates=FineTuningConfig().updates,
    fine_tuning_checkpoints=FineTuningConfig().checkpoints,
    flow_fields=tuple(CONDITIONS),
)
BUDGETS = {budget.name: budget for budget in (SMALL, MEDIUM, FULL)}
