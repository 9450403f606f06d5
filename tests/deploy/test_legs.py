"""People by their legs: two of them a step apart, and nothing else that stands around."""

from __future__ import annotations

import math

import numpy as np
import pytest

from desirepath.deploy.inputs import Odometry, Scan
from desirepath.deploy.legs import find_people

HERE = Odometry(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
BEAMS = 720


def scan_of(discs: list[tuple[float, float, float]], wall_x: float = 6.0, noise_m: float = 0.0, seed: int = 0) -> Scan:
    """What a lidar at the origin sees of discs (x, y, radius) before a wall all along x = wall_x."""
    angles = -math.pi + np.arange(BEAMS) * math.tau / BEAMS
    ahead, aside = np.cos(angles), np.sin(angles)
    ranges = np.where(ahead > 1e-3, wall_x / np.maximum(ahead, 1e-3), np.inf)
    for x, y, radius in discs:
        near = x * ahead + y * aside
        off = x * x + y * y - near * near
        hit = (near > 0) & (off < radius * radius)
        ranges = np.where(hit, np.minimum(ranges, near - np.sqrt(np.maximum(radius * radius - off, 0))), ranges)
    ranges = ranges + np.random.default_rng(seed).normal(0, noise_m, BEAMS) if noise_m else ranges
    return Scan(0.0, -math.pi, math.tau / BEAMS, 0.1, 10.0, ranges)


def legs(x: float, y: float, apart: float = 0.26) -> list[tuple[float, float, float]]:
    return [(x, y - apart / 2, 0.06), (x, y + apart / 2, 0.06)]


@pytest.mark.parametrize("place", [(1.5, 0.4), (2.0, -1.2), (0.9, 0.0), (-1.5, 0.0), (-1.2, 1.1)])
def test_somebody_stands_where_two_legs_are(place):
    for noise in (0.0, 0.005):
        (person,) = find_people(scan_of(legs(*place), noise_m=noise), HERE)
        assert math.dist((person.x, person.y), place) < 0.12


def test_two_people_are_two_and_the_nearest_comes_first():
    found = find_people(scan_of([*legs(2.5, 1.0), *legs(1.2, -0.8)]), HERE)
    assert [round(one.x, 1) for one in found] == pytest.approx([1.2, 2.5], abs=0.15)


def test_walls_posts_far_apart_a_column_and_an_empty_room_are_nobody():
    table = [(1.5, 0.4, 0.03), (1.5, -0.4, 0.03), (2.4, 0.4, 0.03), (2.4, -0.4, 0.03)]
    for discs in ([], table, [(1.5, 0.0, 0.3)], [(2.0, 0.5, 0.06)]):
        assert find_people(scan_of(discs), HERE) == ()
    assert find_people(scan_of([], wall_x=0.4), HERE) == ()


def test_places_are_in_the_odometrys_frame_wherever_the_lidar_is_mounted():
    robot = Odometry(0.0, 3.0, 1.0, math.pi / 2, 0.0, 0.0)
    (person,) = find_people(scan_of(legs(2.0, 0.0)), robot, laser=(0.1, 0.0, 0.0))
    assert (person.x, person.y) == pytest.approx((3.0, 3.1), abs=0.12)
    (behind,) = find_people(scan_of(legs(2.0, 0.0)), robot, laser=(0.0, 0.0, math.pi))
    assert (behind.x, behind.y) == pytest.approx((3.0, -1.0), abs=0.12)


def test_what_is_invalid_or_unseen_is_nobody():
    whole = scan_of(legs(1.5, 0.0))
    for fill in (math.nan, math.inf, 0.0):
        blind = Scan(0.0, whole.angle_min, whole.angle_increment, 0.1, 10.0, np.full(BEAMS, fill))
        assert find_people(blind, HERE) == ()
