"""Maps within recordings (ROS's OccupancyGrid, SocNav3's grid) as walls around where somebody went.

A recorded scene lies in no map of a setup, so what is occupied becomes boxes: few enough to be shown, if need be of
larger cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.recordings.recording import BOUNDS, Bounds, RecordingError, Thing
from desirepath.simulation.ground_maps import LARGEST_M, MOST_CELLS, GroundMap

AROUND_M = 6.0  # of where somebody went; what is farther away is not shown
OCCUPIED = 65  # of 100, as map_server has it
COARSEST_M = 0.5
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Grid:
    """occupied: (columns, lines), x to the right, y up. origin: its lower left corner, m, and its yaw, rad."""

    occupied: Bools
    cell_m: float
    origin: tuple[float, float, float]


def grid_of(
    file: str, where: str, cells: NDArray[np.int8], width: int, height: int, cell_m: float, origin: Sequence[float]
) -> Grid:
    """A grid row by row from its lower left corner, as ROS sends it: 0 free to 100 occupied, -1 unknown. Raises
    RecordingError for one that is none."""
    if not (0 < width * height <= MOST_CELLS and width > 0):
        raise RecordingError(file, f"{where}, size", [width, height], f"must be 1 to {MOST_CELLS} cells")
    if not (math.isfinite(cell_m) and 0.005 <= cell_m <= 1):
        raise RecordingError(file, f"{where}, resolution", cell_m, "must be 0.005 to 1 m a cell")
    if not all(map(math.isfinite, origin)):
        raise RecordingError(file, f"{where}, origin", list(origin), "must be finite numbers: x, y (m) and yaw")
    if max(width, height) * cell_m > LARGEST_M:
        raise RecordingError(
            file, f"{where}, size", max(width, height) * cell_m, f"m; at most {LARGEST_M:g} m are shown"
        )
    if len(cells) != width * height:
        raise RecordingError(file, f"{where}, data", len(cells), f"cells, {width} x {height} are {width * height}")
    x, y, yaw = map(float, origin)
    return Grid((cells.reshape(height, width) >= OCCUPIED).T, float(cell_m), (x, y, yaw))


def walls_of(grid: Grid, ways: NDArray[np.float64], how: list[str], bounds: Bounds = BOUNDS) -> tuple[Thing, ...]:
    """What is occupied within AROUND_M of ways (n, 2), as walls; cells are joined until there are few enough."""
    x0, y0, yaw = grid.origin
    c, s = math.cos(yaw), math.sin(yaw)
    away = ways - (x0, y0)
    there = np.stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]], axis=1) / grid.cell_m
    margin = AROUND_M / grid.cell_m
    low = np.clip(np.floor(there.min(axis=0) - margin), 0, grid.occupied.shape).astype(int)
    high = np.clip(np.ceil(there.max(axis=0) + margin), 0, grid.occupied.shape).astype(int)
    occupied, cell_m = grid.occupied[low[0] : high[0], low[1] : high[1]], grid.cell_m
    corner = low * grid.cell_m
    while True:
        known = np.zeros_like(occupied)
        boxes = GroundMap(occupied, known, cell_m, (float(corner[0]), float(corner[1]))).walls if occupied.any() else ()
        if len(boxes) <= bounds.things // 2 or cell_m >= COARSEST_M:
            break
        occupied, cell_m = _coarser(occupied), 2 * cell_m
    sentence = f"the map's occupied cells within {AROUND_M:g} m of where somebody went are walls of 2 m"
    how.append(sentence + (f", in cells of {cell_m:g} m" if cell_m > grid.cell_m else ""))
    found = []
    for left, lower, right, upper in list(boxes)[: bounds.things]:
        u, v = (left + right) / 2, (lower + upper) / 2
        place = x0 + c * u - s * v, y0 + s * u + c * v
        found.append(Thing("wall", *place, yaw, float(right - left), float(upper - lower), 2.0))
    return tuple(found)


def _coarser(occupied: Bools) -> Bools:
    """Cells of twice the side, occupied where any of the four is."""
    even = np.pad(occupied, [(0, size % 2) for size in occupied.shape])
    return np.asarray(even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).any(axis=(1, 3)))
