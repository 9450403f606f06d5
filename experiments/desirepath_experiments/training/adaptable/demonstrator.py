"""The demonstration of section 5.3.4.3, programmed: straight at the person, clockwise around them, on to the goal.

A function of where goal and person are, without memory, so that it can be cloned. It does not see obstacles: rollouts
that touch one are left out, as in the thesis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.fast import make_engine, rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

ADAPTABLE = get_setup("adaptable")

Floats = NDArray[np.float32]
ORBIT_M = 1.0  # section 5.3.4.3
LEAVES_AT_RAD = 0.15  # ours: so near to "between person and goal"; about one step of the orbit
PAST_RAD = math.pi / 2  # ours: so far past it, it goes on to the goal instead of around once more
PULL_PER_M = 2.0  # ours: steers back to the orbit by atan(2 d) for d metres beside it
APPROACH_UNTIL_M = 1.06  # ours: half a step outside the orbit it turns left


def demonstrate_actions(observations: Floats) -> Floats:
    """observations (n, 34) of `adaptable` -> actions (n, 2)."""
    scale = ADAPTABLE.distance_scale_m
    goal_m, goal = observations[:, 0] * scale, observations[:, 1] * math.pi
    person_m, person = observations[:, 2] * scale, observations[:, 3] * math.pi
    # Everything in the robot's frame: it stands at the origin and looks along x.
    to_goal = np.stack([goal_m * np.cos(goal), goal_m * np.sin(goal)], axis=1)
    to_person = np.stack([person_m * np.cos(person), person_m * np.sin(person)], axis=1)
    robot_bearing = np.arctan2(-to_person[:, 1], -to_person[:, 0])  # direction from the person to the robot
    goal_bearing = np.arctan2(*(to_goal - to_person).T[::-1])  # and to the goal
    left = np.mod(robot_bearing - goal_bearing, 2 * math.pi)  # still to go around, clockwise
    half_step = ADAPTABLE.robot.limits.v_max * CONTROL_DT_S / 2 / ORBIT_M
    around = robot_bearing - math.pi / 2 - half_step - np.arctan(PULL_PER_M * (person_m - ORBIT_M))
    heading = np.where(person_m > APPROACH_UNTIL_M, person, around)
    leaves = (left < LEAVES_AT_RAD) | (left > 2 * math.pi - PAST_RAD)
    heading = np.where(leaves, goal, heading)
    error = np.mod(heading + math.pi, 2 * math.pi) - math.pi
    turn = np.clip(error / (ADAPTABLE.robot.limits.w_max * CONTROL_DT_S), -1, 1)
    forward = 2 * np.clip(np.cos(error), 0, 1) ** 2 - 1
    return np.stack([forward, turn], axis=1).astype(np.float32)


def demonstrate_in(scenes: Sequence[Scene], *, disturbed: float = 0.0, seed: int = 0) -> list[Trajectory]:
    """The demonstration in each of the scenes where it touches nothing and arrives.

    disturbed: the share of steps in which the robot acts at random and the demonstration says how to go on from there
    (DART, Laskey et al. 2017; ours): what is recorded as action is always the demonstration's. Without it a clone
    never sees how to come back to the way.
    """
    random = np.random.default_rng([seed, 50])

    def disturb_actions(observations: Floats) -> Floats:
        drawn = random.uniform(-1, 1, (len(observations), 2)).astype(np.float32)
        return np.where(random.random((len(observations), 1)) < disturbed, drawn, demonstrate_actions(observations))

    return [
        replace(trajectory, actions=demonstrate_actions(trajectory.observations))
        for trajectory in rollout(ADAPTABLE, disturb_actions, scenes)
        if trajectory.outcome == Outcome.SUCCESS
    ]


def demonstrate_paths(scenes: Sequence[Scene]) -> list[NDArray[np.float64]]:
    """(steps + 1, 2) the demonstration in each scene as if there were no obstacles: what rollouts are compared with."""
    empty = [replace(scene, obstacles=()) for scene in scenes]
    engine = make_engine(ADAPTABLE, len(empty), auto_reset=False, scenes=empty)
    while not engine.dones.all():
        engine.step(demonstrate_actions(engine.observations))
    return [engine.path(i) for i in range(len(empty))]
