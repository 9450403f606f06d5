"""Whether people who walk in exploration cost chapter 2's controllers anything: pairs of trainings, alike but for that.

Each training is a task of its own, so that a run that was stopped goes on. Simulated: demonstrators are programmed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from desirepath.analysis.tested import mean_of
from desirepath.demonstrations.controllers import roll_out
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.judging import judge_rollouts
from desirepath.demonstrations.planned_walks import walking_scene
from desirepath.demonstrations.stroke import StrokeProblem
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath.demonstrations.td3_bc.training import DemonstrationTraining
from desirepath.simulation.demonstration_scenes import PAIRS, demonstration_scene
from desirepath.simulation.scene import Pose, SceneError
from desirepath.simulation.setups import DEMONSTRATION_SETUPS
from desirepath_experiments.reproduction.tasks import Function, Task, TaskResult, results_of

MODES = ("opposite", "random")
PER_PAIR = 2  # demonstrations that are learned from
OTHERS_PER_PAIR = 8  # demonstrations of other walks, only judged by
STARTS = 4  # around every demonstrated one, only the first of them exactly there
NEAR_M, NEAR_RAD = 0.05, 0.2
APART = 1_000  # seeds between the walks of one training and the next
TRIES = 200
WHERE = ("shown", "others")
MEASURES = ("success_rate", "collision_rate", "frechet_m", "t_star")


def benchmark_walking(
    work: Path, *, seeds: Sequence[int] = range(6), updates: int = 8_000, processes: int = 1
) -> dict[str, Any]:
    """Train with walking and with standing people in exploration, from the same demonstrations and random numbers, and
    take the difference of each pair: in the demonstrated walks (`shown`) and other walks of the same situations.

    work: the folder of finished trainings. Differences are walking minus standing, with 95 % intervals over pairs.
    """
    tasks = {
        (setup, seed, walking): Task(
            "trained", {"setup": setup, "seed": seed, "walking": walking, "updates": updates}, seconds=updates / 500
        )
        for setup in DEMONSTRATION_SETUPS
        for seed in seeds
        for walking in (False, True)
    }
    made = results_of(list(tasks.values()), FUNCTIONS, work, processes=processes)
    found = {key: one.meta for key, one in zip(tasks, made, strict=True)}
    pairs = [(setup, seed) for setup in DEMONSTRATION_SETUPS for seed in seeds]
    compared: dict[str, Any] = {}
    for where in WHERE:
        for measure in MEASURES:
            standing, walking = (
                np.array([found[*pair, way][where][measure] for pair in pairs]) for way in (False, True)
            )
            differs = mean_of(walking - standing)
            compared[f"{where}_{measure}"] = {
                "standing": float(standing.mean()),
                "walking": float(walking.mean()),
                "difference": differs.mean,
                "interval": None if math.isnan(differs.low) else [differs.low, differs.high],
            }
    return {
        "pairs": len(pairs),
        "rollouts": {where: sum(found[*pair, True][where]["drives"] for pair in pairs) for where in WHERE},
        **compared,
        "by_pair": [
            {"setup": setup, "seed": seed, "walking": walking, **{w: found[setup, seed, walking][w] for w in WHERE}}
            for setup, seed, walking in tasks
        ],
        "updates": updates,
        "core_seconds": sum(one["made"]["cpu_seconds"] for one in found.values()),
    }


def demonstrated(setup: str, first: int, per_pair: int) -> list[Demonstration]:
    """So many paths past somebody who walks in each of the environment's situations; walks by seeds from `first` on."""
    found: list[Demonstration] = []
    for pair in range(PAIRS):
        mine: list[Demonstration] = []
        for seed in range(first, first + TRIES):
            try:
                scene = walking_scene(demonstration_scene(setup, pair), MODES[len(mine) % 2], seed)
                mine.append(demonstrate("field_of_view", scene, seed))
            except (SceneError, StrokeProblem):
                continue  # nobody can show anything there
            if len(mine) == per_pair:
                break
        found += mine
    return found


def trained(params: dict[str, Any], _: Sequence[TaskResult]) -> TaskResult:
    """One training and how its controller does; the averaged one, as no checkpoint is chosen."""
    setup, seed, updates = params["setup"], params["seed"], params["updates"]
    shown = demonstrated(setup, APART * seed, PER_PAIR)
    others = demonstrated(setup, APART * seed + APART // 2, OTHERS_PER_PAIR)
    config = DemonstrationConfig(seed=seed, updates=updates)
    training = DemonstrationTraining(shown, config, walking=params["walking"])
    while training.agent.updates < updates:
        training.vector_step()
    policy = training.policy(averaged=True)
    random = np.random.default_rng([seed, 0x3A])
    judged = {}
    for where, demonstrations, starts in (("shown", shown, STARTS), ("others", others, 1)):
        asked = [one for one in demonstrations for _ in range(starts)]
        scenes = [
            one.scene if i % starts == 0 else replace(one.scene, start=_beside(one.scene.start, random))
            for i, one in enumerate(asked)
        ]
        judged[where] = judge_rollouts(roll_out(policy, scenes), asked).as_dict()
    return TaskResult(judged, {})


def _beside(start: Pose, random: np.random.Generator) -> Pose:
    dx, dy = random.normal(0.0, NEAR_M, 2)
    yaw = (start.yaw + random.normal(0.0, NEAR_RAD) + math.pi) % (2 * math.pi) - math.pi
    return Pose(start.x + float(dx), start.y + float(dy), float(yaw))


FUNCTIONS: dict[str, Function] = {"trained": trained}
