"""The dynamic window approach (Fox, Burgard and Thrun 1997) on the lidar: no person, only things not to touch.

It reads its own observation of the same scenes (`lidar_setup`): goal, velocity and every beam.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.demonstration import as_actions
from desirepath.simulation import kernels as k
from desirepath.simulation.setups import CONTROL_DT_S, Setup

Floats = NDArray[np.float32]
FIRST_BEAM = 6  # after goal, person and velocity


@dataclass(frozen=True)
class DwaConfig:
    """Defaults of ROS's dwa_local_planner where it has one, else ours."""

    turn_acceleration: float = 3.2  # rad/s^2
    fastest_turn: float = 1.5  # rad/s, ours
    acceleration: float = 2.5  # m/s^2
    ahead_s: float = 4.0  # ours: the planner's 1.7 s are 0.4 m at this robot's speed
    speeds: int = 4
    turns: int = 21
    heading_weight: float = 1.0
    clearance_weight: float = 0.3
    speed_weight: float = 0.2
    enough_clearance_m: float = 0.4  # more earns nothing
    spare_m: float = 0.05


def lidar_setup(setup: Setup) -> Setup:
    """The same environment as a robot sees it that knows its goal, its velocity and an unpooled scan."""
    unpooled = replace(setup.robot.lidar, sectors=setup.robot.lidar.beams)
    return replace(setup, solids=0, with_velocity=True, robot=replace(setup.robot, lidar=unpooled))


class Dwa:
    """The controller for one setup: observations of `lidar_setup` in, actions out, no memory."""

    def __init__(self, setup: Setup) -> None:
        self.setup = lidar_setup(setup)
        self.config = DwaConfig()
        lidar = self.setup.robot.lidar
        angles = np.array(lidar.bearings()) + lidar.yaw_rad
        self._mount = np.array([lidar.x_m, lidar.y_m])
        self._directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def act(self, observations: Floats) -> Floats:
        """observations (n, obs) of `self.setup` -> actions (n, 2) in [-1, 1]."""
        setup, config = self.setup, self.config
        commands = np.empty((len(observations), 2))
        for i, seen in enumerate(observations.astype(np.float64)):
            ranges = seen[FIRST_BEAM:] * setup.robot.lidar.range_m
            points = self._directions[ranges < setup.robot.lidar.range_m - 1e-6]
            points = points * ranges[ranges < setup.robot.lidar.range_m - 1e-6, None] + self._mount
            distance, bearing = seen[0] * setup.distance_scale_m, seen[1] * math.pi
            goal = np.array([distance * math.cos(bearing), distance * math.sin(bearing)])
            speeds, turns = self._window(seen[4] * setup.robot.limits.v_max, seen[5] * setup.robot.limits.w_max)
            commands[i] = k.best_command(
                speeds,
                turns,
                goal,
                np.ascontiguousarray(points),
                round(config.ahead_s / CONTROL_DT_S),
                CONTROL_DT_S,
                setup.robot.radius_m + config.spare_m,
                config.enough_clearance_m,
                np.array([config.heading_weight, config.clearance_weight, config.speed_weight]),
            )
        return as_actions(setup, commands)

    def _window(self, v: float, w: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Speeds and turn rates that can be reached within one step."""
        config, limits = self.config, self.setup.robot.limits
        reach = config.acceleration * CONTROL_DT_S
        low, high = max(limits.v_min, v - reach), min(limits.v_max, v + reach)
        turn = config.turn_acceleration * CONTROL_DT_S
        left, right = min(config.fastest_turn, w + turn), max(-config.fastest_turn, w - turn)
        return np.linspace(min(low, high), high, config.speeds), np.linspace(right, left, config.turns)
