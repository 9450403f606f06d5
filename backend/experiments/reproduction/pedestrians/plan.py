"""Chapter 4 as tasks: which there are for a budget, with all that their results depend on. No task is computed here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from backend.experiments.reproduction.tasks import Task
from backend.learning.pedestrians.crowd_networks import VARIANTS

PLANNED = ("follow", "dwa", "orca", "social_force", "foresight")
DDPG = "ours_ddpg"
SECONDS = {"b1": 0.03, "b2": 0.025, "b3": 0.025}  # of an update of 128; the attention networks' is below
ATTENTION_SECONDS = 0.12


@dataclass(frozen=True)
class PedestrianBudget:
    """How much is computed. trained: variants, `ours_ddpg` is DDPG's; part: updates of one task of a training, a
    quarter of an hour or so, so that stopping loses no more; episodes: of each judged condition; speeds, numbers: of
    the two curves; progress: see `CrowdTrainingConfig`, without it short trainings stand still."""

    name: str
    seeds: tuple[int, ...]
    trained: tuple[str, ...]
    updates: int
    part: int
    batch_size: int
    episodes: int
    speeds: tuple[float, ...]
    numbers: tuple[int, ...]
    random_transitions: int = 20_000
    learning_rate: float = 1e-4
    progress: float = 2.0


BUDGETS = {
    budget.name: budget
    for budget in (
        PedestrianBudget(
            "small", (0, 1), ("ours", DDPG, "b1", "b2", "b3"), 5_000, 2_500, 64, 100, (1.0,), (4,), learning_rate=5e-4
        ),
        PedestrianBudget(
            "full", (0, 1, 2), (*VARIANTS, DDPG), 60_000, 7_500, 128, 1_000, (0.2, 0.4, 0.8, 1.0), (1, 4, 6, 8)
        ),
    )
}


@dataclass(frozen=True)
class PedestrianPlan:
    """judged: by (variant, seed), planners with seed -1."""

    budget: PedestrianBudget
    judged: dict[tuple[str, int], Task]

    def tasks(self) -> Iterator[Task]:
        """All of them; needs come along."""
        yield from self.judged.values()


def make_plan(budget: PedestrianBudget, device: str = "cpu") -> PedestrianPlan:
    """Which tasks a budget has."""
    plan = PedestrianPlan(budget, {})
    asked = {"episodes": budget.episodes, "speeds": list(budget.speeds), "numbers": list(budget.numbers)}
    for planner in PLANNED:
        plan.judged[planner, -1] = Task("planned", {"planner": planner, **asked}, seconds=0.4 * budget.episodes)
    for seed in budget.seeds:
        for variant in budget.trained:
            trained = _trained(budget, variant, seed, device)
            params: dict[str, Any] = {"variant": _network(variant), "robustness": variant == "ours", **asked}
            plan.judged[variant, seed] = Task("judged", params, (trained,), 0.6 * budget.episodes)
    return plan


def _network(variant: str) -> str:
    return "ours" if variant == DDPG else variant


def _trained(budget: PedestrianBudget, variant: str, seed: int, device: str) -> Task:
    """The last of the tasks of a training, each going on from the one before."""
    config = {
        "variant": _network(variant),
        "learner": "ddpg" if variant == DDPG else "td3",
        "seed": seed,
        "updates": budget.updates,
        "batch_size": budget.batch_size,
        "random_transitions": budget.random_transitions,
        "learning_rate": budget.learning_rate,
        "progress": budget.progress,
        "buffer_size": 400_000,  # ours: all that is seen; the published 2 million would be 4 GB of mostly nothing
        "device": device,
    }
    seconds = SECONDS.get(variant, ATTENTION_SECONDS) * budget.part * budget.batch_size / 128
    needs: tuple[Task, ...] = ()
    for until in range(budget.part, budget.updates + budget.part, budget.part):
        needs = (Task("trained", {"config": config, "until": until}, needs, seconds),)
    return needs[0]
