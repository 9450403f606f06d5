"""Where training episodes begin: near a demonstration, or anywhere in its environment (section 2.5.6)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.simulation import kernels as k
from backend.simulation.scenes import SPACING, ScenePool, scenes_to_rows
from backend.simulation.trajectory import Trajectory

NEAR_M = 0.15  # standard deviation of robot, person and goal around their demonstrated places, ours
NEAR_RAD = 0.3
NOT_AT_THE_GOAL = 10  # last poses of a trajectory that are no beginning
TRIES = 20


class Placements:
    """A start pool (`FastEngine`'s `pool`) of both kinds.

    near: share of episodes that begin around a pose of a demonstrated trajectory, with person and goal about where they
    were at that moment. mixed: share in which each of robot, person and goal is, by chance, either there or where it is
    in a drawn scene. The others are drawn scenes of the environment. People stand in all of them.
    """

    def __init__(self, trajectories: Sequence[Trajectory], *, near: float, mixed: float = 0.0, seed: int) -> None:
        self._anywhere = ScenePool(trajectories[0].scene.setup, seed)
        self._rows = scenes_to_rows([one.scene for one in trajectories])
        self._poses = [one.poses.astype(float) for one in trajectories]
        self._people = [one.scene.person_poses(one.times) for one in trajectories]
        self._near, self._mixed = near, mixed
        self._random = np.random.default_rng([seed, 0xDE])

    def take(self, count: int) -> tuple[k.Rows, NDArray[np.int64]]:
        """The next scenes: rows (count, columns) and their seeds (count,), those of the drawn scenes."""
        rows, seeds = self._anywhere.take(count)
        kinds = self._random.random(count)
        for i in np.flatnonzero(kinds < self._near + self._mixed):
            beside = self._beside_a_trajectory(rows[i] if kinds[i] >= self._near else None)
            if beside is not None:
                rows[i] = beside
        return rows, seeds

    def _beside_a_trajectory(self, drawn: k.Row | None) -> k.Row | None:
        """A demonstrated scene with everything moved a little, None where that did not fit after some tries.

        drawn: where each of robot, person and goal is taken from instead, half of the time.
        """
        random = self._random
        for _ in range(TRIES):
            which = random.integers(len(self._poses))
            row: k.Row = self._rows[which].copy()
            moment = random.integers(max(1, len(self._poses[which]) - NOT_AT_THE_GOAL))
            row[k.START_X : k.START_YAW + 1] = self._poses[which][moment]
            row[k.PERSON_X : k.PERSON_YAW + 1] = self._people[which][moment]
            for column in (k.START_X, k.GOAL_X, k.PERSON_X):
                row[column : column + 2] += random.normal(0.0, NEAR_M, 2)
                row[column + 2] = k.wrap(row[column + 2] + random.normal(0.0, NEAR_RAD))
                if drawn is not None and random.random() < 0.5:
                    row[column : column + 3] = drawn[column : column + 3]
            if self._fits(row):
                return row
        return None

    @staticmethod
    def _fits(row: k.Row) -> bool:
        robot = SPACING.robot_radius + SPACING.spare_on_the_way
        for column in (k.START_X, k.GOAL_X):
            x, y = row[column], row[column + 1]
            if k.surface_distance(row, x, y) < robot or k.person_distance(row, x, y) < robot + row[k.PERSON_RADIUS]:
                return False
        if math.dist(row[[k.START_X, k.START_Y]], row[[k.GOAL_X, k.GOAL_Y]]) <= row[k.GOAL_RADIUS]:
            return False
        return bool(k.surface_distance(row, row[k.PERSON_X], row[k.PERSON_Y]) >= row[k.PERSON_RADIUS])
