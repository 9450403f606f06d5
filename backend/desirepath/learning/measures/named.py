"""Named measures of a whole trajectory: what participants and experimenters read where the nine objectives say little.

All ours; where the field has a definition the row says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.steps import SeenSteps
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
PERSONAL_SPACE_M = 1.2  # Hall 1966: where personal space ends and social space begins
INTIMATE_M = 0.8
SOCIAL_M = 2.0
FRONT_RAD = 0.79  # 45 degrees to either side of where the person looks
LONGEST_TTC_S = 5.0


@dataclass(frozen=True)
class WholeSteps:
    """The steps of some trajectories with what needs poses: where the person looks, how fast they are approached."""

    trajectories: Sequence[Trajectory]
    steps: SeenSteps

    @classmethod
    def of(cls, trajectories: Sequence[Trajectory]) -> WholeSteps:
        return cls(trajectories, SeenSteps.of_trajectories(trajectories))

    def word(self, name: str) -> Doubles:
        return self.steps.words[name]

    def sums(self, values: Doubles) -> Doubles:
        """(trajectories,) sum of (n,) over each trajectory's steps."""
        return np.bincount(self.steps.of, values).astype(np.float64)

    @cached_property
    def within(self) -> Doubles:
        """(n,) 1 within the social distance of the person."""
        return (self.word("person_m") < SOCIAL_M).astype(np.float64)

    def near(self, values: Doubles) -> Doubles:
        """(trajectories,) mean of (n,) over the steps near the person, counted down where there are few of them."""
        return np.bincount(self.steps.of, values * self.within) / (np.bincount(self.steps.of, self.within) + 3.0)

    def at_first(self, values: Doubles) -> Doubles:
        """(trajectories,) mean over the first half minus mean over the second."""
        first = (self.steps.place < 0.5).astype(np.float64)
        counts = np.bincount(self.steps.of, first)
        rest = np.bincount(self.steps.of) - counts
        differences: Doubles = np.bincount(self.steps.of, values * first) / np.maximum(counts, 1) - np.bincount(
            self.steps.of, values * (1 - first)
        ) / np.maximum(rest, 1)
        return differences

    @cached_property
    def closing_m_s(self) -> Doubles:
        """(n,) how fast the person comes nearer."""
        distance = self.word("person_m")
        before = self.steps.observations[:, 2] * self.steps.setup.distance_scale_m
        return (before - distance) / CONTROL_DT_S

    @cached_property
    def time_to_collision_s(self) -> Doubles:
        """(n,) until contact at this pace, at most LONGEST_TTC_S (Hayward 1972, of robot and person)."""
        gap = np.maximum(self.word("person_m") - 0.48, 0.0)
        return np.clip(gap / np.maximum(self.closing_m_s, 1e-3), 0.0, LONGEST_TTC_S)

    @cached_property
    def in_front(self) -> Doubles:
        """(n,) 1 within the social distance in front of the person's face."""
        near_ahead = []
        for trajectory in self.trajectories:
            person = trajectory.scene.person.pose
            offsets = trajectory.poses[1:, :2].astype(np.float64) - [person.x, person.y]
            bearing = np.arctan2(offsets[:, 1], offsets[:, 0]) - person.yaw
            ahead = np.cos(bearing) >= np.cos(FRONT_RAD)
            near_ahead.append(ahead & (np.linalg.norm(offsets, axis=1) < SOCIAL_M))
        return np.concatenate(near_ahead).astype(np.float64)

    @cached_property
    def hesitations(self) -> Doubles:
        """(n,) 1 where the robot slows from driving to nearly standing."""
        speed, before = self.word("speed"), (self.steps.before[:, 0] + 1) / 2
        return ((before >= 0.4) & (speed < 0.2)).astype(np.float64)


def _mean(word: str) -> Callable[[WholeSteps], Doubles]:
    return lambda whole: whole.steps.means(whole.word(word))


def _least(word: str) -> Callable[[WholeSteps], Doubles]:
    return lambda whole: whole.steps.lowest(whole.word(word))


def _near(word: str) -> Callable[[WholeSteps], Doubles]:
    return lambda whole: whole.near(whole.word(word))


def _at_first(word: str) -> Callable[[WholeSteps], Doubles]:
    return lambda whole: whole.at_first(whole.word(word))


def _in_all(word: str) -> Callable[[WholeSteps], Doubles]:
    return lambda whole: whole.sums(whole.word(word)) * CONTROL_DT_S


def _share(word: str, below: float) -> Callable[[WholeSteps], Doubles]:
    return lambda whole: whole.steps.means((whole.word(word) < below).astype(np.float64))


NAMED: dict[str, Callable[[WholeSteps], Doubles]] = {
    "free_range_ahead": _mean("free_ahead_m"),
    "free_range_around": _mean("free_around_m"),
    "least_free_range_ahead": _least("free_ahead_m"),
    "mean_clearance": _mean("clearance_m"),
    "nearest_obstacle": _least("clearance_m"),
    "time_near_obstacles": _share("clearance_m", 0.3),
    "mean_person_distance": _mean("person_m"),
    "nearest_person": _least("person_m"),
    "personal_space_time": _share("person_m", PERSONAL_SPACE_M),
    "intimate_space_time": _share("person_m", INTIMATE_M),
    "social_space_time": _share("person_m", SOCIAL_M),
    "signed_side": _mean("person_on_left"),
    "signed_side_near": _near("person_on_left"),
    "facing_person": _mean("person_ahead"),
    "approach_angle": _near("person_ahead"),
    "cutting_in_front": lambda whole: whole.steps.means(whole.in_front),
    "time_to_collision": lambda whole: whole.steps.lowest(whole.time_to_collision_s),
    "closing_speed": lambda whole: -whole.steps.lowest(-whole.closing_m_s),
    "mean_speed": _mean("speed"),
    "speed_near": _near("speed"),
    "turning": _mean("turning"),
    "turning_near": _near("turning"),
    "turning_left": _mean("turning_left"),
    "jerk": _mean("jerk"),
    "jerk_near": _near("jerk"),
    "heading_error": _mean("off_course"),
    "standing": _mean("standing"),
    "turning_on_the_spot": lambda whole: whole.steps.means(whole.word("standing") * whole.word("turning")),
    "hesitation": lambda whole: whole.sums(whole.hesitations),
    "goal_distance": _mean("goal_m"),
    "duration": lambda whole: whole.sums(np.full(len(whole.steps.of), CONTROL_DT_S)),
    "way": _in_all("speed"),
    "turns_in_all": _in_all("turning"),
    "faster_at_first": _at_first("speed"),
    "turning_more_at_first": _at_first("turning"),
    "person_nearer_at_first": _at_first("person_m"),
    "person_left_at_first": _at_first("person_on_left"),
    "freer_at_first": _at_first("free_ahead_m"),
    "off_course_at_first": _at_first("off_course"),
}
"""By name, of trajectories as steps: (trajectories,) in the measure's own unit."""
NAMES = tuple(NAMED)


def named_measures(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, measures) in the order of NAMES. Raises SetupError for mixed setups, ValueError for none."""
    whole = WholeSteps.of(trajectories)
    return np.stack([measure(whole) for measure in NAMED.values()], axis=1)
