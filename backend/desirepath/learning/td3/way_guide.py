"""A guide that knows the scene: it drives down the field of shortest ways to the goal, around furniture, walls and the
person. Policies imitate it, it fills replay buffers before a policy can drive, and draws the first updates. The field
is smooth (ways of any direction, not along a grid), since what it does is learned by a network. Privileged, for
training alone: no policy sees what it sees. Ours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.crowds.planning_kernels import arrival_times, look_ahead
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.scenes import map_of
from desirepath.simulation.setups import Limits

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

CELL_M = 0.12
MARGIN_M = 2.0  # around start and goal, in which ways are looked for
SPARE_M, WANTED_M = (0.03, 0.04), (0.3, 0.1)
"""Room beside the body, at least, and as much as costs nothing: metres, and seconds at its fastest. Whoever imitates it
errs by more the faster the robot is."""
BLOCKED = 60.0  # what a cell costs that the body has no room in; finite, so that the field leads out of it
LEAD_M = 0.36  # before the body, where the way is looked for: of two ways as short it is the one that it faces
LOOK_AHEAD = 4  # cells down the way, which it heads for
STRAIGHT_M = 0.6  # before the goal it heads for the goal itself
TURN_PER_S = 2.5  # of the bearing that it wants


class WayGuide:
    """What to do in each environment of an engine, from where its robot is."""

    def __init__(self, engine: FastEngine) -> None:
        self._engine, self._setup = engine, engine.setup
        here = map_of(engine.setup)
        self._ground = here.ground if here else None
        n = engine.n_envs
        self._ends, self._low = np.full((n, 4), np.nan), np.zeros((n, 2))
        self._sizes, self._fields = np.zeros((n, 2), dtype=np.int64), np.zeros((n, 0, 0), dtype=np.float32)

    def act(self) -> Floats:
        """Actions (n, 2) in [-1, 1] for where the engine's robots are now."""
        limits, rows, poses = self._setup.robot.limits, self._engine.rows, self._engine.poses
        ends = rows[:, [k.START_X, k.START_Y, k.GOAL_X, k.GOAL_Y]]
        for i in np.flatnonzero((ends != self._ends).any(axis=1)):
            self._find_ways(int(i), rows[i])
        self._ends = ends
        places, goals, cells = poses[:, :2], ends[:, 2:], np.empty((len(poses), 2))
        yaw = poses[:, 2]
        led = places + LEAD_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        at, end = (led - self._low) / CELL_M, (goals - self._low) / CELL_M
        look_ahead(self._fields, self._sizes, at, end, LOOK_AHEAD, cells)
        near = np.linalg.norm(goals - places, axis=1) < STRAIGHT_M
        aside = np.where(near[:, None], goals, self._low + cells * CELL_M) - places
        bearing = bearings_of(aside, yaw)
        return towards(bearing, limits.v_max * np.clip(np.cos(bearing), 0, 1) ** 4, TURN_PER_S, limits)

    def _find_ways(self, i: int, row: k.Row) -> None:
        """Fill the field of environment i: ways to the goal on a grid of cells that cost more near things."""
        ends = np.array([[row[k.START_X], row[k.START_Y]], [row[k.GOAL_X], row[k.GOAL_Y]]])
        low, high = ends.min(axis=0) - MARGIN_M, ends.max(axis=0) + MARGIN_M
        if row[k.ROOM_HALF_X] > 0:
            half = row[[k.ROOM_HALF_X, k.ROOM_HALF_Y]]
            low, high = np.maximum(low, -half), np.minimum(high, half)
        columns, lines = np.maximum(np.ceil((high - low) / CELL_M).astype(int), 2)
        more = [max(0, wanted - there) for wanted, there in zip((columns, lines), self._fields.shape[1:], strict=True)]
        if any(more):
            self._fields = np.pad(self._fields, ((0, 0), (0, more[0]), (0, more[1])))
        costs, robot = np.empty((columns, lines), dtype=np.float32), self._setup.robot
        spare, wanted = (at_rest + of_speed * robot.limits.v_max for at_rest, of_speed in (SPARE_M, WANTED_M))
        k.way_costs(row, low[0], low[1], CELL_M, robot.radius_m + spare, wanted, BLOCKED, costs, self._ground)
        goal = (ends[1] - low) / CELL_M
        arrival_times(costs, goal[0], goal[1], self._fields[i, :columns, :lines])
        self._low[i], self._sizes[i] = low, (columns, lines)


def bearings_of(aside: Doubles, yaw: Doubles) -> Doubles:
    """(n,) in [-pi, pi) of places (n, 2) relative to robots that look along yaw."""
    turned: Doubles = np.remainder(np.arctan2(aside[:, 1], aside[:, 0]) - yaw + math.pi, 2 * math.pi) - math.pi
    return turned


def towards(bearing: Doubles, speed: Doubles, turn_per_s: float, limits: Limits) -> Floats:
    """Actions (n, 2) in [-1, 1] that drive at a speed (m/s) and turn by so much of the bearing in a second."""
    forward = 2 * (speed - limits.v_min) / (limits.v_max - limits.v_min) - 1
    return np.clip(np.stack([forward, turn_per_s * bearing / limits.w_max], axis=1), -1, 1).astype(np.float32)
