"""The reward of one step for somebody with an objective: a term in [-1, 0] each, 0 for "nothing to complain".

A reward <= 0 never pays for waiting. Which term is whose stands in `objectives.py`. All ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.preferences.crowd_measures import MOVES_M_S, Surroundings
from desirepath.learning.preferences.features import obstacle_clearance_m
from desirepath.learning.preferences.measures import CLEARANCE_CAP_M, NEAR_PERSON_M
from desirepath.learning.preferences.setup_settings import closeness, far_enough_m
from desirepath.simulation.setups import Setup

Floats = NDArray[np.floating[Any]]


SLOW_SHARE = 0.5  # of full speed: slower than this near the person is no better
SIDE_RANGE_M = 3.0
ELSEWHERE = 0.05  # of a step in front, what one costs that is neither in front nor behind, where behind is preferred:
# with 0.3 every step was dear, and whoever preferred to pass behind, or to cut in front, only drove faster


@dataclass(frozen=True)
class Steps:
    """n steps as the terms see them: actions (n, 2), and the observations (n, obs) of the states they led to."""

    actions: Floats
    next_observations: Floats
    setup: Setup

    @cached_property
    def person_m(self) -> Floats:
        return self.next_observations[:, 2] * np.float32(self.setup.distance_scale_m)

    @cached_property
    def person_on_left(self) -> Floats:
        """Sine of the person's bearing, +1 straight to the left."""
        person_on_left: Floats = np.sin(self.next_observations[:, 3] * np.float32(math.pi))
        return person_on_left

    @cached_property
    def beside_person(self) -> Floats:
        beside_person: Floats = np.square(np.clip(1 - self.person_m / SIDE_RANGE_M, 0, 1))
        return beside_person

    @cached_property
    def speed(self) -> Floats:
        """Share of full speed, as acted."""
        return (np.clip(self.actions[:, 0], -1, 1) + 1) / 2

    @cached_property
    def off_course(self) -> Floats:
        """0 straight towards the goal, 1 straight away from it."""
        off_course: Floats = (1 - np.cos(self.next_observations[:, 1] * np.float32(math.pi))) / 2
        return off_course

    @cached_property
    def around(self) -> Surroundings:
        """The pedestrians that the robot is told of, where there are some."""
        return Surroundings(self.next_observations, self.setup)


def too_near(steps: Steps) -> Floats:
    term: Floats = -np.square(np.clip(1 - steps.person_m / far_enough_m(steps.setup.name), 0, 1))
    return term


def too_far(steps: Steps) -> Floats:
    near_by = closeness(steps.setup.name)
    apart = 1 - np.exp(-np.clip(steps.person_m - near_by.enough_m, 0, None) / near_by.range_m)
    term: Floats = -near_by.least - (1 - near_by.least) * apart
    return term


def person_on_right(steps: Steps) -> Floats:
    return -steps.beside_person * np.clip(-steps.person_on_left, 0, 1)


def person_on_left(steps: Steps) -> Floats:
    return -steps.beside_person * np.clip(steps.person_on_left, 0, 1)


def near_obstacle(steps: Steps) -> Floats:
    clearance_m = obstacle_clearance_m(steps.next_observations, steps.setup)
    term: Floats = -np.square(np.clip(1 - clearance_m / CLEARANCE_CAP_M, 0, 1))
    return term


def detour(steps: Steps) -> Floats:
    """Summed over a trajectory half the excess over the straight way in steps at full speed, which within a scene
    differs as path lengths do."""
    return -steps.speed * steps.off_course


def turning(steps: Steps) -> Floats:
    return -np.abs(np.clip(steps.actions[:, 1], -1, 1))


def fast_near_person(steps: Steps) -> Floats:
    """The way around the person is priced too: driving past slowly is what was preferred."""
    near = np.clip((NEAR_PERSON_M + 0.5 - steps.person_m) / 0.5, 0, 1)
    too_fast = np.square(np.clip((steps.speed - SLOW_SHARE) / (1 - SLOW_SHARE), 0, 1))
    term: Floats = -0.85 * near * too_fast - 0.15 * steps.speed * steps.off_course
    return term


def every_step(steps: Steps) -> Floats:
    return np.full(len(steps.actions), -1.0)


def ahead_of_people(steps: Steps) -> Floats:
    """Being where who walks is going, nearer worse; behind them nothing, elsewhere a little, else it would be avoided
    by keeping away."""
    return _out_of_place(steps, worse=steps.around.in_front, better=steps.around.behind)


def behind_people(steps: Steps) -> Floats:
    """The other way round."""
    return _out_of_place(steps, worse=steps.around.behind, better=steps.around.in_front)


def _out_of_place(steps: Steps, *, worse: Floats, better: Floats) -> Floats:
    return -ELSEWHERE * (1 - better) - (1 - ELSEWHERE) * worse


def after_nobody(steps: Steps) -> Floats:
    return steps.around.followed - 1


def moving_beside_people(steps: Steps) -> Floats:
    """Not waiting while somebody walks near; the way around them is priced, too, as beside a person."""
    near = np.clip((NEAR_PERSON_M + 0.5 - steps.around.nearest_walking) / 0.5, 0, 1)
    moving = np.clip(steps.speed * steps.setup.robot.limits.v_max / MOVES_M_S, 0, 1)
    term: Floats = -0.85 * near * moving - 0.15 * steps.speed * steps.off_course
    return term
