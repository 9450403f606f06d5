"""Planners beside the learned policies, on the same scenes: the path alone, DWA, and ORCA and social force as planners.

The last two are told where everybody is and how they move, which no learned policy is; `follow` and `dwa` are not.
Searches further ahead: `foresight.py`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.pedestrians.crowd_evaluation import CrowdPlan
from desirepath.simulation.crowds import avoidance_kernels as avoid
from desirepath.simulation.crowds.crowd_engine import PERSON_RADIUS_M, CrowdEngine
from desirepath.simulation.kernels import best_command
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath_experiments.training.pedestrians.foresight import constant_velocity, foresight

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
SPEED_M_S = 0.6  # ours: of who only follows or plans by velocities
TURN_GAIN = 2.0  # ours: rad/s per rad off the wished direction
DWA_SPEEDS, DWA_TURNS, DWA_STEPS = 6, 15, 8
DWA_WEIGHTS = np.array([1.0, 1.0, 0.4])  # ours: heading, clearance, speed


def _towards(engine: CrowdEngine, directions: Doubles, speeds: Doubles) -> Floats:
    """Actions that turn to a direction (rad, robot's frame) and move at that speed (m/s) as far as they face it."""
    limits = engine.setup.robot.limits
    v = speeds * np.clip(np.cos(directions), 0, 1) ** 3
    w = np.clip(TURN_GAIN * directions, -limits.w_max, limits.w_max)
    scaled = 2 * (v - limits.v_min) / (limits.v_max - limits.v_min) - 1
    return np.stack([scaled, w / limits.w_max], axis=1).astype(np.float32)


def follow(engine: CrowdEngine) -> Floats:
    """Along the path at 0.6 m/s whatever comes."""
    ahead = engine.path_points[:, 2]
    return _towards(engine, np.arctan2(ahead[:, 1], ahead[:, 0]), np.full(engine.n_envs, SPEED_M_S))


def dwa(engine: CrowdEngine) -> Floats:
    """The dynamic window approach on the lidar, with the path's point 1.2 m ahead as its goal."""
    limits = engine.setup.robot.limits
    speeds = np.linspace(0.0, limits.v_max, DWA_SPEEDS)
    turns = np.linspace(-limits.w_max / 2, limits.w_max / 2, DWA_TURNS)
    actions = np.zeros((engine.n_envs, 2), np.float32)
    for i in np.flatnonzero(~engine.dones):
        seen = engine.points[i][engine.ranges[i] < engine.setup.robot.lidar.range_m - 1e-3]
        goal = engine.path_points[i, 4]
        v, w = best_command(
            speeds, turns, goal, seen, DWA_STEPS, CONTROL_DT_S, engine.setup.robot.radius_m + 0.03, 0.5, DWA_WEIGHTS
        )
        actions[i] = 2 * v / limits.v_max - 1, w / limits.w_max
    return actions


def _by_velocities(engine: CrowdEngine, *, forces: bool) -> Floats:
    w = engine.world
    directions, speeds = np.zeros(engine.n_envs), np.zeros(engine.n_envs)
    for i in np.flatnonzero(~engine.dones):
        people = int(w.people[i])
        x, y, yaw = w.robots[i]
        xy = np.vstack([w.robots[i, :2], w.people_xy[i, :people]])
        now = engine.robot_v[i]
        v = np.vstack([now, w.people_v[i, :people] * (w.speeds[i, :people] > 0)[:, None]])
        radii = np.array([engine.setup.robot.radius_m + 0.05, *[PERSON_RADIUS_M] * people])
        c, s = math.cos(yaw), math.sin(yaw)
        ahead = engine.path_points[i, 3]
        offset = np.array([c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1]])
        if forces:
            vx, vy = avoid.social_velocity(
                0, xy, v, radii, np.array([x, y]) + offset, SPEED_M_S, w.boxes[i], int(w.box_count[i]),
                avoid.ForceRules(wall_from_m=0.6),
            )  # fmt: skip
        else:
            wished = offset / max(float(np.linalg.norm(offset)), 1e-9) * SPEED_M_S
            vx, vy = avoid.orca_velocity(
                0, xy, v, radii, wished, 1.0, w.boxes[i], int(w.box_count[i]), avoid.OrcaRules()
            )
        directions[i] = math.atan2(math.sin(math.atan2(vy, vx) - yaw), math.cos(math.atan2(vy, vx) - yaw))
        speeds[i] = min(math.hypot(vx, vy), 1.0)
    return _towards(engine, directions, speeds)


def orca(engine: CrowdEngine) -> Floats:
    """ORCA's velocity for the robot, turned into commands, as if all did their half: only ORCA crowds do."""
    return _by_velocities(engine, forces=False)


def social_force(engine: CrowdEngine) -> Floats:
    """The social force model's velocity for the robot, turned into commands."""
    return _by_velocities(engine, forces=True)


PLANNERS: dict[str, CrowdPlan] = {
    "follow": follow, "dwa": dwa, "orca": orca, "social_force": social_force,
    "constant_velocity": constant_velocity, "foresight": foresight,
}  # fmt: skip
