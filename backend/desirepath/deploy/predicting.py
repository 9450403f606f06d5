"""Where a robot would go: its policy driven on, among what its last scan hit.

What it has not seen is not there, and people go on as they walk: what the robot intends, for whoever watches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import FULL_TURN, InputError, Odometry, Person, Scan, place_laser

Doubles = NDArray[np.float64]
AHEAD_S = 4.0  # ours, as all of these
JOINED_M = 0.4  # neighbouring hits so near to each other are of one thing
BETWEEN = 3  # places between two of them
MOST_STEPS = 20
MOST_HITS = 240  # of the scan, evenly; a prediction takes some milliseconds of the node's time


def predict_way(
    controller: Controller, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Sequence[Person] = ()
) -> list[tuple[float, float]]:
    """x, y (m, the odometry's frame) after each of its next steps, until it is at its goal or `AHEAD_S` are over. The
    controller stays as it is."""
    driver, things = controller.copy(), _places_hit(scan, odometry, controller.laser)
    way, now = [], odometry
    for _ in range(min(MOST_STEPS, round(AHEAD_S / driver.period_s))):
        try:
            command = driver.step(_scan_from(things, scan, now, driver.laser), now, goal, people)
        except InputError:
            break
        if driver.arrived:
            break
        now = _moved(now, command.v, command.w, driver.period_s)
        people = [_walked(person, driver.period_s) for person in people]
        way.append((now.x, now.y))
    return way


def _moved(at: Odometry, v: float, w: float, seconds: float) -> Odometry:
    middle = at.yaw + w * seconds / 2
    x, y = at.x + v * seconds * math.cos(middle), at.y + v * seconds * math.sin(middle)
    return Odometry(at.stamp_s + seconds, x, y, at.yaw + w * seconds, v, w)


def _walked(person: Person, seconds: float) -> Person:
    return replace(person, x=person.x + person.v_x * seconds, y=person.y + person.v_y * seconds)


def _places_hit(scan: Scan, at: Odometry, laser: tuple[float, float, float]) -> Doubles:
    """(n, 2) in the odometry's frame, with places between neighbours of one thing: from nearer, beams do not pass
    between them."""
    step = max(1, len(scan.ranges) // MOST_HITS)
    ranges, angles = np.array(scan.ranges[::step], dtype=np.float64), scan.angles[::step]
    seen = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    ranges[~seen] = 0.0
    x, y, yaw = place_laser((at.x, at.y, at.yaw), laser)
    hits = np.column_stack([x + ranges * np.cos(yaw + angles), y + ranges * np.sin(yaw + angles)])
    follows = np.roll(hits, -1, axis=0)
    joined = seen & np.roll(seen, -1)
    joined[joined] = np.hypot(*(follows - hits)[joined].T) < JOINED_M
    shares = np.arange(1, BETWEEN + 1)[:, None, None] / (BETWEEN + 1)
    between = (hits[joined] * (1 - shares) + follows[joined] * shares).reshape(-1, 2)
    return np.concatenate([hits[seen], between])


def _scan_from(things: Doubles, like: Scan, at: Odometry, laser: tuple[float, float, float]) -> Scan:
    """The same lidar's scan among those places, from where the robot is then."""
    x, y, yaw = place_laser((at.x, at.y, at.yaw), laser)
    apart = things - (x, y)
    far = np.hypot(*apart.T)
    turned = np.arctan2(apart[:, 1], apart[:, 0]) - yaw - like.angle_min
    of_turn = FULL_TURN / abs(like.angle_increment)
    beams = np.rint(turned / like.angle_increment % of_turn).astype(np.int64)
    ranges = np.full(max(len(like.ranges), math.ceil(of_turn) + 1), np.inf)
    np.minimum.at(ranges, beams, far)
    ranges[0] = min(ranges[0], *ranges[math.ceil(of_turn) :])  # a whole turn is its beginning
    return replace(like, stamp_s=at.stamp_s, ranges=ranges[: len(like.ranges)])
