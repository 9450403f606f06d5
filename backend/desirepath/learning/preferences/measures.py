"""What a person compares two trajectories by: seven measures of a whole trajectory, in one table.

What somebody may prefer more or less of is `objectives.py`'s. All ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis import metrics
from desirepath.learning.preferences.crowd_measures import crowd_columns
from desirepath.simulation.setups import check_names, get_setup
from desirepath.simulation.trajectory import Trajectory, require_people

Doubles = NDArray[np.float64]

NEAR_PERSON_M = 2.0
NEAREST_BAND_M = 0.5
CLEARANCE_CAP_M = 0.8  # ours: farther than this from obstacles is no better


@dataclass(frozen=True)
class Measure:
    """noticeable: what a person would see of it, in `unit`, ours: for describing query sets, and one unit of it in
    setups whose `setup.yaml` gives no typical difference."""

    name: str
    unit: str
    noticeable: float


TABLE = (
    Measure("min_human_distance_m", "m", 0.2),
    Measure("passing_side", "", 0.3),
    Measure("min_clearance_m", "m", 0.1),
    Measure("path_length_m", "m", 0.5),
    Measure("accumulated_angle_rad", "rad", 1.0),
    Measure("speed_near_person_m_s", "m/s", 0.1),
    Measure("time_s", "s", 1.0),
)
MEASURES = tuple(measure.name for measure in TABLE)


CROWD_TABLE = (
    Measure("min_human_distance_m", "m", 0.2),  # to the nearest pedestrian, of a centre
    Measure("ahead_of_people", "", 0.2),
    Measure("following", "", 0.1),
    Measure("moving_beside_people", "", 0.1),
    Measure("accumulated_angle_rad", "rad", 1.0),
    Measure("speed_near_person_m_s", "m/s", 0.1),
    Measure("time_s", "s", 1.0),
)
"""Among pedestrians, place by place: ahead_of_people is where the robot was for those who walked near it, +1 straight
ahead of them (it cut in front), -1 behind; following: share of the time after somebody; moving_beside_people: share of
the time near somebody who walks in which it did not wait."""


def table_of(setup: str) -> tuple[Measure, ...]:
    """The seven measures that people compare trajectories of that setup by."""
    return CROWD_TABLE if get_setup(setup).pedestrians else TABLE


def in_order(
    columns: Mapping[str, NDArray[np.floating] | NDArray[np.integer]], table: Sequence[Measure] = TABLE
) -> Doubles:
    """(n, 7) in the order of the table, of one column (n,) for each by its name."""
    return np.stack([columns[measure.name] for measure in table], axis=1)


def measures(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, 7) in the order of MEASURES, each trajectory judged as a whole.

    passing_side: sine of the person's bearing at the closest approach, +1 straight to the robot's left.
    speed_near_person: mean speed (m/s) while within 2 m of the person, or within 0.5 m of the closest approach where
    the robot stays farther away. min_clearance is capped at 0.8 m. Among pedestrians those of `crowd_measures.py`.
    Raises ValueError for none.
    """
    if trajectories and get_setup(trajectories[0].scene.setup).pedestrians:
        return in_order(crowd_columns(trajectories, get_setup(trajectories[0].scene.setup)), CROWD_TABLE)
    require_people(trajectories)
    poses = metrics.stack_poses(trajectories)
    clearances = metrics.min_obstacle_distance(poses, [trajectory.scene for trajectory in trajectories])
    least, sides, speeds = _near_person(trajectories, poses)
    return in_order(
        {
            "min_human_distance_m": least,
            "passing_side": sides,
            "min_clearance_m": np.minimum(clearances, CLEARANCE_CAP_M),
            "path_length_m": metrics.path_length(poses),
            "accumulated_angle_rad": metrics.accumulated_angle(poses),
            "speed_near_person_m_s": speeds,
            "time_s": np.array([trajectory.duration_s for trajectory in trajectories]),
        }
    )


def _near_person(trajectories: Sequence[Trajectory], poses: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """(n,) each: the smallest distance to anybody, passing_side and speed_near_person. poses: of all, stacked."""
    stacked = np.empty((*poses.shape[:2], 2))
    for row, trajectory in zip(stacked, trajectories, strict=True):
        n, pose = len(trajectory.poses), trajectory.scene.person.pose
        if trajectory.scene.walk is None:
            row[:] = pose.x, pose.y
        else:
            row[:n] = trajectory.scene.person_poses(trajectory.times)[:, :2]
            row[n:] = row[n - 1]
    offsets = stacked - poses[:, :, :2]
    distances = np.linalg.norm(offsets, axis=2)
    each, nearest = np.arange(len(poses)), distances.argmin(axis=1)
    bearings = np.arctan2(offsets[each, nearest, 1], offsets[each, nearest, 0]) - poses[each, nearest, 2]
    lengths = np.array([len(trajectory.actions) for trajectory in trajectories])
    after = np.where(np.arange(poses.shape[1] - 1) < lengths[:, None], distances[:, 1:], np.inf)
    near = after <= near_person_m(after.min(axis=1))[:, None]
    speeds = np.linalg.norm(np.diff(poses[:, :, :2], axis=1), axis=2)
    speeds /= np.array([trajectory.dt for trajectory in trajectories])[:, None]
    least = distances.min(axis=1)
    for k, trajectory in enumerate(trajectories):
        if trajectory.scene.crowd is not None:
            people = trajectory.scene.people_at(trajectory.times)
            least[k] = metrics.min_human_distance(trajectory.poses[None], people).min()
    return least, np.sin(bearings), (speeds * near).sum(axis=1) / near.sum(axis=1)


def beside_person(trajectory: Trajectory) -> tuple[Doubles, Doubles]:
    """(n,) how far the robot was from the person at every moment, m; (n,) the cosine of where it was for them: 1
    straight in front of them, -1 behind."""
    people = trajectory.scene.person_poses(trajectory.times)
    x, y = (trajectory.poses[:, :2].astype(np.float64) - people[:, :2]).T
    return np.hypot(x, y), np.cos(np.arctan2(y, x) - people[:, 2])


def near_person_m(nearest_m: NDArray[np.float64]) -> Doubles:
    """How far from the person a robot counts as near them, by how near it ever comes: speed_near_person is of there."""
    return np.maximum(NEAR_PERSON_M, nearest_m + NEAREST_BAND_M)


@cache
def _typical_differences(setup: str) -> tuple[float, ...]:
    table, typical = table_of(setup), get_setup(setup).preferences.typical
    names = [measure.name for measure in table]
    check_names(setup, "typical", typical, names)
    return tuple(typical.get(measure.name, measure.noticeable) for measure in table)


def typical_differences(setup: str) -> Doubles:
    """(7,) what one unit of a measure is when measures are weighed against each other, in the order of MEASURES: as the
    setup's file says, between two trajectories of its queries; where nobody has measured that, what people notice.
    Raises SetupError for a file that names another measure.
    """
    return np.array(_typical_differences(setup))
