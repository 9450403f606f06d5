"""What a person compares two trajectories by: seven measures of a whole trajectory, in one table.

What somebody may prefer more or less of is `objectives.py`'s. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis import metrics
from desirepath.learning.preferences.crowd_measures import crowd_columns
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory, require_people

Doubles = NDArray[np.float64]

NEAR_PERSON_M = 2.0
NEAREST_BAND_M = 0.5
CLEARANCE_CAP_M = 0.8  # ours: farther than this from obstacles is no better


@dataclass(frozen=True)
class Measure:
    """noticeable: what a person would see of it, ours, for describing query sets only. typical: by setup, standard
    deviation of the difference within a pair, over 1,500 pairs of the shipped ensemble; in the room and the corridor of
    chapter 2, which have none, over pairs of 24 trajectories of the programmed demonstrators, DWA and social cost in
    each of the four situations; in homes over 100 pairs of depth controllers with and without demonstrations. Both in
    `unit`.
    """

    name: str
    unit: str
    noticeable: float
    typical: Mapping[str, float]


def _typical(*, study_room: float, open_field: float, room: float, corridor: float, home: float) -> dict[str, float]:
    return {"study_room": study_room, "open_field": open_field, "room": room, "corridor": corridor, "home": home}


TABLE = (
    Measure(
        "min_human_distance_m",
        "m",
        0.2,
        _typical(study_room=0.431, open_field=0.592, room=0.571, corridor=0.522, home=0.559),
    ),
    # All pass on one side of the corridor's person: 1.
    Measure(
        "passing_side", "", 0.3, _typical(study_room=1.049, open_field=1.545, room=1.201, corridor=1.0, home=0.659)
    ),
    Measure(
        "min_clearance_m",
        "m",
        0.1,
        _typical(study_room=0.167, open_field=0.244, room=0.206, corridor=0.338, home=0.173),
    ),
    Measure(
        "path_length_m", "m", 0.5, _typical(study_room=0.710, open_field=1.004, room=1.755, corridor=1.173, home=0.849)
    ),
    Measure(
        "accumulated_angle_rad",
        "rad",
        1.0,
        _typical(study_room=3.855, open_field=18.284, room=1.373, corridor=2.242, home=2.225),
    ),
    Measure(
        "speed_near_person_m_s",
        "m/s",
        0.1,
        _typical(study_room=0.093, open_field=0.044, room=0.058, corridor=0.054, home=0.275),
    ),
    Measure("time_s", "s", 1.0, _typical(study_room=1.018, open_field=2.679, room=7.945, corridor=6.066, home=5.526)),
)
MEASURES = tuple(measure.name for measure in TABLE)


def _hall(noticeable: float, name: str, unit: str, typical: float) -> Measure:
    return Measure(name, unit, noticeable, {"crowd_hall": typical})


CROWD_TABLE = (
    _hall(0.2, "min_human_distance_m", "m", 0.565),  # to the nearest pedestrian, of a centre
    _hall(0.2, "ahead_of_people", "", 0.495),
    _hall(0.1, "following", "", 0.114),
    _hall(0.1, "moving_beside_people", "", 0.117),
    _hall(1.0, "accumulated_angle_rad", "rad", 3.077),
    _hall(0.1, "speed_near_person_m_s", "m/s", 0.110),
    _hall(1.0, "time_s", "s", 2.635),
)
"""Among pedestrians, place by place: ahead_of_people is where the robot was for those who walked near it, +1 straight
ahead of them (it cut in front), -1 behind; following: share of the time after somebody; moving_beside_people: share of
the time near somebody who walks in which it did not wait. Typical differences are those of the 60 shipped pairs, which
were chosen to differ: the hall has no ensemble."""


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
    measured = metrics.measure(trajectories)
    sides, speeds = np.array([_near_person(trajectory) for trajectory in trajectories]).T
    return in_order(
        {
            "min_human_distance_m": measured.min_human_distance,
            "passing_side": sides,
            "min_clearance_m": np.minimum(measured.min_obstacle_distance, CLEARANCE_CAP_M),
            "path_length_m": measured.path_length,
            "accumulated_angle_rad": measured.accumulated_angle,
            "speed_near_person_m_s": speeds,
            "time_s": measured.time,
        }
    )


def _near_person(trajectory: Trajectory) -> tuple[float, float]:
    """passing_side and speed_near_person of one trajectory."""
    poses, scene = trajectory.poses.astype(np.float64), trajectory.scene
    person = scene.person.pose
    people = np.array([person.x, person.y]) if scene.walk is None else scene.person_poses(trajectory.times)[:, :2]
    offsets = people - poses[:, :2]
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
    """(7,) what one unit of a measure is when measures are weighed against each other, in the order of MEASURES:
    between two trajectories of the setup's queries; where nobody has measured that, what people notice.
    """
    return np.array([measure.typical.get(setup, measure.noticeable) for measure in table_of(setup)])
