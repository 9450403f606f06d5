"""Left and right exchanged: what a robot observes and does in the mirrored world. For training data and for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.setups import Setup, require_lidar
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
ACTION_SIGNS = np.array([1, -1], dtype=np.float32)
"""actions * ACTION_SIGNS: the same driving with left and right exchanged."""


class Mirror(NamedTuple):
    """observations[:, order] * signs is the observation in the mirrored world.

    Bearings and turning change sign, lidar sectors come in reverse: sector k covers [k, k + 1) sector widths from
    straight ahead. The beams lie on each sector's near edge, so a mirrored sector looks through beams that are one beam
    (1 degree or 0.5) beside; everything else is exact.
    """

    order: NDArray[np.int64]
    signs: Floats

    def seen_in(self, trajectory: Trajectory) -> Trajectory:
        """What the robot observed and did, with left and right exchanged. Scene and poses stay as they are."""
        return replace(
            trajectory,
            observations=trajectory.observations[:, self.order] * self.signs,
            actions=trajectory.actions * ACTION_SIGNS,
            next_observations=trajectory.next_observations[:, self.order] * self.signs,
        )


def mirror_of(setup: Setup) -> Mirror:
    """How observations of that setup are mirrored. Raises SetupError for one without lidar."""
    require_lidar(setup)
    order, signs = np.arange(setup.observation_size), np.ones(setup.observation_size, dtype=np.float32)
    order[setup.polar_size :] = order[setup.polar_size :][::-1]
    signs[1] = -1  # goal bearing
    if setup.person_inputs is not None:
        signs[setup.person_inputs[1]] = -1
    first = 2 + 2 * setup.with_person
    for k in range(setup.pedestrians):  # motion across the robot's heading; of all but the nearest, the bearing, too
        signs[first + 4 * k + 1] = -1
        if k:
            signs[first + 4 * k - 1] = -1
    path = first + setup.pedestrian_inputs
    signs[path + 1 : path + 2 * setup.path_points : 2] = -1
    if setup.with_velocity:
        signs[setup.polar_size - 1] = -1  # angular velocity
    return Mirror(order, signs)
