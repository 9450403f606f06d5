"""A guide that knows the drawn paths: where an episode is like a demonstrated one, it drives down that path from where
the robot is; elsewhere it knows the scene (`way_guide.py`). Imitating it takes seconds. Privileged, for training alone.
Ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from desirepath.learning.td3.backprop import Floats
from desirepath.learning.td3.way_guide import STRAIGHT_M, WayGuide, bearings_of, towards
from desirepath.simulation import kernels as k
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.trajectory import Trajectory

LIKE_M = 0.6
"""How far start, person and goal of an episode may be from where they were when a path was drawn, and the robot from
the path, for it to be followed."""
AHEAD_M = 0.25  # down the path, where it heads for
TURN_PER_S = 4.0  # of the bearing that it wants


class PathGuide(WayGuide):
    """What to do in each environment of an engine, by the demonstrated trajectories where they say it."""

    def __init__(self, engine: FastEngine, trajectories: Sequence[Trajectory]) -> None:
        super().__init__(engine)
        n, longest = len(trajectories), max(len(trajectory.poses) for trajectory in trajectories)
        self._paths, self._people = np.empty((n, longest, 2)), np.empty((n, longest, 2))
        self._driven, self._speeds = np.empty((n, longest)), np.empty((n, longest))
        """By demonstration and pose, the last repeated: metres from the start, m/s."""
        for i, trajectory in enumerate(trajectories):
            path, rest = trajectory.poses[:, :2], longest - len(trajectory.poses)
            steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
            self._paths[i] = np.pad(path, ((0, rest), (0, 0)), mode="edge")
            self._people[i] = np.pad(
                trajectory.scene.person_poses(trajectory.times)[:, :2], ((0, rest), (0, 0)), mode="edge"
            )
            self._driven[i] = np.pad(np.concatenate([[0.0], np.cumsum(steps)]), (0, rest), mode="edge")
            self._speeds[i] = np.pad(steps / trajectory.dt, (0, rest + 1), mode="edge")
        self._goals = np.array([(t.scene.goal.x, t.scene.goal.y) for t in trajectories])
        self._followed = np.full(engine.n_envs, -1)

    def act(self) -> Floats:
        """Actions (n, 2) in [-1, 1] for where the engine's robots are now."""
        actions = super().act()
        following = np.flatnonzero(self._followed >= 0)
        poses, which = self._engine.poses[following], self._followed[following]
        away = np.linalg.norm(self._paths[which] - poses[:, None, :2], axis=2)
        nearest = away.argmin(axis=1)
        goals = self._engine.rows[following][:, [k.GOAL_X, k.GOAL_Y]]
        wanted = self._driven[which, nearest] + AHEAD_M
        on_the_path = (
            (away.min(axis=1) < LIKE_M)
            & (wanted < self._driven[which, -1])
            & (np.linalg.norm(goals - poses[:, :2], axis=1) > STRAIGHT_M / 2)
        )
        following, poses, which, nearest, wanted = (
            of[on_the_path] for of in (following, poses, which, nearest, wanted)
        )
        ahead = (self._driven[which] < wanted[:, None]).sum(axis=1)
        aside = self._paths[which, ahead] - poses[:, :2]
        bearing = bearings_of(aside, poses[:, 2])
        speed = self._speeds[which, nearest] * np.clip(np.cos(bearing), 0, 1) ** 2
        actions[following] = towards(bearing, speed, TURN_PER_S, self._setup.robot.limits)
        return actions

    def _find_ways(self, i: int, row: k.Row) -> None:
        super()._find_ways(i, row)
        at = {column: row[column : column + 2] for column in (k.START_X, k.PERSON_X, k.GOAL_X)}
        from_start = np.linalg.norm(self._paths - at[k.START_X], axis=2)
        begins = from_start.argmin(axis=1)
        each = np.arange(len(begins))
        apart = np.stack(
            [
                from_start[each, begins],
                np.linalg.norm(self._people[each, begins] - at[k.PERSON_X], axis=1),
                np.linalg.norm(self._goals - at[k.GOAL_X], axis=1),
            ]
        )
        alike = apart.max(axis=0) < LIKE_M
        self._followed[i] = np.where(alike, apart.sum(axis=0), math.inf).argmin() if alike.any() else -1
