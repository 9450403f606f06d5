"""What a robot knows of a place that it has no map of: where its lidar's beams ended, from wherever it has been.

What no beam has crossed counts as free. People are told of apart, so that beams that end at them mark nothing; what
moves and nobody tells of leaves walls behind.
"""

from __future__ import annotations

import copy
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
ENCLOSED = 0.5  # share of beams that end where there are walls around; else it is open, and cells are twice as large
MARGIN_M = 1.0  # around what is known, where there are walls around
AT_PEOPLE_M = 0.1  # beyond a person's outline a beam still ended at them
FARTHEST_M = 20.0  # from where the robot is: what lies beyond is not looked at
LARGEST_M = 10_000.0  # places beyond it are a mistake
LARGEST_CELLS = 2**21


@dataclass(frozen=True)
class SeenScene(Scene):
    """A scene as a robot that drives there knows it. seen: of its surroundings; its obstacles are in there."""

    seen: GroundMap | None = None

    def as_dict(self) -> Never:
        raise SceneError("seen", "a robot's own map", "is what a robot believes in one moment: it is not stored")


class KnownWorld:
    """Grows scan by scan."""

    def __init__(self) -> None:
        self._cells = np.zeros((0, 2), dtype=np.int64)
        self._open = False

    def see(self, ended: Doubles, beams: int, people: Sequence[tuple[float, float]], person_m: float) -> None:
        """ended (n, 2): where some of so many beams ended, metres; people: where they stand, within that radius."""
        self._open = len(ended) < ENCLOSED * beams
        for x, y in people:
            ended = ended[np.hypot(ended[:, 0] - x, ended[:, 1] - y) > person_m + AT_PEOPLE_M]
        new = np.floor(ended[np.abs(ended).max(1, initial=0) < LARGEST_M] / CELL_M).astype(np.int64)
        keys = np.concatenate([self._cells, new]) @ [LARGEST_CELLS, 1]
        self._cells = np.stack(np.divmod(np.unique(keys) + LARGEST_CELLS // 2, LARGEST_CELLS), axis=1)
        self._cells[:, 1] -= LARGEST_CELLS // 2

    def copy(self) -> KnownWorld:
        """As it is now; this one goes on growing."""
        return copy.copy(self)  # `see` makes its cells anew

    def map_around(self, places: Sequence[Pose], range_m: float) -> GroundMap:
        """What was seen around the first of the places, where the robot is, with room for the others that are near.
        range_m: of its lidar, which in the open sees no edge of what is known."""
        here = np.array([(place.x, place.y) for place in places])
        here = here[np.abs(here - here[0]).max(1) <= FARTHEST_M]
        stride, margin_m = (2, range_m + CELL_M) if self._open else (1, MARGIN_M)
        cell_m = stride * CELL_M
        cells = self._cells[np.abs(self._cells * CELL_M - here[0]).max(1, initial=0) < FARTHEST_M] // stride
        every = np.concatenate([np.floor(here / cell_m).astype(np.int64), cells])
        margin = math.ceil(margin_m / cell_m)
        low, high = every.min(0) - margin, every.max(0) + margin + 1
        occupied = np.zeros(tuple(high - low), dtype=np.bool_)
        occupied[tuple((cells - low).T)] = True
        unknown = np.zeros_like(occupied)
        unknown[[0, -1]] = unknown[:, [0, -1]] = True
        return GroundMap(occupied, unknown, cell_m, (float(low[0] * cell_m), float(low[1] * cell_m)))


def ended_beams(setup: Setup, pose: Pose, ranges: NDArray[np.floating[Any]]) -> Doubles:
    """(n, 2) where the beams of the setup's lidar ended that met something, from that pose. ranges (beams,) metres, in
    the order of `Lidar.bearings`."""
    lidar = setup.robot.lidar
    met = np.flatnonzero(ranges < lidar.range_m - 1e-3)
    bearings = np.array(lidar.bearings())[met] + lidar.yaw_rad
    in_robot = np.stack([np.cos(bearings), np.sin(bearings)], axis=1) * ranges[met, None] + [lidar.x_m, lidar.y_m]
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return np.asarray(in_robot @ np.array([[c, s], [-s, c]]) + [pose.x, pose.y])
