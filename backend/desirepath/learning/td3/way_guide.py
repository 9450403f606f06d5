"""A guide that knows the scene: it drives down the field of shortest ways to the goal, around furniture, walls and the
person. It fills replay buffers before a policy can drive, and draws the first updates, so that arriving is learned
first. Privileged, for training alone: no policy sees what it sees. Ours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.crowds.planning_kernels import descend, distances
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.scenes import map_of

Floats = NDArray[np.float32]

CELL_M = 0.1
MARGIN_M = 2.5  # around start and goal, in which ways are looked for
SPARE_M, WANTED_M = 0.05, 0.35  # beside the body: at least, and as much as costs nothing
LOOK_AHEAD = 6  # cells down the way, which it heads for
STRAIGHT_M = 0.6  # before the goal it heads for the goal itself
TURN_PER_S = 2.5  # of the bearing that it wants


class WayGuide:
    """What to do in each environment of an engine, from where its robot is."""

    def __init__(self, engine: FastEngine) -> None:
        self._engine, self._setup = engine, engine.setup
        here = map_of(engine.setup)
        self._ground = here.ground if here else None
        self._ends = np.full((engine.n_envs, 4), np.nan)
        self._fields: list[Floats] = [np.zeros((0, 0), dtype=np.float32)] * engine.n_envs
        self._low = np.zeros((engine.n_envs, 2))

    def act(self) -> Floats:
        """Actions (n, 2) in [-1, 1] for where the engine's robots are now."""
        engine, limits = self._engine, self._setup.robot.limits
        rows, poses = engine.rows, engine.poses
        ends = rows[:, [k.START_X, k.START_Y, k.GOAL_X, k.GOAL_Y]]
        for i in np.flatnonzero((ends != self._ends).any(axis=1)):
            self._low[i], self._fields[i] = self._field(rows[i])
        self._ends = ends
        targets = np.array([self._target(i, ends[i, 2:], poses[i]) for i in range(engine.n_envs)])
        aside = targets - poses[:, :2]
        bearing = np.remainder(np.arctan2(aside[:, 1], aside[:, 0]) - poses[:, 2] + math.pi, 2 * math.pi) - math.pi
        speed = limits.v_max * np.clip(np.cos(bearing), 0, 1) ** 4
        forward = 2 * (speed - limits.v_min) / (limits.v_max - limits.v_min) - 1
        actions = np.stack([forward, TURN_PER_S * bearing / limits.w_max], axis=1)
        return np.clip(actions, -1, 1).astype(np.float32)

    def _field(self, row: k.Row) -> tuple[NDArray[np.float64], Floats]:
        """The corner of a grid and the ways' lengths to the goal on it, in cells that cost more near things."""
        ends = np.array([[row[k.START_X], row[k.START_Y]], [row[k.GOAL_X], row[k.GOAL_Y]]])
        low = ends.min(axis=0) - MARGIN_M
        size = np.ceil((ends.max(axis=0) + MARGIN_M - low) / CELL_M).astype(int)
        middles = (low[axis] + (np.arange(size[axis]) + 0.5) * CELL_M for axis in (0, 1))
        costs = np.empty(size, dtype=np.float32)
        places = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
        k.way_costs(row, places, self._setup.robot.radius_m + SPARE_M, WANTED_M, costs, self._ground)
        i, j = ((ends[1] - low) / CELL_M).astype(int)
        return low, distances(costs, (int(i), int(j)), np.inf)

    def _target(self, environment: int, goal: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where to head for: some cells down the way; the goal itself where it is near, or no way is known."""
        if math.dist(goal, pose[:2]) < STRAIGHT_M:
            return goal
        field, low = self._fields[environment], self._low[environment]
        cell = self._nearest_known(field, (pose[:2] - low) / CELL_M)
        if cell is None:
            return goal
        last = descend(field, *cell, LOOK_AHEAD)[-1]
        return low + (last + 0.5) * CELL_M if field[last[0], last[1]] > 0 else goal

    @staticmethod
    def _nearest_known(field: Floats, at: NDArray[np.float64]) -> tuple[int, int] | None:
        """The cell there, else the one of least way among its neighbours."""
        i, j = (min(max(int(at[axis]), 0), field.shape[axis] - 1) for axis in (0, 1))
        if np.isfinite(field[i, j]):
            return i, j
        a, b = max(i - 4, 0), max(j - 4, 0)
        near = field[a : i + 5, b : j + 5]
        u, v = np.unravel_index(int(near.argmin()), near.shape)
        return (a + int(u), b + int(v)) if np.isfinite(near[u, v]) else None
