"""How much of a robot a person sees from where they stand: furniture and people may hide it. Geometry alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.explain.shown_explanation import PERSON, people_of, solids_of
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Trajectory

LEAST_IN_SIGHT = 0.5  # ours: of the robot, where people are asked what mattered to it
_ACROSS, _UP = np.linspace(-0.95, 0.95, 9), np.linspace(0.08, 1.0, 7)  # shares of its radius and height


def share_in_sight(scene: Scene, x: float, y: float, at_s: float) -> float:
    """Share of the robot at (x, y) m, as a disc upright before the eyes, that nothing hides from the scene's person
    at that moment, 0 to 1. Walls of the room hide nothing: both are inside.
    """
    person_x, person_y, _ = (float(value) for value in scene.person_poses([at_s])[0])
    eye = np.array([person_x, person_y, scene.person.eye_height_m])
    towards = np.array([x - person_x, y - person_y])
    aside = np.array([-towards[1], towards[0]]) / max(float(np.linalg.norm(towards)), 1e-9)
    robot = get_setup(scene.setup).robot
    across, up = (grid.ravel() for grid in np.meshgrid(_ACROSS * robot.radius_m, _UP * robot.height_m))
    spots = np.column_stack([x + across * aside[0], y + across * aside[1], up])
    hidden = np.zeros(len(spots), np.bool_)
    crowd = solids_of(scene, people_of(scene), at_s) if scene.crowd else ()
    for solid in (*scene.obstacles, *(body for body in crowd if body.kind != PERSON)):
        c, s = np.cos(solid.pose.yaw), np.sin(solid.pose.yaw)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        middle = np.array([solid.pose.x, solid.pose.y, solid.height / 2])
        half = np.array([solid.length, solid.width, solid.height]) / 2
        hidden |= _meets(turn @ (eye - middle), (spots - middle) @ turn.T, half)
    return float(1.0 - hidden.mean())


def halts_in_sight(trajectory: Trajectory) -> bool:
    """Whether the scene's person sees the robot where the trajectory ends."""
    x, y = (float(value) for value in trajectory.poses[-1, :2])
    at_s = (len(trajectory.poses) - 1) * CONTROL_DT_S
    return share_in_sight(trajectory.scene, x, y, at_s) >= LEAST_IN_SIGHT


def _meets(eye: NDArray[np.float64], spots: NDArray[np.float64], half: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) which of the straight lines from the eye to spots (n, 3) go through a box about the origin."""
    way = spots - eye
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    sides = np.sort(np.stack([(-half - eye) / way, (half - eye) / way]), axis=0)
    enters, leaves = sides[0].max(axis=1), sides[1].min(axis=1)
    met: NDArray[np.bool_] = np.maximum(enters, 0.0) <= np.minimum(leaves, 1.0)
    return met
