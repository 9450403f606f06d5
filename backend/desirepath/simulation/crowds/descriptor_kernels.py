"""Temporal accumulation group descriptors (TAGD, algorithm 4.1), compiled, for a whole batch in one call.

ICP (Besl and McKay 1992, point to point, closed form in the plane) aligns the older of two scans to the newer; groups
around the nearest point of 30 rays; their centroids in both. Compiled functions of one file only: see `kernels.py`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled

Doubles = NDArray[np.float64]

GROUP_M = 0.25  # d_thresh
ICP_ROUNDS = 30
STILL_M, STILL_RAD = 1e-4, 1e-4  # ICP ends when a round moves less
TURN_STEPS = 18  # ours: how far (in sectors) the first guess of the turn looks to either side; +-36 degrees at 180
PAIR_M = 0.5  # ours: farther apart than this at first, two points are no pair; halved with every round
CLOSEST_PAIR_M = 0.12
FAR_M = 1e6  # where what is out of range is put: nobody's pair
WINDOW = 20  # ours: pairs are looked for at most so many sectors to either side of where a point now lies


@compiled
def _around(values: Doubles, more: int) -> Doubles:
    """(n + 2 more,): values (n,) all around, with the last `more` before the first and the first after the last."""
    n = len(values)
    found = np.empty(n + 2 * more)
    for k in range(n + 2 * more):
        found[k] = values[(k - more) % n]
    return found


@compiled
def _turn_between(older: Doubles, newer: Doubles, out_of_range: float) -> int:
    """By how many sectors the older ranges (m) are best shifted to give the newer: the first guess of ICP (ours)."""
    sectors = older.shape[0]
    best, shift = math.inf, 0
    around = _around(newer, TURN_STEPS)
    for guess in range(-TURN_STEPS, TURN_STEPS + 1):
        total, count = 0.0, 0
        for s in range(sectors):
            a, b = older[s], around[s + guess + TURN_STEPS]
            if a < out_of_range and b < out_of_range:
                total += min(abs(a - b), PAIR_M)
                count += 1
            elif a < out_of_range or b < out_of_range:
                total += PAIR_M / 2
                count += 1
        mean = total / max(count, 1)
        if mean < best - 1e-9:
            best, shift = mean, guess
    return shift


@compiled
def align_scan(
    older: Doubles, newer: Doubles, older_ranges: Doubles, newer_ranges: Doubles, range_m: float, out: Doubles
) -> tuple[float, float, float]:
    """Write the older points (n, 2) aligned to the newer into `out`; returns the turn (rad) and shift (m) used.

    Points out of range are moved along and are nobody's pair. Pairs are pruned by distance, more with every round, so
    that what moved by itself does not pull.
    """
    n = older.shape[0]
    limit = range_m * (1 - 1e-6)
    turn = 2 * math.pi / n * _turn_between(older_ranges, newer_ranges, limit)
    shift_x = shift_y = 0.0
    cos, sin = math.cos(turn), math.sin(turn)
    for k in range(n):
        out[k, 0] = cos * older[k, 0] - sin * older[k, 1]
        out[k, 1] = sin * older[k, 0] + cos * older[k, 1]
    allowed = PAIR_M
    # All around, so that no index is taken modulo in the innermost loop; what is out of range is far from everything.
    more = n // 2 + WINDOW + 2
    around_x, around_y = _around(newer[:, 0], more), _around(newer[:, 1], more)
    around_x[_around(newer_ranges, more) >= limit] = FAR_M
    for _ in range(ICP_ROUNDS):
        count = 0
        px = py = qx = qy = 0.0
        sxx = sxy = 0.0
        for k in range(n):
            if older_ranges[k] >= limit:
                continue
            x, y = out[k, 0], out[k, 1]
            nearest, which = allowed * allowed, -1
            here = math.floor(math.atan2(y, x) / (2 * math.pi) * n) + more
            # What is within `allowed` is seen within asin(allowed / distance) <= pi / 2 * allowed / distance, which is
            # n / 4 * allowed / distance sectors; two more, as both ends are rounded down.
            wide = min(WINDOW, 2 + int(n / 4 * allowed / max(math.sqrt(x * x + y * y), allowed)))
            for ahead in range(here - wide, here + wide + 1):
                dx, dy = around_x[ahead] - x, around_y[ahead] - y
                away = dx * dx + dy * dy
                if away < nearest:
                    nearest, which = away, ahead
            if which < 0:
                continue
            # The pair is the nearest place on the newer scan's outline, not the nearest of its points: points of two
            # scans of one wall never coincide (ours; Besl and McKay allow any shape).
            bx, by = around_x[which], around_y[which]
            fx, fy = bx, by
            best = nearest
            for other in (which - 1, which + 1):
                ex, ey = around_x[other] - bx, around_y[other] - by
                length = ex * ex + ey * ey
                if length < 1e-12 or length > PAIR_M * PAIR_M:
                    continue
                along = min(max(((x - bx) * ex + (y - by) * ey) / length, 0.0), 1.0)
                gx, gy = bx + along * ex, by + along * ey
                away = (gx - x) * (gx - x) + (gy - y) * (gy - y)
                if away < best:
                    best, fx, fy = away, gx, gy
            count += 1
            px, py, qx, qy = px + x, py + y, qx + fx, qy + fy
            sxx += x * fx + y * fy
            sxy += x * fy - y * fx
        if count < 6:
            break
        px, py, qx, qy = px / count, py / count, qx / count, qy / count
        sxx -= count * (px * qx + py * qy)
        sxy -= count * (px * qy - py * qx)
        angle = math.atan2(sxy, sxx)
        cos, sin = math.cos(angle), math.sin(angle)
        tx, ty = qx - (cos * px - sin * py), qy - (sin * px + cos * py)
        for k in range(n):
            x, y = out[k, 0], out[k, 1]
            out[k, 0], out[k, 1] = cos * x - sin * y + tx, sin * x + cos * y + ty
        turn += angle
        shift_x, shift_y = cos * shift_x - sin * shift_y + tx, sin * shift_x + cos * shift_y + ty
        if allowed <= CLOSEST_PAIR_M and math.sqrt(tx * tx + ty * ty) < STILL_M and abs(angle) < STILL_RAD:
            break
        allowed = max(allowed / 2 if allowed > 2 * CLOSEST_PAIR_M else CLOSEST_PAIR_M, CLOSEST_PAIR_M)
    return turn, shift_x, shift_y


@compiled
def _centroid(
    points: Doubles, ranges: Doubles, limit: float, cx: float, cy: float, outline: bool
) -> tuple[bool, float, float]:
    """The centroid of what lies within GROUP_M of a centre: (whether anything does, x, y) m.

    Of the points, as published; or of the outline that joins neighbouring points (ours): where a wall was hit by
    beams then matters no longer, only where the wall is.
    """
    n = points.shape[0]
    x = y = total = 0.0
    if outline:
        for k in range(n):
            m = k + 1 if k + 1 < n else 0
            if ranges[k] >= limit or ranges[m] >= limit:
                continue
            ax, ay = points[k, 0] - cx, points[k, 1] - cy
            ux, uy = points[m, 0] - points[k, 0], points[m, 1] - points[k, 1]
            squared = ux * ux + uy * uy
            if squared > GROUP_M * GROUP_M or squared < 1e-12:
                continue
            middle = -(ax * ux + ay * uy) / squared
            inside = middle * middle - (ax * ax + ay * ay - GROUP_M * GROUP_M) / squared
            if inside <= 0.0:
                continue
            root = math.sqrt(inside)
            begin, end = max(middle - root, 0.0), min(middle + root, 1.0)
            if end <= begin:
                continue
            length = (end - begin) * math.sqrt(squared)
            half = (begin + end) / 2
            x += length * (points[k, 0] + half * ux)
            y += length * (points[k, 1] + half * uy)
            total += length
    if total == 0.0:
        for k in range(n):
            dx, dy = points[k, 0] - cx, points[k, 1] - cy
            if ranges[k] < limit and dx * dx + dy * dy <= GROUP_M * GROUP_M:
                x += points[k, 0]
                y += points[k, 1]
                total += 1.0
    if total == 0.0:
        return False, cx, cy
    return True, x / total, y / total


@compiled
def describe_groups(
    older: Doubles,
    newer: Doubles,
    older_ranges: Doubles,
    newer_ranges: Doubles,
    range_m: float,
    outline: bool,
    out: Doubles,
) -> None:
    """Write the centroids of each group in both scans into `out` (groups, 4): older x, y, newer x, y (m).

    Where nothing of one scan lies in a group, its centroid there is the other's (ours: nothing seen has not moved);
    where nothing of either does, the group's centre.
    """
    groups, n = out.shape[0], newer.shape[0]
    limit = range_m * (1 - 1e-6)
    centres = np.full(groups, range_m)
    for k in range(n):
        # the one ray within pi / groups of the point; two, where it lies right between them
        turns = math.atan2(newer[k, 1], newer[k, 0]) / (2 * math.pi) * groups + 0.5
        for ray in range(math.floor(turns - 1e-6), math.floor(turns + 1e-6) + 1):
            centres[ray % groups] = min(centres[ray % groups], newer_ranges[k])
    for g in range(groups):
        reference = 2 * math.pi * g / groups
        cx, cy = centres[g] * math.cos(reference), centres[g] * math.sin(reference)
        before, out[g, 0], out[g, 1] = _centroid(older, older_ranges, limit, cx, cy, outline)
        now, out[g, 2], out[g, 3] = _centroid(newer, newer_ranges, limit, cx, cy, outline)
        if before and not now:
            out[g, 2], out[g, 3] = out[g, 0], out[g, 1]
        elif now and not before:
            out[g, 0], out[g, 1] = out[g, 2], out[g, 3]


@compiled
def describe_all(
    older: Doubles,
    newer: Doubles,
    older_ranges: Doubles,
    newer_ranges: Doubles,
    range_m: float,
    aligned: bool,
    outline: bool,
    out: Doubles,
) -> None:
    """Descriptors of n pairs of scans: points (n, sectors, 2) and ranges (n, sectors) m, out (n, groups, 4) m.

    aligned: whether ICP moves the older scan first; else it stays in the older frame (the ablation). outline: as in
    `_centroid`.
    """
    moved = np.empty((older.shape[1], 2))
    for i in range(older.shape[0]):
        if aligned:
            align_scan(older[i], newer[i], older_ranges[i], newer_ranges[i], range_m, moved)
        else:
            moved[:] = older[i]
        describe_groups(moved, newer[i], older_ranges[i], newer_ranges[i], range_m, outline, out[i])
