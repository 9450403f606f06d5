"""What a setup says of preferences in its file, and what is taken where it does not: rules that give about what the
shipped setups say, from its robot and a hundred of its scenes. All ours.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from desirepath.learning.preferences import bounds
from desirepath.learning.preferences.bounds import SceneBounds
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.setup_parts import Closeness, Middle
from desirepath.simulation.setups import get_setup

SCENES = 100
LONGEST_WATCHED_S = 20.0


@cache
def scene_bounds(setup: str) -> tuple[SceneBounds, ...]:
    """Of the hundred scenes."""
    return tuple(map(SceneBounds, scene_set(setup, SCENES, purpose=Purpose.SELECT, seed=0)))


@cache
def far_enough_m(setup: str) -> float:
    """Where `farther` is content: the ceiling of nine in ten scenes, as beyond it the goal itself is too near the
    person."""
    own = get_setup(setup)
    if own.preferences.far_enough_m is not None:
        return own.preferences.far_enough_m
    ceiling = bounds.nearest_ceiling_m if own.pedestrians else bounds.ceiling_m
    return float(np.quantile([ceiling(scene) for scene in scene_bounds(setup)], 0.9))


@cache
def closeness(setup: str) -> Closeness:
    """What a step costs who prefers `closer`: less never pays within a quarter of a second and 0.1 m of contact."""
    own = get_setup(setup)
    if own.preferences.closeness is not None:
        return own.preferences.closeness
    contact = bounds.touching_m if own.pedestrians else bounds.contact_m
    return Closeness(contact(scene_bounds(setup)[0]) + 0.1 + 0.25 * own.robot.limits.v_max, range_m=0.6, least=0.1)


@cache
def middle(setup: str) -> Middle:
    """Where a conditioning search changes what it conditions on: half the usual way to the goal, and two thirds of that
    farther."""
    own = get_setup(setup).preferences.middle
    if own is not None:
        return own
    half_way_m = float(np.median([scene.goal_m for scene in scene_bounds(setup)])) / 2
    return Middle(half_way_m, half_way_m * 2 / 3)


@cache
def longest_shown_s(setup: str) -> float:
    """Of a query's trajectory: twice the straight way at full speed in nine of ten scenes, at most 20 s."""
    own = get_setup(setup).preferences.longest_shown_s
    if own is not None:
        return own
    return min(
        LONGEST_WATCHED_S, 2 * float(np.quantile([bounds.full_speed_s(scene) for scene in scene_bounds(setup)], 0.9))
    )


def longest_simulated_s(setup: str) -> float:
    """The same where simulated people are asked, who have more patience in the open field."""
    return get_setup(setup).preferences.longest_simulated_s or longest_shown_s(setup)
