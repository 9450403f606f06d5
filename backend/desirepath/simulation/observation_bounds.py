"""Between what a setup's observations and actions lie: finite boxes, as learners and data sets need them.

Numbers only; the spaces of a library are made of them in `environments.py`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.setups import CONTROL_DT_S, Setup

FARTHEST_AT_START_M = 20.0  # more than any generator puts between two things; bounds the observation space
ACTION_SIZE = 2
"""Forward speed and turn rate, both scaled to [-1, 1]."""

Floats = NDArray[np.float32]


def observation_bounds(setup: Setup) -> tuple[Floats, Floats]:
    """Lowest and highest (n,) of each input; distances are bounded by how far a robot can drive in an episode."""
    far = FARTHEST_AT_START_M + setup.robot.limits.v_max * CONTROL_DT_S * setup.max_steps
    low, high = np.zeros(setup.observation_size), np.ones(setup.observation_size)
    if setup.solids:
        distances = np.r_[0, setup.polar_size : setup.observation_size : 3]
        low[:] = -1.0
        low[distances], high[distances] = 0.0, far / setup.distance_scale_m
    else:
        for distance, bearing in filter(None, ((0, 1), setup.person_inputs)):
            low[bearing], high[distance] = -1.0, far / setup.distance_scale_m
        first = 2 + 2 * setup.with_person
        motion = slice(first, first + setup.pedestrian_inputs)
        low[motion], high[motion] = -1.0, far / setup.distance_scale_m
        path = slice(motion.stop, motion.stop + 2 * setup.path_points)
        low[path], high[path] = -far / setup.distance_scale_m, far / setup.distance_scale_m
        if setup.with_velocity:
            velocity = setup.polar_size - 2
            low[velocity], low[velocity + 1] = setup.robot.limits.v_min / setup.robot.limits.v_max, -1.0
    return low.astype(np.float32), high.astype(np.float32)
