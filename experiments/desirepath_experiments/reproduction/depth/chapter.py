"""Chapter 3 reproduced: encoder, predictor, six configurations, how they do among people and what they follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import getitem
from typing import Any

import numpy as np

from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath.demonstrations.depth.training import DEPARTURES, DepthTrainingConfig
from desirepath.simulation.depth_camera import DEPTH_CAMERA
from desirepath_experiments.reproduction.depth.computing import FUNCTIONS
from desirepath_experiments.reproduction.driver import Chapter, Made, read_budgets
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Load, Task

SECONDS_PER_BATCH, SECONDS_PER_UPDATE, SECONDS_PER_AVOIDER_UPDATE = 0.05, 0.003, 0.002
SECONDS_PER_PREDICTOR_BATCH = 0.02
ENCODER_PART = 2_000  # batches that are trained before they are stored
RATES = ("success_rate", "collision_rate", "timeout_rate")
FOLLOWED = ("t_star", "f_m")


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


@dataclass(frozen=True)
class DepthPlan:
    """encoder: also holds the predictor. trained, judged: by configuration and seed; VAE-HU is VAE-HA, judged blind."""

    budget: DepthBudget
    avoider: Task
    encoder: Task
    trained: dict[tuple[str, int], Task]
    judged: dict[tuple[str, int], Task]


def make_plan(budget: DepthBudget, seeds: Sequence[int] | None = None) -> DepthPlan:
    """Which tasks a budget has. seeds: instead of the budget's own."""
    budget = budget if seeds is None else replace(budget, seeds=tuple(seeds))
    avoiding = budget.avoider_updates * SECONDS_PER_AVOIDER_UPDATE
    avoider = Task("avoider", {"updates": budget.avoider_updates}, seconds=avoiding)
    recorded = {"homes": budget.recorded_homes, "steps": budget.recorded_steps}
    part: tuple[Task, ...] = ()
    for until in range(ENCODER_PART, budget.encoder_batches + ENCODER_PART, ENCODER_PART):
        batches = {"batches": budget.encoder_batches, "until": min(until, budget.encoder_batches)}
        part = (Task("encoder", recorded | batches, (avoider, *part), seconds=ENCODER_PART * SECONDS_PER_BATCH),)
    predicted = recorded | {"predictor_batches": budget.predictor_batches}
    encoder = Task(
        "perception", predicted, (avoider, *part), seconds=budget.predictor_batches * SECONDS_PER_PREDICTOR_BATCH
    )
    plan = DepthPlan(budget, avoider, encoder, {}, {})
    shown = {"scenes": budget.scenes, "per_scene": budget.per_scene}
    for seed in budget.seeds:
        for name, configuration in CONFIGURATIONS.items():
            learned = {"configuration": configuration.trained_as or name, "seed": seed, "updates": budget.updates}
            training = Task(
                "controller",
                {**learned, "homes": budget.homes, **shown},
                (encoder,),
                seconds=budget.updates * SECONDS_PER_UPDATE,
            )
            plan.trained[name, seed] = training
            judging = {"configuration": name, "seed": seed, "unseen": budget.unseen, "rollouts": budget.rollouts}
            plan.judged[name, seed] = Task("judged", {**judging, **shown}, (encoder, training), seconds=20.0)
    return plan


def make(plan: DepthPlan, load: Load) -> Made:
    """Six configurations, the encoder's pictures, the bars."""
    from desirepath_experiments.reproduction.figures import picture_rows  # matplotlib is slow to load

    configurations = {
        name: _configuration([load(plan.judged[name, seed]).meta for seed in plan.budget.seeds])
        for name in CONFIGURATIONS
    }
    perceived = load(plan.encoder)
    success, bound = configurations["VAE-HA"]["unseen"]["all"]["success_rate"], published("depth").numbers
    closest = min(CONFIGURATIONS, key=lambda name: configurations[name]["demonstrated"]["nothing"]["f_m"])
    least = bound["success_at_least"]
    bars = [
        {"name": "VAE-HA arrives in unseen homes", "bound": least, "value": success, "met": success >= least},
        {"name": "smallest f at t*", "bound": "VAE-HA", "value": closest, "met": closest == "VAE-HA"},
    ]
    # What 32 latents keep: clean, as the camera gives it, decoded; near people, then thin legs.
    frames = {part: perceived.arrays[f"shown_{part}"] for part in ("clean", "seen", "decoded")}
    return Made(
        {
            "configurations": configurations,
            "perception": {key: perceived.meta[key] for key in ("reconstruction", "prediction", "last_training_rms_m")},
            "avoider": {"selection_success": load(plan.avoider).meta["selection_success"]},
            "bars": bars,
        },
        more={"departures": DEPARTURES},
        answer={"bars": bars},
        drawn=[picture_rows("reconstruction", frames, DEPTH_CAMERA.range_m)],
        card={"config": DepthTrainingConfig(updates=plan.budget.updates).as_dict(), "departures": DEPARTURES},
    )


BUDGETS = read_budgets("depth", DepthBudget)
CHAPTER = Chapter("depth", BUDGETS, FUNCTIONS, make_plan, make, options={"seeds": None}, processes=1)


def _configuration(seeds: list[Any]) -> dict[str, Any]:
    """What was measured of a configuration: means over seeds, from the smallest to the largest, every seed's own."""

    def means(parts: Sequence[str], *path: str) -> dict[str, float]:
        of_seeds = [reduce(getitem, path, of_seed) for of_seed in seeds]
        return {part: float(np.mean([of[part] for of in of_seeds])) for part in parts}

    def spread(part: str, *path: str) -> list[float]:
        values = [reduce(getitem, path, of_seed)[part] for of_seed in seeds]
        return [min(values), max(values)]

    first, followed = seeds[0]["demonstrated"], ("demonstrated", "nothing")
    return {
        "unseen": {mode: means(RATES, "unseen", mode) for mode in seeds[0]["unseen"]},
        "demonstrated": {removed: means((*RATES, *FOLLOWED), "demonstrated", removed) for removed in first},
        "styles": {style: means(FOLLOWED, *followed, "styles", style) for style in first["nothing"]["styles"]},
        "spread": {
            "success_rate": spread("success_rate", "unseen", "all"),
            **{part: spread(part, *followed) for part in FOLLOWED},
        },
        "seeds": [{"unseen": of_seed["unseen"]["all"], "demonstrated": of_seed["demonstrated"]} for of_seed in seeds],
    }
