"""What simulated people see of every step: what it is like, word by word, and the raw inputs in standard deviations.

What learning sees of a trajectory is its own matter; nothing is imported from here to there. All ours.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.remembered import remember_last
from desirepath.learning.preferences.features import obstacle_clearance_m
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.shipped_files import resolve, shipped_names
from desirepath.simulation.setups import Setup, get_setup, require_same
from desirepath.simulation.trajectory import Trajectory, require_steps

Doubles = NDArray[np.float64]
REFERENCE_PAIRS = 60
_VARIED = re.compile("[^/]+/queries_varied_([0-9]+)")
AHEAD_RAD = math.pi / 6
STANDING = 0.1  # of full speed
WORDS = (
    "person_m",
    "clearance_m",
    "free_ahead_m",
    "free_around_m",
    "person_on_left",
    "person_ahead",
    "speed",
    "turning",
    "turning_left",
    "off_course",
    "standing",
    "jerk",
    "goal_m",
)


@dataclass(frozen=True)
class SeenSteps:
    """The steps of some trajectories, one after another. actions (n, 2), observations, next_observations (n, obs),
    before (n, 2): the action before. of (n,): which trajectory; place (n,): 0 at its first step, 1 at its last."""

    setup: Setup
    observations: Doubles
    actions: Doubles
    next_observations: Doubles
    before: Doubles
    of: NDArray[np.int64]
    place: Doubles

    @classmethod
    def of_trajectories(cls, trajectories: Sequence[Trajectory]) -> SeenSteps:
        """Raises SetupError for several setups, ValueError for none."""
        return _steps_of(trajectories)

    @classmethod
    def _of(cls, trajectories: Sequence[Trajectory]) -> SeenSteps:
        names = {f"trajectory {k}": trajectory.scene.setup for k, trajectory in enumerate(trajectories)}
        if not names:
            raise ValueError("trajectories: none given; at least one is needed")
        require_steps(trajectories)
        lengths = [len(driven.actions) for driven in trajectories]
        actions = [np.clip(driven.actions.astype(np.float64), -1, 1) for driven in trajectories]
        return cls(
            get_setup(require_same(**names)),
            np.concatenate([driven.observations for driven in trajectories]).astype(np.float64),
            np.concatenate(actions),
            np.concatenate([driven.next_observations for driven in trajectories]).astype(np.float64),
            np.concatenate([np.concatenate([taken_actions[:1], taken_actions[:-1]]) for taken_actions in actions]),
            np.repeat(np.arange(len(lengths)), lengths),
            np.concatenate([np.arange(n) / max(n - 1, 1) for n in lengths]),
        )

    def means(self, values: Doubles) -> Doubles:
        """(trajectories,) mean of (n,) over each trajectory's steps."""
        return np.bincount(self.of, values) / np.bincount(self.of)

    def lowest(self, values: Doubles) -> Doubles:
        """(trajectories,) least of (n,) over each trajectory's steps."""
        least: Doubles = np.full(self.of[-1] + 1, np.inf)
        np.minimum.at(least, self.of, values)
        return least

    @cached_property
    def words(self) -> dict[str, Doubles]:
        """By name of WORDS, (n,) each: what the state that a step led to is like, and how it was acted."""
        after, scale = self.next_observations, self.setup.distance_scale_m
        lidar = after[:, self.setup.polar_size :] * self.setup.robot.lidar.range_m
        sectors = lidar.shape[1]
        bearings = (np.arange(sectors) + 0.5) * 2 * math.pi / sectors
        ahead = np.cos(bearings) >= math.cos(AHEAD_RAD)
        speed, turn = (self.actions[:, 0] + 1) / 2, self.actions[:, 1]
        changed = self.actions - self.before
        return {
            "person_m": after[:, 2] * scale,
            "clearance_m": obstacle_clearance_m(after.astype(np.float32), self.setup).astype(np.float64),
            "free_ahead_m": lidar[:, ahead].mean(1),
            "free_around_m": lidar.mean(1),
            "person_on_left": np.sin(after[:, 3] * math.pi),
            "person_ahead": np.cos(after[:, 3] * math.pi),
            "speed": speed,
            "turning": np.abs(turn),
            "turning_left": turn,
            "off_course": (1 - np.cos(after[:, 1] * math.pi)) / 2,
            "standing": (speed < STANDING).astype(np.float64),
            "jerk": np.abs(changed[:, 0]) / 2 + np.abs(changed[:, 1]) / 2,
            "goal_m": after[:, 0] * scale,
        }

    def inputs(self) -> dict[str, Doubles]:
        """By group, (n, k) each: raw inputs of observation and action; angles as sine and cosine, lidar by sector."""
        seen, polar = self.observations, self.setup.polar_size

        def polar_of(first: int) -> Doubles:
            angle = seen[:, first + 1] * math.pi
            return np.stack([seen[:, first], np.sin(angle), np.cos(angle)], axis=1)

        groups = {"goal": polar_of(0), "person": polar_of(2)}
        if self.setup.pedestrians:
            groups["person_moves"] = seen[:, 4:6]
        if self.setup.with_velocity:
            groups["velocity"] = seen[:, polar - 2 : polar]
        return {**groups, "lidar": seen[:, polar:], "action": self.actions}

    @cached_property
    def scaled_inputs(self) -> dict[str, Doubles]:
        """`inputs` in standard deviations of the reference, at most three of them."""
        known = reference(self.setup.name).inputs
        return {
            name: np.clip((values - known[name][0]) / known[name][1], -3, 3) for name, values in self.inputs().items()
        }


_steps_of = remember_last(SeenSteps._of)


@dataclass(frozen=True)
class Reference:
    """Pairs that are the same for everybody. Members are scaled by them, and inputs are measured in their standard
    deviations.

    trajectories: A and B in turn. words, inputs: mean and standard deviation of every word and of each input of a
    group over all steps.
    """

    trajectories: tuple[Trajectory, ...]
    steps: SeenSteps
    words: dict[str, tuple[float, float]]
    inputs: dict[str, tuple[Doubles, Doubles]]


def _varied_query_sets() -> Mapping[str, str]:
    """Setup -> its shipped varied queries, the most where there are several sets."""
    sets = sorted((int(named[1]), named[0]) for named in (_VARIED.fullmatch(name) for name in shipped_names()) if named)
    return {name.partition("/")[0]: name for _, name in sets}


@lru_cache(maxsize=4)
def reference(setup: str) -> Reference:
    """Of a setup's shipped varied queries. Raises LearningError for a setup in which nobody is asked for
    preferences."""
    shown = _varied_query_sets()
    if setup not in shown:
        raise LearningError(f"setup = {setup!r}: simulated people are of {', '.join(sorted(shown))}")
    queries = QuerySet.load(resolve(shown[setup])).queries[:REFERENCE_PAIRS]
    trajectories = tuple(trajectory for query in queries for trajectory in (query.trajectory_a, query.trajectory_b))
    steps = SeenSteps.of_trajectories(trajectories)
    return Reference(
        trajectories,
        steps,
        {name: (float(values.mean()), float(values.std()) or 1.0) for name, values in steps.words.items()},
        {name: (values.mean(0), np.maximum(values.std(0), 1e-3)) for name, values in steps.inputs().items()},
    )


def scale_words(steps: SeenSteps, names: Sequence[str]) -> Doubles:
    """(n, names) words in standard deviations of the reference."""
    known = reference(steps.setup.name).words
    return np.stack([(steps.words[name] - known[name][0]) / known[name][1] for name in names], axis=1)
