"""Chapter 3 as tasks: which there are for a budget, with all that their results depend on. No task is computed here."""

from __future__ import annotations

from dataclasses import dataclass

from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath_experiments.reproduction.tasks import Task

SECONDS_PER_BATCH, SECONDS_PER_UPDATE, SECONDS_PER_AVOIDER_UPDATE = 0.05, 0.003, 0.002
SECONDS_PER_PREDICTOR_BATCH = 0.02
ENCODER_PART = 2_000  # batches that are trained before they are stored


@dataclass(frozen=True)
class DepthBudget:
    """How much is computed. recorded_homes: of the encoder's pictures; homes: explored; unseen: homes judged in, per
    person mode; per_scene: demonstrations."""

    name: str
    seeds: tuple[int, ...]
    avoider_updates: int
    recorded_homes: int
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
        # Half of the small one's updates, and nothing else less: both share encoder and predictor.
        DepthBudget("quick", (0, 1, 2), 9_000, 400, 400, 10_000, 3_000, 400, 9, 3, 6_000, 25, 3),
        DepthBudget("small", (0, 1, 2), 9_000, 400, 400, 10_000, 3_000, 400, 9, 3, 12_000, 25, 3),
        # The thesis: 50 rollouts per scene, mode and preference.
        DepthBudget("full", (0, 1, 2, 3, 4), 30_000, 1_000, 800, 24_000, 10_000, 4_000, 9, 3, 60_000, 50, 50),
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
    recorded = {"homes": budget.recorded_homes, "steps": budget.recorded_steps}
    part: tuple[Task, ...] = ()
    for until in range(ENCODER_PART, budget.encoder_batches + ENCODER_PART, ENCODER_PART):
        batches = {"batches": budget.encoder_batches, "until": min(until, budget.encoder_batches)}
        part = (Task("encoder", recorded | batches, (avoider, *part), seconds=ENCODER_PART * SECONDS_PER_BATCH),)
    encoder = Task(
        "perception",
        recorded | {"predictor_batches": budget.predictor_batches},
        (avoider, *part),
        seconds=budget.predictor_batches * SECONDS_PER_PREDICTOR_BATCH,
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
