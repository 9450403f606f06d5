"""Shortest ways on a grid: of free cells (A*), of cells that cost (Dijkstra; smoothly: fast sweeping), compiled. What
makes the grid, and who walks the way, is elsewhere.

Compiled functions of one file only: see `kernels.py`.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled, compiled_exactly

Bools = NDArray[np.bool_]
Floats = NDArray[np.float32]

FAR, SWEPT = 1e9, 0.05  # cells: of what is not reached yet; when sweeping has changed so little, it ends


@compiled_exactly
def mark_free_cells(boxes: NDArray[np.float64], xs: NDArray[np.float64], ys: NDArray[np.float64], gap: float) -> Bools:
    """(len(xs), len(ys)) whether a disc of radius `gap` (m) around that place touches none of the boxes (n, 6)."""
    free = np.ones((len(xs), len(ys)), dtype=np.bool_)
    for b in range(len(boxes)):
        cos, sin = boxes[b, 4], boxes[b, 5]
        for i in range(len(xs)):
            dx = xs[i] - boxes[b, 0]
            for j in range(len(ys)):
                dy = ys[j] - boxes[b, 1]
                along = max(abs(dx * cos + dy * sin) - boxes[b, 2], 0.0)
                across = max(abs(dy * cos - dx * sin) - boxes[b, 3], 0.0)
                if along * along + across * across < gap * gap:
                    free[i, j] = False
    return free


@compiled_exactly
def _sees(free: Bools, i0: int, j0: int, i1: int, j1: int) -> bool:
    """Whether the straight line between two cells runs through free cells, looked at every fourth of a cell."""
    steps = int(4 * max(abs(i1 - i0), abs(j1 - j0)))
    for s in range(1, steps):
        i = math.floor(i0 + (i1 - i0) * s / steps + 0.5)
        j = math.floor(j0 + (j1 - j0) * s / steps + 0.5)
        if not free[int(i), int(j)]:
            return False
    return True


@compiled_exactly
def a_star(free: Bools, begin: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int64]:
    """The shortest way over eight neighbours, corners not cut: cells (n, 2), both ends included; (0, 2) for none."""
    lines = free.shape[1]
    if not (free[begin[0], begin[1]] and free[end[0], end[1]]):
        return np.zeros((0, 2), dtype=np.int64)
    cost = np.full(free.size, np.inf)
    came = np.full(free.size, -1, dtype=np.int64)
    first, last = begin[0] * lines + begin[1], end[0] * lines + end[1]
    cost[first] = 0.0
    heap = [(0.0, first)]
    while len(heap) > 0:
        _, here = heapq.heappop(heap)
        if here == last:
            break
        i, j = here // lines, here % lines
        for di in range(-1, 2):
            for dj in range(-1, 2):
                u, v = i + di, j + dj
                if (di == 0 and dj == 0) or u < 0 or v < 0 or u >= free.shape[0] or v >= lines or not free[u, v]:
                    continue
                if di != 0 and dj != 0 and not (free[i, v] and free[u, j]):
                    continue
                there = u * lines + v
                so_far = cost[here] + math.sqrt(float(di * di + dj * dj))
                if so_far < cost[there] - 1e-12:
                    cost[there], came[there] = so_far, here
                    ahead = math.sqrt(float((u - end[0]) ** 2 + (v - end[1]) ** 2))
                    heapq.heappush(heap, (so_far + ahead, there))
    if came[last] < 0:
        return np.zeros((0, 2), dtype=np.int64)
    count, here = 1, last
    while here != first:
        here = came[here]
        count += 1
    way = np.zeros((count, 2), dtype=np.int64)
    here = last
    for k in range(count):
        way[count - 1 - k, 0], way[count - 1 - k, 1] = here // lines, here % lines
        here = came[here]
    return way


@compiled_exactly
def straighten(free: Bools, way: NDArray[np.int64]) -> NDArray[np.int64]:
    """The corners of a way (n, 2) that remain where straight lines between free cells replace its zigzag."""
    kept = np.zeros_like(way)
    kept[0] = way[0]
    count, at = 1, 0
    while at < len(way) - 1:
        ahead = len(way) - 1
        while ahead > at + 1 and not _sees(free, way[at, 0], way[at, 1], way[ahead, 0], way[ahead, 1]):
            ahead -= 1
        kept[count] = way[ahead]
        count, at = count + 1, ahead
    return kept[:count]


@compiled_exactly
def distances(costs: NDArray[np.float32], end: tuple[int, int], longest: float) -> NDArray[np.float32]:
    """(columns, lines) what the cheapest way from each cell to that one costs, in cells, over eight neighbours;
    infinite beyond `longest`, and where none leads. costs: of a cell that is driven through; infinite of a blocked one.
    """
    lines = costs.shape[1]
    found = np.full(costs.shape, np.inf, dtype=np.float32)
    found[end[0], end[1]] = 0.0
    heap = [(0.0, end[0] * lines + end[1])]
    while len(heap) > 0:
        so_far, here = heapq.heappop(heap)
        i, j = here // lines, here % lines
        if so_far > found[i, j] + 1e-4:
            continue
        for di in range(-1, 2):
            for dj in range(-1, 2):
                u, v = i + di, j + dj
                if (di == 0 and dj == 0) or u < 0 or v < 0 or u >= costs.shape[0] or v >= lines:
                    continue
                if not np.isfinite(costs[u, v]):
                    continue
                if di != 0 and dj != 0 and not (np.isfinite(costs[i, v]) and np.isfinite(costs[u, j])):
                    continue
                there = so_far + math.sqrt(float(di * di + dj * dj)) * costs[u, v]
                if there <= longest and there < found[u, v] - 1e-4:
                    found[u, v] = there
                    heapq.heappush(heap, (there, u * lines + v))
    return found


@compiled_exactly
def descend(field: NDArray[np.float32], i: int, j: int, most: int) -> NDArray[np.int64]:
    """The cells (n, 2) from that one on down a field of `distances`, at most so many of them."""
    way = np.zeros((most, 2), dtype=np.int64)
    count = 0
    while count < most:
        way[count, 0], way[count, 1] = i, j
        count += 1
        best, u, v = field[i, j], i, j
        for a in range(max(i - 1, 0), min(i + 2, field.shape[0])):
            for b in range(max(j - 1, 0), min(j + 2, field.shape[1])):
                if field[a, b] < best:
                    best, u, v = field[a, b], a, b
        if u == i and v == j:
            break
        i, j = u, v
    return way[:count]


@compiled
def arrival_times(costs: Floats, end_i: float, end_j: float, times: Floats) -> None:
    """Write into `times` (columns, lines) what the cheapest ways to that place cost, in any direction: the eikonal
    equation by fast sweeping (Zhao 2005). Places in cells, whose middles lie at .5."""
    columns, lines = costs.shape
    times[:, :] = FAR
    for i in range(max(int(end_i) - 2, 0), min(int(end_i) + 3, columns)):
        for j in range(max(int(end_j) - 2, 0), min(int(end_j) + 3, lines)):
            times[i, j] = math.sqrt((i + 0.5 - end_i) ** 2 + (j + 0.5 - end_j) ** 2)
    change = FAR
    while change > SWEPT:
        change = 0.0
        for corner in range(4):
            for a in range(columns):
                i = a if corner < 2 else columns - 1 - a
                for b in range(lines):
                    j = b if corner % 2 == 0 else lines - 1 - b
                    across = min(times[max(i - 1, 0), j], times[min(i + 1, columns - 1), j])
                    up = min(times[i, max(j - 1, 0)], times[i, min(j + 1, lines - 1)])
                    cost, apart = costs[i, j], abs(across - up)
                    found = min(across, up) + cost
                    if apart < cost:
                        found = (across + up + math.sqrt(2 * cost * cost - apart * apart)) / 2
                    if found < times[i, j]:
                        change = max(change, times[i, j] - found)
                        times[i, j] = found


@compiled
def look_ahead(
    times: Floats,
    sizes: NDArray[np.int64],
    at: NDArray[np.float64],
    ends: NDArray[np.float64],
    steps: int,
    ahead: NDArray[np.float64],
) -> None:
    """Write into `ahead` (n, 2) where one comes from each place `at` (n, 2), going so many steps of a cell down the
    `arrival_times` of each (n, columns, lines; of them `sizes` (n, 2) are used) to its end (n, 2). All in cells."""
    for e in range(len(at)):
        x, y = at[e, 0], at[e, 1]
        for _ in range(steps):
            if (ends[e, 0] - x) ** 2 + (ends[e, 1] - y) ** 2 < 1.0:
                x, y = ends[e, 0], ends[e, 1]
                break
            u, v = min(max(x - 0.5, 0.0), sizes[e, 0] - 1.001), min(max(y - 0.5, 0.0), sizes[e, 1] - 1.001)
            i, j = int(u), int(v)
            a, b = u - i, v - j
            low, right, over, far = times[e, i, j], times[e, i + 1, j], times[e, i, j + 1], times[e, i + 1, j + 1]
            slope_x = (1 - b) * (right - low) + b * (far - over)
            slope_y = (1 - a) * (over - low) + a * (far - right)
            steep = math.sqrt(slope_x * slope_x + slope_y * slope_y)
            if steep < 1e-6:
                break
            x, y = x - slope_x / steep, y - slope_y / steep
        ahead[e, 0], ahead[e, 1] = x, y
