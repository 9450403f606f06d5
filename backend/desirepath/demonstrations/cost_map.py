"""Cost maps of a room and cheapest paths through them, for the social-cost controller and programmed demonstrators.

What makes a place costly is theirs (`social_cost.py`, `demonstrators.py`); here live the grid and Dijkstra's search.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from desirepath.simulation import kernels as k
from desirepath.simulation.scene import Pose, Scene, SceneError
from desirepath.simulation.scenes import extent_m, ground_of, scene_to_row
from desirepath.simulation.setups import get_setup

Doubles = NDArray[np.float64]
CELL_M = 0.05
AROUND_M = 10.0  # ours: ways that lead farther away are none that people draw
SMOOTHED_OVER_M = 0.3  # standard deviation along a path: nobody draws or walks in a grid's directions
EVERY_M = 0.02  # spacing of smoothed paths
# Sixteen directions: eight to the neighbours, eight knight's moves between them.
STEPS = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if math.gcd(i, j) == 1])
Price = Callable[[Doubles], Doubles]
"""Places (n, 2) m -> (n,) cost per metre driven there, at least 1."""


@dataclass(frozen=True)
class Grid:
    """Places a robot's centre may be: origin (x, y) of cell (0, 0), free (columns, lines)."""

    origin: tuple[float, float]
    free: NDArray[np.bool_]

    def places(self) -> Doubles:
        """(columns, lines, 2) metres."""
        columns, lines = self.free.shape
        x = self.origin[0] + CELL_M * np.arange(columns)
        y = self.origin[1] + CELL_M * np.arange(lines)
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=2)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """The free cell nearest to a place."""
        away = np.linalg.norm(self.places() - np.array([x, y]), axis=2)
        away[~self.free] = np.inf
        i, j = np.unravel_index(int(np.argmin(away)), away.shape)
        return int(i), int(j)


def free_grid(scene: Scene, *, spare_m: float, around_person: bool = True) -> Grid:
    """Where the robot fits with `spare_m` to spare; `around_person` False: as if nobody stood there. Of a building no
    more than AROUND_M from start, goal and person.

    Raises SceneError for a scene without walls around it.
    """
    extent = extent_m(scene)
    if extent is None:
        raise SceneError("room", None, "a cost map needs walls around it")
    low, high = extent
    if scene.room is None:
        places = [(place.x, place.y) for place in (scene.start, scene.goal, scene.person.pose)]
        low = np.maximum(low, np.floor(np.min(places, axis=0) - AROUND_M))
        high = np.minimum(high, np.ceil(np.max(places, axis=0) + AROUND_M))
    columns, lines = (round(side / CELL_M) for side in (high - low).tolist())
    grid = Grid((float(low[0] + CELL_M / 2), float(low[1] + CELL_M / 2)), np.zeros((columns, lines), dtype=np.bool_))
    row = scene_to_row(scene)
    if not around_person:
        row[k.PERSON_X] = math.inf
    radius_m = get_setup(scene.setup).robot.radius_m + spare_m
    k.mark_free(row, grid.places(), radius_m, grid.free, ground_of(scene))
    return grid


def cost_to_go(grid: Grid, price: Price, goal: Pose) -> Doubles:
    """(columns, lines) cost of the cheapest way to the goal, infinite where there is none (Dijkstra 1959)."""
    prices = price(grid.places().reshape(-1, 2)).reshape(grid.free.shape)
    prices = np.where(grid.free, prices, np.inf)
    i, j = grid.cell(goal.x, goal.y)
    return np.asarray(_search(prices, i, j, STEPS))


@k.compiled
def _search(prices: NDArray[np.float64], goal_i: int, goal_j: int, steps: NDArray[np.int64]) -> NDArray[np.float64]:
    columns, lines = prices.shape
    cheapest = np.full((columns, lines), np.inf)
    cheapest[goal_i, goal_j] = 0.0
    waiting = [(0.0, goal_i, goal_j)]
    while len(waiting) > 0:
        cost, i, j = heapq.heappop(waiting)
        if cost > cheapest[i, j]:
            continue
        for s in range(steps.shape[0]):
            u, w = i + steps[s, 0], j + steps[s, 1]
            if 0 <= u < columns and 0 <= w < lines:
                length = CELL_M * math.sqrt(steps[s, 0] ** 2 + steps[s, 1] ** 2)
                total = cost + length * (prices[i, j] + prices[u, w]) / 2
                if total < cheapest[u, w]:
                    cheapest[u, w] = total
                    heapq.heappush(waiting, (total, u, w))
    return cheapest


def cheapest_path(grid: Grid, costs: Doubles, start: Pose, *, longest_m: float = math.inf) -> Doubles:
    """(n, 2) metres from near the start down to the goal, or `longest_m` of the way; cell by cell."""
    i, j = grid.cell(start.x, start.y)
    path = [(i, j)]
    gone = 0.0
    columns, lines = costs.shape
    while costs[i, j] > 0 and gone < longest_m:
        steepest, following = 0.0, (i, j)
        for di, dj in STEPS.tolist():
            u, w = i + di, j + dj
            if 0 <= u < columns and 0 <= w < lines and costs[u, w] < costs[i, j]:
                fall = (costs[i, j] - costs[u, w]) / math.hypot(di, dj)
                if fall > steepest:
                    steepest, following = fall, (u, w)
        if following == (i, j):
            break
        gone += CELL_M * math.dist((i, j), following)
        i, j = following
        path.append(following)
    return np.array(grid.origin) + CELL_M * np.array(path, dtype=float)


def smooth(path: Doubles) -> Doubles:
    """(m, 2) points EVERY_M apart along a path (n, 2) without its corners; both ends stay where they are."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    places = np.linspace(0.0, along[-1], max(10, round(along[-1] / EVERY_M)))
    even = np.stack([np.interp(places, along, path[:, axis]) for axis in range(2)], axis=1)
    n = len(even)
    mirrored = np.concatenate([2 * even[0] - even[:0:-1], even, 2 * even[-1] - even[-2::-1]])
    return np.asarray(gaussian_filter1d(mirrored, SMOOTHED_OVER_M / EVERY_M, axis=0)[n - 1 : 2 * n - 1])
