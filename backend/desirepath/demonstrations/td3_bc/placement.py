"""Where training episodes begin: near a demonstration, or anywhere in its environment (section 2.5.6)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.scenes import ScenePool, scenes_to_rows, spacing_of
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Trajectory

NEAR_M = 0.15  # standard deviation of robot, person and goal around their demonstrated places, ours
NEAR_RAD = 0.3
NOT_AT_THE_GOAL = 10  # last poses of a trajectory that are no beginning
TRIES = 20


class Placements:
    """A start pool (`FastEngine`'s `pool`) of both kinds.

    near: share of episodes that begin around a pose of a demonstrated trajectory, with person and goal about where they
    were at that moment. mixed: share in which each of robot, person and goal is, by chance, either there or where it is
    in a drawn scene. The others are drawn scenes of the environment, in which people stand. Who walked while something
    was demonstrated walks on from that moment in the first two kinds, except where the person is a drawn scene's.
    """

    def __init__(self, trajectories: Sequence[Trajectory], *, near: float, mixed: float = 0.0, seed: int) -> None:
        setup = get_setup(trajectories[0].scene.setup)
        self._anywhere, self._spacing = ScenePool(setup, seed), spacing_of(setup)
        self._rows = scenes_to_rows([trajectory.scene for trajectory in trajectories])
        self._poses = [trajectory.poses.astype(float) for trajectory in trajectories]
        self._people = [trajectory.scene.person_poses(trajectory.times) for trajectory in trajectories]
        longest = np.arange(2 * setup.max_steps + 1) * CONTROL_DT_S
        self._walks = [
            trajectory.scene.person_poses(longest) if trajectory.scene.walk is not None else None
            for trajectory in trajectories
        ]
        self._near, self._mixed = near, mixed
        self._steps = setup.max_steps
        self._random = np.random.default_rng([seed, 0xDE])

    def take(self, count: int) -> tuple[k.Rows, NDArray[np.int64]]:
        """The next scenes: rows (count, columns) and their seeds (count,), those of the drawn scenes."""
        rows, seeds, _ = self.take_walking(count)
        return rows, seeds

    def take_walking(self, count: int) -> tuple[k.Rows, NDArray[np.int64], NDArray[np.float64]]:
        """As `take`, and where people are after every step: (count, max_steps + 1, 3), NaN for those who stand."""
        rows, seeds = self._anywhere.take(count)
        walks = np.full((count, self._steps + 1, 3), np.nan)
        kinds = self._random.random(count)
        for i in np.flatnonzero(kinds < self._near + self._mixed):
            beside = self._beside_a_trajectory(rows[i] if kinds[i] >= self._near else None)
            if beside is not None:
                rows[i], walk = beside
                if walk is not None:
                    walks[i] = walk
        return rows, seeds, walks

    def _beside_a_trajectory(self, drawn: k.Row | None) -> tuple[k.Row, NDArray[np.float64] | None] | None:
        """A demonstrated scene with everything moved a little and how its person walks on, None where that did not fit
        after some tries.

        drawn: where each of robot, person and goal is taken from instead, half of the time.
        """
        random = self._random
        for _ in range(TRIES):
            which = random.integers(len(self._poses))
            row: k.Row = self._rows[which].copy()
            moment = random.integers(max(1, len(self._poses[which]) - NOT_AT_THE_GOAL))
            row[k.START_X : k.START_YAW + 1] = self._poses[which][moment]
            row[k.PERSON_X : k.PERSON_YAW + 1] = self._people[which][moment]
            walk = self._walks[which]
            for column in (k.START_X, k.GOAL_X, k.PERSON_X):
                row[column : column + 2] += random.normal(0.0, NEAR_M, 2)
                row[column + 2] = k.wrap(row[column + 2] + random.normal(0.0, NEAR_RAD))
                if drawn is not None and random.random() < 0.5:
                    row[column : column + 3] = drawn[column : column + 3]
                    walk = None if column == k.PERSON_X else walk
            if self._fits(row):
                return row, self._shift_walk(walk, int(moment), row)
        return None

    def _shift_walk(self, walk: NDArray[np.float64] | None, moment: int, row: k.Row) -> NDArray[np.float64] | None:
        """(max_steps + 1, 3) the walk from that moment on, shifted to where the person was moved to."""
        if walk is None:
            return None
        ahead = walk[moment : moment + self._steps + 1].copy()
        ahead[:, :2] += row[k.PERSON_X : k.PERSON_X + 2] - ahead[0, :2]
        return ahead

    def _fits(self, row: k.Row) -> bool:
        robot = self._spacing.robot_radius + self._spacing.spare_on_the_way
        for column in (k.START_X, k.GOAL_X):
            x, y = row[column], row[column + 1]
            if k.surface_distance(row, x, y) < robot or k.person_distance(row, x, y) < robot + row[k.PERSON_RADIUS]:
                return False
        if math.dist(row[[k.START_X, k.START_Y]], row[[k.GOAL_X, k.GOAL_Y]]) <= row[k.GOAL_RADIUS]:
            return False
        return bool(k.surface_distance(row, row[k.PERSON_X], row[k.PERSON_Y]) >= row[k.PERSON_RADIUS])
