"""A controller that needs no training: it heads for the goal through the gap that the lidar shows. What it does fills
replay buffers before a policy can drive, and draws the first updates, so that arriving is learned first. Ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled
from desirepath.simulation.setups import Setup, require_lidar

Floats = NDArray[np.float32]

SPARE_M = 0.1  # beside the robot's body, of a gap that counts as free
LOOK_AHEAD_S = 2.0  # at full speed, of which nothing may be in the way
STOPS_WITHIN_M = 0.35  # of free way ahead beyond the body it slows down
TURN_PER_S = 2.5  # of the bearing that it wants
BLOCKED_COSTS = 4.0  # of a way that is blocked whole, in radians off the goal
TURNING_COSTS = 0.3  # of a way off straight ahead, likewise: it does not waver between two sides of a thing


@compiled
def free_ways(ranges: Floats, along: Floats, beside: Floats, half_width: float, reach: float, ways: Floats) -> None:
    """Write into `ways` (n, headings) how far (m) each heading is free, of ranges (n, sectors) in metres. along, beside
    (headings, sectors): cosine and sine of the angle between them."""
    for i in range(len(ranges)):
        for h in range(len(along)):
            nearest = reach
            for s in range(len(along[0])):
                seen = ranges[i, s]
                ahead = seen * along[h, s]
                if seen < reach and 0 < ahead < nearest and seen * beside[h, s] < half_width:
                    nearest = ahead
            ways[i, h] = nearest


class GoalSeeker:
    """Actions from a setup's observation alone. Raises SetupError for a setup without a lidar."""

    def __init__(self, setup: Setup) -> None:
        require_lidar(setup)
        robot, lidar = setup.robot, setup.robot.lidar
        self._setup, self._limits, self._reach = setup, robot.limits, lidar.range_m
        sectors = np.array(lidar.middles()) + lidar.yaw_rad
        self._headings = np.remainder(sectors + np.pi, 2 * np.pi) - np.pi
        apart = self._headings[:, None] - sectors[None, :]
        self._along = np.cos(apart).astype(np.float32)
        self._beside = np.abs(np.sin(apart)).astype(np.float32)
        self._body_m, self._half_width_m = robot.radius_m, robot.inscribed_m + SPARE_M
        self._first_lidar = setup.polar_size

    def act(self, observations: Floats) -> Floats:
        """observations (n, obs) -> actions (n, 2) in [-1, 1]."""
        limits = self._limits
        goal_m = observations[:, 0] * self._setup.distance_scale_m
        bearing = observations[:, 1] * np.pi
        ranges = np.ascontiguousarray(observations[:, self._first_lidar :]) * np.float32(self._reach)
        free_m = np.empty((len(observations), len(self._headings)), dtype=np.float32)
        free_ways(ranges, self._along, self._beside, self._half_width_m, self._reach, free_m)
        free_m -= self._body_m
        wanted_m = np.minimum(goal_m, self._body_m + LOOK_AHEAD_S * limits.v_max)
        off = np.abs(np.remainder(self._headings - bearing[:, None] + np.pi, 2 * np.pi) - np.pi)
        blocked = np.maximum(wanted_m[:, None] - free_m, 0) / wanted_m[:, None]
        chosen = (off + BLOCKED_COSTS * blocked + TURNING_COSTS * np.abs(self._headings)).argmin(axis=1)
        rows = np.arange(len(observations))
        heading = np.where(blocked[rows, chosen] + off[rows, chosen] < 0.2, bearing, self._headings[chosen])
        slowed = np.clip(free_m[:, np.abs(self._headings).argmin()] / STOPS_WITHIN_M, 0.1, 1)
        speed = limits.v_max * np.clip(np.cos(heading), 0, 1) ** 2 * slowed
        forward = 2 * (speed - limits.v_min) / (limits.v_max - limits.v_min) - 1
        turning = TURN_PER_S * heading / limits.w_max
        actions: Floats = np.clip(np.stack([forward, turning], axis=1), -1, 1).astype(np.float32)
        return actions
