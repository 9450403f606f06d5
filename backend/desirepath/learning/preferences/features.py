"""Nine per-step features of a trajectory that people may care about, read from observations alone.

What they weigh is learned in `reward_model.py`. All features are <= 0: less is worse, zero is "nothing to complain".
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.scene import Person, Pose
from desirepath.simulation.setups import Setup, require_person

Floats = NDArray[np.float32]

# Spec 06, "What moves the robot": hinges that start to hurt below these distances.
HUMAN_HINGES_M = (1.0, 2.0, 4.0)
CLEARANCE_HINGES_M = (0.3, 0.8)
FEATURE_NAMES = (
    *(f"person within {radius:g} m" for radius in HUMAN_HINGES_M),
    *(f"obstacle within {radius:g} m" for radius in CLEARANCE_HINGES_M),
    "driving slowly",
    "turning",
    "time",
    "distance to goal",
)
CLOSENESS = np.array([" within " in name for name in FEATURE_NAMES])
"""(9,) bool: the features that say how near something was."""
PERSON_RADIUS_M = Person(Pose(0, 0)).radius
MASK_MARGIN_RAD = 0.05


def obstacle_clearance_m(observations: Floats, setup: Setup) -> Floats:
    """(n,) distance (m) from the robot's surface to the nearest lidar return that is not the person.

    Sectors that the person covers are left out; where nothing else is in range, the lidar's range. Raises SetupError
    for a setup without lidar, or whose robot is not told where the person is.
    """
    require_person(setup)
    lidar = setup.robot.lidar
    width = 2 * math.pi / lidar.sectors_of_a_turn
    centres = np.array(lidar.middles()).astype(np.float32)
    person_m = np.maximum(observations[:, 2] * setup.distance_scale_m, PERSON_RADIUS_M)
    half_angle = np.arcsin(PERSON_RADIUS_M / person_m) + width / 2 + MASK_MARGIN_RAD
    apart = np.abs(centres[None] - (observations[:, 3] * math.pi)[:, None])  # in [0, 3 pi]
    apart = np.minimum(apart, np.abs(2 * math.pi - apart))
    ranges = np.where(apart < half_angle[:, None], np.float32(1.0), observations[:, setup.polar_size :])
    clearance: Floats = ranges.min(axis=1) * np.float32(setup.robot.lidar.range_m) - np.float32(setup.robot.radius_m)
    return clearance


def step_features(actions: Floats, next_observations: Floats, setup: Setup) -> Floats:
    """(n, 9) float32 in the order of FEATURE_NAMES, of the states that the steps led to."""
    person_m = next_observations[:, 2] * setup.distance_scale_m
    clearance_m = obstacle_clearance_m(next_observations, setup)
    columns = [-np.square(np.maximum(1 - person_m / radius, 0)) for radius in HUMAN_HINGES_M]
    columns += [-np.square(np.clip(1 - clearance_m / radius, 0, 1)) for radius in CLEARANCE_HINGES_M]
    columns += [
        (actions[:, 0] - 1) / 2,
        -np.square(actions[:, 1]),
        np.full(len(actions), -1.0),
        -next_observations[:, 0],
    ]
    return np.stack(columns, axis=1).astype(np.float32)
