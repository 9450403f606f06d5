"""One participant's drawn paths as what D-REX begins with: augmented trajectories to clone, and scenes beside them.

The pipeline itself is the same for every demonstration: `training/adaptable/cloning.py`, then
`training/adaptable/ranking.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.demonstration import Demonstration, augment
from desirepath.simulation import kernels as k
from desirepath.simulation.scene import Pose, Scene, SceneError
from desirepath.simulation.scenes import check_scene
from desirepath.simulation.trajectory import Trajectory

BESIDE_M, BESIDE_RAD = 0.1, 0.2  # standard deviations around where a drawn path begins, ours
TRIES = 20


def augmented_all(demonstrations: Sequence[Demonstration]) -> list[Trajectory]:
    """Every drawn path's rollouts from starts along it (chapter 2, step 7)."""
    return [trajectory for demonstration in demonstrations for trajectory in augment(demonstration)]


def scenes_beside(
    demonstrations: Sequence[Demonstration], n: int, seed: int
) -> tuple[list[Scene], list[NDArray[np.float64]]]:
    """n scenes with the robot a little beside where a drawn path begins, and these paths (points, 2) m as executed.

    The paths take turns. Raises SceneError where no start beside one is free.
    """
    random = np.random.default_rng([seed, 57])
    scenes, ways = [], []
    for number in range(n):
        demonstration = demonstrations[number % len(demonstrations)]
        scenes.append(_beside(demonstration.scene, random))
        ways.append(demonstration.trajectory.poses[:, :2].astype(np.float64))
    return scenes, ways


def _beside(scene: Scene, random: np.random.Generator) -> Scene:
    for _ in range(TRIES):
        dx, dy = random.normal(0, BESIDE_M, 2).tolist()
        yaw = k.wrap(scene.start.yaw + float(random.normal(0, BESIDE_RAD)))
        moved = replace(scene, start=Pose(scene.start.x + dx, scene.start.y + dy, yaw))
        try:
            check_scene(moved)
        except SceneError:
            continue
        return moved
    raise SceneError("start", scene.start, f"nothing is free within about {BESIDE_M} m of it")
