"""Chapter 4 as tasks: which there are for a budget, with the settings that their results depend on.

Constants of the simulator and the planners are the commit's, which stands with each result. No task is computed here.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

from desirepath.learning.pedestrians.crowd_networks import FIRST_NUMBERS, GAP_TIMES, VARIANTS
from desirepath.simulation.crowds.crowd_kernels import HELD_UP_S, HELD_UP_SHARE
from desirepath.simulation.crowds.crowd_scenes import UNSEEN_HOMES
from desirepath_experiments.reproduction.driver import read_budgets
from desirepath_experiments.reproduction.tasks import Task
from desirepath_experiments.training.pedestrians.foresight import SEARCH_BY_VELOCITY
from desirepath_experiments.training.pedestrians.imitation import ImitationConfig

PLANNED = ("follow", "dwa", "orca", "social_force", "constant_velocity", "foresight")
SOCIAL_IN = ("published", "homes")  # where social metrics are taken
TD3, DDPG = "_td3", "_ddpg"
"""Ends of names: trained by reward; without, by imitation."""
SECONDS = {"b1": 0.03, "b2": 0.025, "b3": 0.025}  # of an update of 128; the attention networks' is below
ATTENTION_SECONDS = 0.12
IMITATION_SECONDS = 0.0009  # of a label, with what is learned from it; the attention networks' is below
ATTENTION_IMITATION_SECONDS = 0.003
JUDGED_SECONDS = 0.025  # of an episode; with descriptors, which take ICP, as below
GROUPS_JUDGED_SECONDS = 0.065


@dataclass(frozen=True)
class ByReward:
    """Settings of a training by reward (`CrowdTrainingConfig`). part: updates of one of its tasks, a quarter of an hour
    or so, so that stopping loses no more. progress: without it short trainings stand still."""

    updates: int = 40_000
    part: int = 8_000
    batch_size: int = 128
    random_transitions: int = 20_000
    learning_rate: float = 1e-4
    progress: float = 2.0


@dataclass(frozen=True)
class PedestrianBudget:
    """How much is computed. learned: variants, with each seed, by imitation from so many labels, or by reward, the
    learner at the end of the name; episodes: of the published setting and in homes; episodes_more: of every other
    condition; speeds, numbers: of the two curves. by_reward: None where no name ends in a learner. selection_scenes:
    by which imitation chooses among its tables."""

    name: str
    seeds: tuple[int, ...]
    learned: tuple[str, ...]
    labels: int
    episodes: int
    episodes_more: int
    speeds: tuple[float, ...]
    numbers: tuple[int, ...]
    by_reward: ByReward | None = None
    selection_scenes: int = ImitationConfig.evaluation_episodes


BUDGETS = read_budgets("pedestrians", PedestrianBudget)
BY_REWARD = (*(variant + TD3 for variant in VARIANTS), "ours" + DDPG)


@dataclass(frozen=True)
class PedestrianPlan:
    """judged: by (variant, seed), planners with seed -1."""

    budget: PedestrianBudget
    judged: dict[tuple[str, int], Task]


def make_plan(budget: PedestrianBudget, device: str = "cpu") -> PedestrianPlan:
    """Which tasks a budget has."""
    plan = PedestrianPlan(budget, {})
    common = {
        "episodes": budget.episodes, "episodes_more": budget.episodes_more,
        "speeds": list(budget.speeds), "numbers": list(budget.numbers),
        "social": list(SOCIAL_IN),
        "homes": {**asdict(UNSEEN_HOMES), "held_up": [HELD_UP_S, HELD_UP_SHARE]},
    }  # fmt: skip
    judged = 2 * budget.episodes + (2 + len(budget.speeds) + len(budget.numbers)) * budget.episodes_more
    for seed, name in product(budget.seeds, budget.learned):
        training = _train(budget, name, seed, device) if learner_of(name) else imitated(budget, name, seed)
        robustness = name == "ours"
        params: dict[str, Any] = {"variant": network_of(name), "robustness": robustness, **common}
        groups = VARIANTS[network_of(name)].given == "points_and_groups"
        seconds = (GROUPS_JUDGED_SECONDS if groups else JUDGED_SECONDS) * (judged + 2 * robustness * budget.episodes)
        plan.judged[name, seed] = Task("judged", params, (training,), seconds)
    for planner in PLANNED:
        params = {"planner": planner, **common}
        if planner == "constant_velocity":
            params["search"] = SEARCH_BY_VELOCITY
        plan.judged[planner, -1] = Task("planned", params, seconds=JUDGED_SECONDS * judged)
    return plan


def network_of(name: str) -> str:
    """The variant of `VARIANTS`, however it learned."""
    return name.removesuffix(TD3).removesuffix(DDPG)


def learner_of(name: str) -> str:
    """td3, ddpg, or nothing: by imitation."""
    return name.removeprefix(network_of(name)).removeprefix("_")


def imitated(budget: PedestrianBudget, variant: str, seed: int) -> Task:
    """A training by imitation, with all its settings."""
    config = ImitationConfig(variant, seed, budget.labels, evaluation_episodes=budget.selection_scenes)
    seconds = IMITATION_SECONDS if variant in SECONDS else ATTENTION_IMITATION_SECONDS
    params = {"config": config.as_dict(), "search": SEARCH_BY_VELOCITY, "network": _network(variant)}
    return Task("imitated", params, seconds=seconds * budget.labels)


def _network(variant: str) -> dict[str, Any]:
    """What a network reads, and its numbers at first."""
    return {"given": VARIANTS[variant].given, "gap_times": GAP_TIMES, "first_numbers": FIRST_NUMBERS}


def _train(budget: PedestrianBudget, name: str, seed: int, device: str) -> Task:
    """The last of the tasks of a training, each going on from the one before."""
    variant, settings = network_of(name), budget.by_reward
    if settings is None:
        raise ValueError(f"budget {budget.name}: {name} needs settings by reward")
    config = {"variant": variant, "learner": learner_of(name), "seed": seed, "device": device, **asdict(settings)}
    del config["part"]
    config["buffer_size"] = 400_000  # ours: all that is seen; the published 2 million would be 4 GB of mostly nothing
    seconds = SECONDS.get(variant, ATTENTION_SECONDS) * settings.part * settings.batch_size / 128
    needs: tuple[Task, ...] = ()
    for until in range(settings.part, settings.updates + settings.part, settings.part):
        needs = (Task("trained", {"config": config, "until": until, "network": _network(variant)}, needs, seconds),)
    return needs[0]
