"""Frechet distances between paths, and the deviation-aware one of chapter 3.

Continuous distances between polylines come from the free-space diagram of Alt and Godau (1995). One walk through the
diagram answers, for a length e, which prefixes of the first path are within e of some prefix of the second; halving
intervals around all prefixes with the same walks finds every prefix's distance, without one search per prefix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from desirepath.simulation.kernels import compiled_exactly

Doubles = NDArray[np.float64]
PHI = 0.75 * math.pi  # ch. 3
EXACT_M = 1e-10


@compiled_exactly
def _free(px: float, py: float, ax: float, ay: float, bx: float, by: float, reach: float) -> tuple[float, float]:
    """The part [low, high] of segment a-b (0..1) within `reach` of point p; low > high where there is none."""
    dx, dy, ex, ey = bx - ax, by - ay, ax - px, ay - py
    a, b, c = dx * dx + dy * dy, dx * ex + dy * ey, ex * ex + ey * ey - reach * reach
    if a <= 0.0:
        return (0.0, 1.0) if c <= 0.0 else (2.0, -1.0)
    inside = b * b - a * c
    if inside < 0.0:
        return 2.0, -1.0
    root = math.sqrt(inside)
    low, high = max(0.0, (-b - root) / a), min(1.0, (-b + root) / a)
    return (low, high) if low <= high else (2.0, -1.0)


@compiled_exactly
def _find_reach(first: Doubles, second: Doubles, reach: float, bottom: Doubles, left: Doubles) -> tuple[int, bool]:
    """(last vertex of `first` whose prefix is within `reach` of a prefix of `second`, -1 if none; whether both whole
    paths are within it).

    bottom (m, 2), left (m, 2): scratch. bottom[j]: what is reachable of the edge where `second` stands at vertex j,
    along the present segment of `first`; left[j]: where `first` stands at the present vertex, along segment j.
    """
    n, m = first.shape[0], second.shape[0]
    dx, dy = first[0, 0] - second[0, 0], first[0, 1] - second[0, 1]
    if dx * dx + dy * dy > reach * reach:
        return -1, False
    open_so_far = True  # up the first column: only without a gap
    for j in range(m - 1):
        low, high = _free(
            first[0, 0], first[0, 1], second[j, 0], second[j, 1], second[j + 1, 0], second[j + 1, 1], reach
        )
        if open_so_far and low <= 0.0 and high >= 0.0:
            left[j, 0], left[j, 1] = 0.0, high
        else:
            left[j, 0], left[j, 1] = 2.0, -1.0
            open_so_far = False
        open_so_far = open_so_far and high >= 1.0
    whole_second = open_so_far  # the corner (vertex 0 of first, last vertex of second)
    corner_open = True  # along the bottom row: vertex 0 of `second` against ever more of `first`
    for i in range(n - 1):
        low, high = _free(second[0, 0], second[0, 1], first[i, 0], first[i, 1], first[i + 1, 0], first[i + 1, 1], reach)
        if corner_open and low <= 0.0 and high >= 0.0:
            bottom[0, 0], bottom[0, 1] = 0.0, high
            corner_open = high >= 1.0
        else:
            bottom[0, 0], bottom[0, 1] = 2.0, -1.0
            corner_open = False
        some = corner_open
        whole_second = False
        for j in range(m - 1):
            from_left = left[j, 0] <= left[j, 1]
            from_below = bottom[j, 0] <= bottom[j, 1]
            # right edge: `first` at vertex i + 1 along segment j
            low, high = _free(
                first[i + 1, 0], first[i + 1, 1], second[j, 0], second[j, 1], second[j + 1, 0], second[j + 1, 1], reach
            )
            top_low, top_high = _free(
                second[j + 1, 0], second[j + 1, 1], first[i, 0], first[i, 1], first[i + 1, 0], first[i + 1, 1], reach
            )
            if not from_below:
                low = max(low, left[j, 0]) if from_left else 2.0
            if not from_left:
                top_low = max(top_low, bottom[j, 0]) if from_below else 2.0
            if low <= high:
                left[j, 0], left[j, 1] = low, high
                some = True
                whole_second = j == m - 2 and high >= 1.0
            else:
                left[j, 0], left[j, 1] = 2.0, -1.0
                whole_second = False
            if top_low <= top_high:
                bottom[j + 1, 0], bottom[j + 1, 1] = top_low, top_high
                if j == m - 2 and top_high >= 1.0:
                    whole_second = True
            else:
                bottom[j + 1, 0], bottom[j + 1, 1] = 2.0, -1.0
        if not some and m > 1:
            return i, False
        if m == 1 and not corner_open:
            return i, False
        if m == 1:
            whole_second = True
    return n - 1, whole_second


@compiled_exactly
def _prefixes(first: Doubles, second: Doubles, exact: float, low: Doubles, high: Doubles) -> None:
    """Narrow low (n,) and high (n,) around every prefix's distance until they are `exact` metres apart."""
    m = second.shape[0]
    bottom, left = np.empty((m, 2)), np.empty((m, 2))
    while True:
        widest = int(np.argmax(high - low))
        if high[widest] - low[widest] <= exact:
            return
        reach = (low[widest] + high[widest]) / 2
        last, _ = _find_reach(first, second, reach, bottom, left)
        for i in range(low.shape[0]):
            if i <= last:
                high[i] = min(high[i], reach)
            else:
                low[i] = max(low[i], reach)


@compiled_exactly
def _whole(first: Doubles, second: Doubles, exact: float, low: float, high: float) -> float:
    m = second.shape[0]
    bottom, left = np.empty((m, 2)), np.empty((m, 2))
    while high - low > exact:
        reach = (low + high) / 2
        if _find_reach(first, second, reach, bottom, left)[1]:
            high = reach
        else:
            low = reach
    return high


def _path(points: ArrayLike, name: str) -> Doubles:
    """(n, 2) float64. Raises ValueError naming the path."""
    path = np.ascontiguousarray(np.asarray(points, dtype=np.float64)[..., :2])
    if path.ndim != 2 or not len(path) or path.shape[1] != 2 or not np.isfinite(path).all():
        raise ValueError(f"{name} has shape {path.shape}: must be (points, 2) finite numbers, at least one point")
    return path


def _bounds(a: Doubles, b: Doubles) -> tuple[float, float]:
    """Every Frechet distance of prefixes that begin at both starts lies between these."""
    together = np.concatenate([a, b])
    return float(np.linalg.norm(a[0] - b[0])), float(np.linalg.norm(together.max(0) - together.min(0)))


def frechet_distance(a: ArrayLike, b: ArrayLike, *, exact_m: float = EXACT_M) -> float:
    """The Frechet distance (m) between two paths (n, 2 or more) and (m, 2 or more), to `exact_m`. Raises ValueError for
    what is no path."""
    first, second = _path(a, "a"), _path(b, "b")
    low, high = _bounds(first, second)
    low = max(low, float(np.linalg.norm(first[-1] - second[-1])))
    return float(_whole(first, second, exact_m, low - exact_m, high + exact_m))


def prefix_distances(a: ArrayLike, b: ArrayLike, *, exact_m: float = EXACT_M) -> Doubles:
    """f(A, B, t) = inf over t' of F(A[0, t], B[0, t']) (ch. 3) at every point of A: (n,) metres, never falling.

    Arguments as of `frechet_distance`.
    """
    first, second = _path(a, "a"), _path(b, "b")
    low, high = _bounds(first, second)
    lows, highs = np.full(len(first), low - exact_m), np.full(len(first), high + exact_m)
    _prefixes(first, second, exact_m, lows, highs)
    return highs


@dataclass(frozen=True)
class Deviation:
    """Up to where a rollout's path follows a demonstrated one, and how closely (ch. 3). Read both numbers together.

    t_star: share of the rollout's length, 1 if it follows to its end. distance_m: f(A, B, t*).
    point: (x, y) of A at t*. backwards: both paths were compared from their ends. cost: C(t*), the higher the better.
    """

    t_star: float
    distance_m: float
    point: tuple[float, float]
    backwards: bool
    cost: float


def deviation(rollout: ArrayLike, demonstrated: ArrayLike, *, exact_m: float = 1e-4) -> Deviation:
    """The deviation point t* = argmax C(t), C(t) = cos(phi) f(A, B, t) + sin(phi) t, and f there.

    rollout (n, 2 or more), demonstrated (m, 2 or more): metres. t runs over A's points by their share of its length.
    Where the ends are closer than the starts both are reversed.
    """
    a, b = _path(rollout, "rollout"), _path(demonstrated, "demonstrated")
    backwards = bool(np.linalg.norm(a[-1] - b[-1]) < np.linalg.norm(a[0] - b[0]))
    if backwards:
        a, b = a[::-1].copy(), b[::-1].copy()
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(a, axis=0), axis=1))])
    share = lengths / lengths[-1] if lengths[-1] > 0 else np.ones(len(a))
    apart = prefix_distances(a, b, exact_m=exact_m)
    costs = math.cos(PHI) * apart + math.sin(PHI) * share
    best = len(costs) - 1 - int(np.argmax(costs[::-1]))  # of equal ones the latest
    return Deviation(
        float(share[best]), float(apart[best]), (float(a[best, 0]), float(a[best, 1])), backwards, float(costs[best])
    )
