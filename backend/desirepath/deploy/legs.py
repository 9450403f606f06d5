"""People by their legs in one scan: a simple detector, for a robot that nobody tells of people.

A leg is a narrow, rounded thing with free space behind it on both sides; two of them a step apart are somebody. It
sees nobody in skirts or behind things, and takes two slim posts so far apart for a person: it keeps a robot polite, not
safe.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.inputs import Odometry, Person, Scan, place_laser

Doubles = NDArray[np.float64]
FARTHEST_M = 4.0  # beyond, a leg has too few beams (ours, as all of these)
LEG_M = (0.05, 0.22)  # how wide
LEAST_BEAMS = 3
APART_M = (0.10, 0.60)  # between the middles of two legs
TOGETHER_M = 0.08  # neighbouring hits of one thing
BEHIND_M = 0.25  # what is seen beside a leg is so much farther away


def find_people(
    scan: Scan, odometry: Odometry, laser: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[Person, ...]:
    """Who stands there, in the odometry's frame, the nearest first. laser: x, y (m), yaw (rad) of the lidar in base."""
    legs = _legs(scan)
    pairs = []
    for i, a in enumerate(legs):
        for j in range(i + 1, len(legs)):
            apart = float(np.hypot(*(a - legs[j])))
            if APART_M[0] <= apart <= APART_M[1]:
                pairs.append((apart, i, j))
    taken: set[int] = set()
    people = []
    for _, i, j in sorted(pairs):  # the closest two belong together
        if not taken & {i, j}:
            taken |= {i, j}
            people.append((legs[i] + legs[j]) / 2)
    people.sort(key=lambda place: float(np.hypot(*place)))
    return tuple(_in_odometry(place, odometry, laser) for place in people)


def _legs(scan: Scan) -> list[Doubles]:
    """The middle of each, m in the laser's frame."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    seen = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    far = np.where(seen, ranges, np.where(np.isnan(ranges), np.nan, scan.range_max))
    whole = abs(scan.angle_increment) * len(ranges) > 2 * math.pi - 2 * abs(scan.angle_increment)
    # begun in the middle of nothing or of something far, so that no leg lies across the seam of a full turn
    begin = int(np.nanargmax(far)) if whole and not np.isnan(far).all() else 0
    order = np.roll(np.arange(len(ranges)), -begin)
    angles = scan.angles[order]
    far = far[order]
    points = np.stack([far * np.cos(angles), far * np.sin(angles)], axis=1)
    hit = seen[order] & (far <= FARTHEST_M)
    steps = np.hypot(*np.diff(points, axis=0).T)
    joined = hit[:-1] & hit[1:] & (steps < TOGETHER_M)
    found, k = [], 0
    while k < len(hit):
        if not hit[k]:
            k += 1
            continue
        end = k
        while end < len(joined) and joined[end]:
            end += 1
        if end - k + 1 >= LEAST_BEAMS and _is_leg(points[k : end + 1], far, k, end):
            found.append(points[k : end + 1].mean(axis=0))
        k = end + 1
    return found


def _is_leg(points: Doubles, far: Doubles, first: int, last: int) -> bool:
    width = float(np.hypot(*(points[-1] - points[0])))
    if not LEG_M[0] <= width <= LEG_M[1] or first == 0 or last == len(far) - 1:
        return False
    beside = (far[first - 1] - far[first], far[last + 1] - far[last])
    if not min(beside) >= BEHIND_M:  # NaN, too: nobody knows what is there
        return False
    reach = np.hypot(*points.T)
    middle = float(reach[len(reach) // 3 : -(len(reach) // 3) or None].min())
    return middle < float(min(reach[0], reach[-1])) + 1e-9  # its middle is nearest: it is round


def _in_odometry(place: Doubles, odometry: Odometry, laser: tuple[float, float, float]) -> Person:
    x, y, yaw = place_laser((odometry.x, odometry.y, odometry.yaw), laser)
    c, s = math.cos(yaw), math.sin(yaw)
    return Person(float(x + c * place[0] - s * place[1]), float(y + s * place[0] + c * place[1]))
