"""The grid of free places in a building, ways on it by A*, and the path that a robot is guided by.

Buildings live in `crowd_buildings.py`, who walks in them in `crowd_scenes.py`; the search in `planning_kernels.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.crowds import planning_kernels as plan
from desirepath.simulation.pedestrians import MOST_KNOTS
from desirepath.simulation.scene import Room, Scene, SceneError
from desirepath.simulation.setups import get_setup

Doubles = NDArray[np.float64]
CELL_M = 0.1
CLEARANCE_M = 0.32  # of routes from walls: half a pedestrian's diagonal


@dataclass(frozen=True)
class FreePlaces:
    """Free places of an empty building, on a grid. xs, ys: coordinates (m) of columns and lines."""

    free: NDArray[np.bool_]
    xs: Doubles
    ys: Doubles

    def cell(self, x: float, y: float) -> tuple[int, int]:
        return round((x - self.xs[0]) / CELL_M), round((y - self.ys[0]) / CELL_M)

    def places(self) -> Doubles:
        """(n, 2) all free places, m."""
        i, j = np.nonzero(self.free)
        return np.stack([self.xs[i], self.ys[j]], axis=1)

    def way(self, begin: Sequence[float] | Doubles, end: Sequence[float] | Doubles) -> tuple[tuple[float, float], ...]:
        """The way between two places as a polyline; empty where there is none, or none with few enough corners."""
        cells = plan.a_star(self.free, self.cell(begin[0], begin[1]), self.cell(end[0], end[1]))
        if len(cells) < 2:
            return ()
        corners = plan.straighten(self.free, cells)
        if len(corners) > MOST_KNOTS:
            return ()
        return tuple((tidy(self.xs[i]), tidy(self.ys[j])) for i, j in corners)


def tidy(value: float) -> float:
    return round(float(value), 6)


def boxes_of(scene: Scene) -> Doubles:
    """Walls and obstacles of a scene: (n, 6) x, y, half length, half width (m), cosine and sine of the yaw."""
    return np.array(
        [
            (o.pose.x, o.pose.y, o.length / 2, o.width / 2, math.cos(o.pose.yaw), math.sin(o.pose.yaw))
            for o in scene.solids()
        ],
        dtype=np.float64,
    ).reshape(-1, 6)


def _line(side_m: float) -> Doubles:
    half = math.floor(side_m / 2 / CELL_M)
    return np.arange(-half, half + 1, dtype=np.float64) * CELL_M


def map_of(room: Room, boxes: Doubles, clearance_m: float = CLEARANCE_M) -> FreePlaces:
    """The grid of places in a room that keep clear of all boxes (n, 6)."""
    xs, ys = (_line(side) for side in (room.length, room.width))
    return FreePlaces(plan.mark_free_cells(boxes, xs, ys, clearance_m), xs, ys)


@lru_cache(maxsize=4_096)
def robot_path(scene: Scene) -> tuple[tuple[float, float], ...]:
    """A* on the empty map from the robot's start to its goal, which is its last place. Raises SceneError for none."""
    if scene.room is None:
        raise SceneError("room", None, "a robot's path needs a room with walls")
    inside = map_of(scene.room, boxes_of(scene), max(CLEARANCE_M, get_setup(scene.setup).robot.radius_m))
    way = inside.way((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y))
    if not way:
        raise SceneError("goal", scene.goal, "has no way from the start on the empty map")
    return ((scene.start.x, scene.start.y), *way[1:-1], (scene.goal.x, scene.goal.y))


def path_from_anywhere(scene: Scene) -> tuple[tuple[float, float], ...]:
    """`robot_path`, also of a robot that begins nearer to a wall than paths come: from the nearest free place on.
    Raises SceneError for none."""
    try:
        return robot_path(scene)
    except SceneError:
        if scene.room is None:
            raise
        free, start = map_of(scene.room, boxes_of(scene)).places(), (scene.start.x, scene.start.y)
        x, y = free[np.linalg.norm(free - start, axis=1).argmin()]
        return (start, *robot_path(replace(scene, start=replace(scene.start, x=float(x), y=float(y))))[1:])
