"""The objectives: what people may prefer in a robot's driving, nine of them, each measured twice.

Of a whole trajectory, as a person compares two (`measures`), and of one step, as a policy is rewarded (`step_terms`).
How much each objective matters to somebody are preference weights: learned in `posterior.py`, driven by in
`conditioned.py`. All ours (issue 3, spec 06 "Known limits").
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.analysis import metrics
from backend.learning.errors import LearningError
from backend.learning.preferences.features import obstacle_clearance_m
from backend.simulation.setups import Setup
from backend.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class Objective:
    """One thing that people may want more of.

    measure: index into MEASURES of what it is judged by; sign: +1 wants more of that measure, -1 less.
    """

    name: str
    measure: int
    sign: int


MEASURES = (
    "min_human_distance_m",
    "passing_side",
    "min_clearance_m",
    "path_length_m",
    "accumulated_angle_rad",
    "speed_near_person_m_s",
    "time_s",
)
OBJECTIVES = (
    Objective("farther", 0, +1),
    Objective("closer", 0, -1),
    Objective("person_on_left", 1, +1),
    Objective("person_on_right", 1, -1),
    Objective("clearance", 2, +1),
    Objective("shorter", 3, -1),
    Objective("smoother", 4, -1),
    Objective("slower_near_person", 5, -1),
    Objective("faster", 6, -1),
)
NAMES = tuple(objective.name for objective in OBJECTIVES)
SIZE = len(OBJECTIVES)
OPPOSITES = ((0, 1), (2, 3))
"""Pairs of objectives that nobody prefers at once."""
MIRRORED = np.array([0, 1, 3, 2, 4, 5, 6, 7, 8])
"""weights[MIRRORED]: the same preference in a world with left and right exchanged."""

TYPICAL_DIFFERENCES = {
    "study_room": (0.431, 1.049, 0.167, 0.710, 3.855, 0.093, 1.018),
    "open_field": (0.592, 1.545, 0.244, 1.004, 18.284, 0.044, 2.679),
    "room": (0.571, 1.201, 0.206, 1.755, 1.373, 0.058, 7.945),
    "corridor": (0.522, 1.0, 0.338, 1.173, 2.242, 0.054, 6.066),
}
"""By setup and measure, in its unit: standard deviation of the difference within a pair, over 1,500 pairs of the
shipped ensemble; in the room and the corridor of chapter 2, which have none, over pairs of 24 trajectories of the
programmed demonstrators, DWA and social cost in each of the four situations (all pass on one side of the corridor's
person: 1)."""

NEAR_PERSON_M = 2.0
NEAREST_BAND_M = 0.5
CLEARANCE_CAP_M = 0.8  # spec 06: farther than this from obstacles is no better


@dataclass(frozen=True)
class Closeness:
    """What a step costs who wants to be `closer`: `least` in any case, since staying beside the person must not be
    free, rising to 1 over some `range_m`, from `enough_m` on: less never pays, 0.48 m is contact.
    """

    enough_m: float
    range_m: float
    least: float


CLOSENESS = {"open_field": Closeness(0.7, 0.8, 0.35), "study_room": Closeness(0.85, 0.5, 0.1)}
"""By setup. The room's robot is twice as fast, and a step beside the person is a larger part of its trajectory."""
FAR_ENOUGH_M = {"open_field": 4.0, "study_room": 2.5}
"""By setup, where `farther` is content: little beyond the ceilings, else the goal itself is too near the person."""
SLOW_SHARE = 0.5  # of full speed: slower than this near the person is no better
SIDE_RANGE_M = 3.0


def preference_weights(weights: Mapping[str, float]) -> Floats:
    """(9,) float32 preference weights from objectives by name; what is not named weighs nothing.

    Raises LearningError for an unknown name, a weight outside [0, 1] or two opposites.
    """
    unknown = [name for name in weights if name not in NAMES]
    if unknown:
        raise LearningError(f"objective {unknown[0]!r} is unknown; known are {', '.join(NAMES)}")
    return check_weights(np.array([weights.get(name, 0.0) for name in NAMES], dtype=np.float32))


def parsed_weights(text: str) -> Floats:
    """Preference weights from words such as `farther=1,smoother=0.5`; empty: nothing. Raises LearningError."""
    named: dict[str, float] = {}
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        try:
            named[name.strip()] = float(value)
        except ValueError:
            raise LearningError(
                f"preference weights {word!r}: write it as objective=weight, e.g. farther=1,smoother=0.5"
            ) from None
    return preference_weights(named)


def check_weights(weights: Floats) -> Floats:
    """The weights (9,) as float32. Raises LearningError unless each is in [0, 1] and no two are opposites."""
    weights = np.asarray(weights, dtype=np.float32)
    if weights.shape != (SIZE,):
        raise LearningError(f"preference weights have shape {weights.shape}; needed is ({SIZE},)")
    for name, weight in zip(NAMES, weights, strict=True):
        if not 0.0 <= weight <= 1.0:
            raise LearningError(f"preference weight {name} = {weight:g}: must be between 0 and 1")
    for a, b in OPPOSITES:
        if weights[a] > 0 and weights[b] > 0:
            raise LearningError(f"preference weights {NAMES[a]} and {NAMES[b]} are opposites: only one may be above 0")
    return weights


def shares_of_reward(weights: Floats) -> Floats:
    """(..., 9) preference weights -> what part of the reward each is given: several together have that of one full
    weight.

    Else two objectives would ask for more than the goal is worth, and the robot stood still.
    """
    together: Floats = weights / np.maximum(weights.sum(axis=-1, keepdims=True), np.float32(1))
    return together


def measures(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, 7) in the order of MEASURES, each trajectory judged as a whole.

    passing_side: sine of the person's bearing at the closest approach, +1 straight to the robot's left.
    speed_near_person: mean speed (m/s) while within 2 m of the person, or within 0.5 m of the closest approach where
    the robot stays farther away. min_clearance is capped at 0.8 m. Raises ValueError for none.
    """
    measured = metrics.measure(trajectories)
    sides, speeds = np.array([_near_person(trajectory) for trajectory in trajectories]).T
    return np.stack(
        [
            measured.min_human_distance,
            sides,
            np.minimum(measured.min_obstacle_distance, CLEARANCE_CAP_M),
            measured.path_length,
            measured.accumulated_angle,
            speeds,
            measured.time,
        ],
        axis=1,
    )


def _near_person(trajectory: Trajectory) -> tuple[float, float]:
    """passing_side and speed_near_person of one trajectory."""
    poses, person = trajectory.poses.astype(np.float64), trajectory.scene.person.pose
    offsets = np.array([person.x, person.y]) - poses[:, :2]
    distances = np.linalg.norm(offsets, axis=1)
    nearest = int(distances.argmin())
    bearing = math.atan2(offsets[nearest, 1], offsets[nearest, 0]) - poses[nearest, 2]
    near = distances[1:] <= near_person_m(distances[1:].min())
    speeds = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / trajectory.dt
    return math.sin(bearing), float(speeds[near].mean())


def near_person_m(nearest_m: NDArray[np.float64]) -> Doubles:
    """How far from the person a robot counts as near them, by how near it ever comes: speed_near_person is of there."""
    return np.maximum(NEAR_PERSON_M, nearest_m + NEAREST_BAND_M)


def typical_differences(setup: str) -> Doubles:
    """(7,) what one unit of a measure is when measures are weighed against each other, in the order of MEASURES."""
    return np.array(TYPICAL_DIFFERENCES[setup])


def gains(differences: Doubles) -> Doubles:
    """(n, 7) differences of measures -> (n, 9): how much better for each objective, in the measure's unit."""
    columns = [objective.measure for objective in OBJECTIVES]
    signs = np.array([objective.sign for objective in OBJECTIVES], dtype=np.float64)
    better: Doubles = differences[:, columns] * signs
    return better


def step_terms(actions: Floats, next_observations: Floats, setup: Setup) -> Floats:
    """(n, 9) float32 in the order of OBJECTIVES, each in [-1, 0], of the states that the steps led to.

    A reward <= 0 never pays for waiting (spec 06); zero is "nothing to complain". Summed over a trajectory, `shorter`
    is half the excess over the straight way in steps at full speed, which within a scene differs as path lengths do.
    """
    person_m = next_observations[:, 2] * np.float32(setup.distance_scale_m)
    on_left = np.sin(next_observations[:, 3] * np.float32(math.pi))
    beside = np.square(np.clip(1 - person_m / SIDE_RANGE_M, 0, 1))
    clearance_m = obstacle_clearance_m(next_observations, setup)
    speed = (np.clip(actions[:, 0], -1, 1) + 1) / 2
    near = np.clip((NEAR_PERSON_M + 0.5 - person_m) / 0.5, 0, 1)
    off_course = (1 - np.cos(next_observations[:, 1] * np.float32(math.pi))) / 2
    near_by = CLOSENESS[setup.name]
    apart = 1 - np.exp(-np.clip(person_m - near_by.enough_m, 0, None) / near_by.range_m)
    terms = [
        -np.square(np.clip(1 - person_m / FAR_ENOUGH_M[setup.name], 0, 1)),
        -near_by.least - (1 - near_by.least) * apart,
        -beside * np.clip(-on_left, 0, 1),
        -beside * np.clip(on_left, 0, 1),
        -np.square(np.clip(1 - clearance_m / CLEARANCE_CAP_M, 0, 1)),
        -speed * off_course,
        -np.abs(np.clip(actions[:, 1], -1, 1)),
        # The way around the person is priced too: driving past slowly is what was preferred.
        -0.85 * near * np.square(np.clip((speed - SLOW_SHARE) / (1 - SLOW_SHARE), 0, 1)) - 0.15 * speed * off_course,
        np.full(len(actions), -1.0),
    ]
    return np.stack(terms, axis=1).astype(np.float32)
