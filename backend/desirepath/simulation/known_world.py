"""What a robot knows of a place that it has no map of: where its lidar's beams ended, from wherever it has been.

What no beam has crossed counts as free. People are told of apart, so that beams that end at them mark nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Never

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.ground_maps import GroundMap
from desirepath.simulation.scene import Pose, Scene, SceneError
from desirepath.simulation.setups import Setup

Doubles = NDArray[np.float64]
CELL_M = 0.05
MARGIN_M = 1.0  # around all that is known: a robot that leaves it has left what anybody can tell
AT_PEOPLE_M = 0.1  # beyond a person's outline a beam still ended at them
FARTHEST_M = 60.0  # from where the robot is now: what lies beyond is forgotten


@dataclass(frozen=True)
class SeenScene(Scene):
    """A scene as a robot that drives there knows it. seen: of its surroundings; its obstacles are in there."""

    seen: GroundMap | None = None

    def as_dict(self) -> Never:
        raise SceneError("seen", "a robot's own map", "is what a robot believes in one moment: it is not stored")


class KnownWorld:
    """Grows scan by scan."""

    def __init__(self) -> None:
        self._cells: set[tuple[int, int]] = set()

    def see(self, ended: Doubles, people: Sequence[tuple[float, float]], person_m: float) -> None:
        """ended (n, 2): where beams ended, metres; people: where they stand, each within that radius."""
        for x, y in people:
            ended = ended[np.hypot(ended[:, 0] - x, ended[:, 1] - y) > person_m + AT_PEOPLE_M]
        self._cells |= set(map(tuple, np.floor(ended / CELL_M).astype(np.int64).tolist()))

    def map_around(self, places: Sequence[Pose]) -> GroundMap:
        """All that was seen near the first of the places, where the robot is, with room for all of them."""
        here = np.array([(place.x, place.y) for place in places])
        cells = np.array(list(self._cells), dtype=np.int64).reshape(-1, 2)
        cells = cells[np.abs(cells * CELL_M - here[0]).max(1) < FARTHEST_M]
        every = np.concatenate([np.floor(here / CELL_M).astype(np.int64), cells])
        margin = round(MARGIN_M / CELL_M)
        low, high = every.min(0) - margin, every.max(0) + margin + 1
        occupied = np.zeros(tuple(high - low), dtype=np.bool_)
        occupied[tuple((cells - low).T)] = True
        unknown = np.zeros_like(occupied)
        unknown[[0, -1]] = unknown[:, [0, -1]] = True
        return GroundMap(occupied, unknown, CELL_M, (float(low[0] * CELL_M), float(low[1] * CELL_M)))


def ended_beams(setup: Setup, pose: Pose, ranges: NDArray[np.floating[Any]]) -> Doubles:
    """(n, 2) where the beams of the setup's lidar ended that met something, from that pose. ranges (beams,) metres, in
    the order of `Lidar.bearings`."""
    lidar = setup.robot.lidar
    met = np.flatnonzero(ranges < lidar.range_m - 1e-3)
    bearings = np.array(lidar.bearings())[met] + lidar.yaw_rad
    in_robot = np.stack([np.cos(bearings), np.sin(bearings)], axis=1) * ranges[met, None] + [lidar.x_m, lidar.y_m]
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return np.asarray(in_robot @ np.array([[c, s], [-s, c]]) + [pose.x, pose.y])
