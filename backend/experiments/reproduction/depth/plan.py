"""Chapter 3 as tasks: which there are for a budget, with all that their results depend on. No task is computed here."""

from __future__ import annotations

from dataclasses import dataclass

from backend.demonstrations.depth.states import CONFIGURATIONS
from backend.experiments.reproduction.tasks import Task

SECONDS_PER_BATCH, SECONDS_PER_UPDATE, SECONDS_PER_AVOIDER_UPDATE = 0.1, 0.003, 0.002


@dataclass(frozen=True)
class DepthBudget:
    """How much is computed. homes: explored; unseen: homes judged in, per person mode; per_scene: demonstrations."""

    name: str
    seeds: tuple[int, ...]
    avoider_updates: int
    recorded_steps: int
    encoder_batches: int
    predictor_batches: int
    homes: int
    scenes: int
    per_scene: int
    updates: int
    unseen: int
    rollouts: int


BUDGETS = {
    budget.name: budget
    for budget in (
        DepthBudget("small", (0,), 9_000, 220, 1_100, 1_500, 100, 9, 3, 8_000, 16, 3),
        # The thesis: 50 rollouts per scene, mode and preference.
        DepthBudget("full", (0, 1, 2), 30_000, 600, 6_000, 6_000, 400, 9, 3, 60_000, 50, 50),
    )
}


@dataclass(frozen=True)
class DepthPlan:
    """encoder: also holds the predictor. trained, judged: by configuration and seed; VAE-HU is VAE-HA, judged blind."""

    budget: DepthBudget
    avoider: Task
    encoder: Task
    trained: dict[tuple[str, int], Task]
    judged: dict[tuple[str, int], Task]

    def tasks(self) -> list[Task]:
        return list(self.judged.values())


def make_plan(budget: DepthBudget) -> DepthPlan:
    """Which tasks a budget has."""
    avoider = Task(
        "avoider",
        {"updates": budget.avoider_updates},
        seconds=budget.avoider_updates * SECONDS_PER_AVOIDER_UPDATE,
    )
    encoder = Task(
        "perception",
        {
            "homes": budget.homes,
            "steps": budget.recorded_steps,
            "encoder_batches": budget.encoder_batches,
            "predictor_batches": budget.predictor_batches,
        },
        (avoider,),
        seconds=budget.encoder_batches * SECONDS_PER_BATCH,
    )
    shown = {"scenes": budget.scenes, "per_scene": budget.per_scene}
    trained: dict[tuple[str, int], Task] = {}
    judged: dict[tuple[str, int], Task] = {}
    for seed in budget.seeds:
        for name, configuration in CONFIGURATIONS.items():
            learned = configuration.trained_as or name
            training = Task(
                "controller",
                {"configuration": learned, "seed": seed, "updates": budget.updates, "homes": budget.homes, **shown},
                (encoder,),
                seconds=budget.updates * SECONDS_PER_UPDATE,
            )
            trained[name, seed] = training
            judging = {"configuration": name, "seed": seed, "unseen": budget.unseen, "rollouts": budget.rollouts}
            judged[name, seed] = Task("judged", {**judging, **shown}, (encoder, training), seconds=20.0)
    return DepthPlan(budget, avoider, encoder, trained, judged)
