"""How people walk of whom only places come."""

import math

import numpy as np
import pytest

from desirepath.deploy.inputs import Person
from desirepath.deploy.walks import Walks


def told(ways, at_s):
    return [Person(x + v_x * at_s, y + v_y * at_s) for x, y, v_x, v_y in ways]


def velocities(people):
    return [(round(one.v_x, 3), round(one.v_y, 3)) for one in people]


def test_places_that_follow_each_other_are_a_walk_in_whatever_order_they_come():
    ways, walks = [(0.0, 0.0, 1.0, -0.5), (3.0, 0.0, 0.0, 0.0)], Walks()
    assert velocities(walks.follow(told(ways, 0.0), 0.0)) == [(0, 0), (0, 0)]
    assert velocities(walks.follow(told(ways, 0.1), 0.1)) == [(0, 0), (0, 0)], "too short to know"
    assert velocities(walks.follow(told(ways, 0.2)[::-1], 0.2)) == [(0, 0), (1, -0.5)]
    assert velocities(walks.follow(told(ways, 0.8), 0.8)) == [(0, 0), (0, 0)], "too long ago"


def test_who_is_seen_a_little_beside_stands():
    walks, rng = Walks(), np.random.default_rng(0)
    for k in range(50):
        there = [Person(2.0 + x, y) for x, y in rng.normal(0, 0.015, (1, 2))]
        (one,) = walks.follow(there, 0.1 * k)
        assert k < 6 or math.hypot(one.v_x, one.v_y) < 0.3


@pytest.mark.parametrize("at_s", [0.3, 0.2, -5.0, 60.0, math.inf])
def test_whoever_is_suddenly_elsewhere_or_in_another_time_is_somebody_else(at_s):
    walks = Walks()
    for k in range(4):
        walks.follow([Person(0.1 * k, 0.0)], 0.1 * k)
    assert velocities(walks.follow([Person(2.0, 0.0)], at_s)) == [(0, 0)]


def test_a_crowd_is_followed_as_far_as_may_be():
    walks, crowd = Walks(), [(float(k), 0.0, 0.0, 1.0) for k in range(1_000)]
    for k in range(4):
        followed = walks.follow(told(crowd, 0.1 * k), 0.1 * k)
    assert velocities(followed) == [(0, 1)] * 100 + [(0, 0)] * 900
    assert walks.follow([], 0.5) == []
