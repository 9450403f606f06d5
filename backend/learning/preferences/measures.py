"""What a person compares two trajectories by: seven measures of a whole trajectory, in one table.

What somebody may prefer more or less of is `objectives.py`'s. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.analysis import metrics
from backend.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]

NEAR_PERSON_M = 2.0
NEAREST_BAND_M = 0.5
CLEARANCE_CAP_M = 0.8  # ours: farther than this from obstacles is no better


@dataclass(frozen=True)
class Measure:
    """noticeable: what a person would see of it, ours, for describing query sets only. typical: by setup, standard
    deviation of the difference within a pair, over 1,500 pairs of the shipped ensemble; in the room and the corridor of
    chapter 2, which have none, over pairs of 24 trajectories of the programmed demonstrators, DWA and social cost in
    each of the four situations. Both in `unit`.
    """

    name: str
    unit: str
    noticeable: float
    typical: Mapping[str, float]


def _typical(*, study_room: float, open_field: float, room: float, corridor: float) -> dict[str, float]:
    return {"study_room": study_room, "open_field": open_field, "room": room, "corridor": corridor}


TABLE = (
    Measure("min_human_distance_m", "m", 0.2, _typical(study_room=0.431, open_field=0.592, room=0.571, corridor=0.522)),
    # All pass on one side of the corridor's person: 1.
    Measure("passing_side", "", 0.3, _typical(study_room=1.049, open_field=1.545, room=1.201, corridor=1.0)),
    Measure("min_clearance_m", "m", 0.1, _typical(study_room=0.167, open_field=0.244, room=0.206, corridor=0.338)),
    Measure("path_length_m", "m", 0.5, _typical(study_room=0.710, open_field=1.004, room=1.755, corridor=1.173)),
    Measure(
        "accumulated_angle_rad", "rad", 1.0, _typical(study_room=3.855, open_field=18.284, room=1.373, corridor=2.242)
    ),
    Measure(
        "speed_near_person_m_s", "m/s", 0.1, _typical(study_room=0.093, open_field=0.044, room=0.058, corridor=0.054)
    ),
    Measure("time_s", "s", 1.0, _typical(study_room=1.018, open_field=2.679, room=7.945, corridor=6.066)),
)
MEASURES = tuple(measure.name for measure in TABLE)


def in_order(columns: Mapping[str, NDArray[np.floating] | NDArray[np.integer]]) -> Doubles:
    """(n, 7) in the order of MEASURES, of one column (n,) for each by its name."""
    return np.stack([columns[name] for name in MEASURES], axis=1)


def measures(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, 7) in the order of MEASURES, each trajectory judged as a whole.

    passing_side: sine of the person's bearing at the closest approach, +1 straight to the robot's left.
    speed_near_person: mean speed (m/s) while within 2 m of the person, or within 0.5 m of the closest approach where
    the robot stays farther away. min_clearance is capped at 0.8 m. Raises ValueError for none.
    """
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
    """(7,) what one unit of a measure is when measures are weighed against each other, in the order of MEASURES.

    Raises KeyError for a setup in which nobody has measured that.
    """
    return np.array([measure.typical[setup] for measure in TABLE])
