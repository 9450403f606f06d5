"""What is remarkable about demonstrations: jerky speed, hardly any room, drawn twice, unlike the others. Flags only.

Whether one is left out is a person's decision, made elsewhere; nothing here drops anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.analysis.metrics import measure
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.stroke import Doubles
from desirepath.simulation.setups import CONTROL_DT_S, get_setup

# All ours. Smoothing leaves little of a wavering hand: speeds that jump between slowest and fastest ten times along a
# path of 6 m come out near 0.1 m/s^2, and slowing down near the person from fastest to slowest near 0.02.
JERKY_M_S2 = 0.08
TIGHT_M = 0.10  # between the robot's edge and things or the person
SAME_M = 0.03  # mean distance between two paths that are one and the same
OUTLYING_M = 0.6  # from every other path of the same situation, on average
PLACES = 64  # at which paths are compared


@dataclass(frozen=True)
class DemonstrationQuality:
    """One demonstration. Lengths m, times s, speeds m/s; acceleration: largest change of the executed speed, m/s^2.

    human_m, room_m: smallest distances of the robot's edge to the person's and to anything else. same_as: index of an
    earlier one of the same situation that is the same path. apart_m: mean distance to the nearest other path there,
    None for the only one. flags: of jerk, clearance, duplicate, outlier.
    """

    length_m: float
    duration_s: float
    mean_speed: float
    acceleration: float
    human_m: float
    room_m: float
    apart_m: float | None
    same_as: int | None
    flags: tuple[str, ...]


def qualities(demonstrations: Sequence[Demonstration], groups: Sequence[object]) -> list[DemonstrationQuality]:
    """One per demonstration, in order. groups: the situation (and hand) of each; paths are compared within one.

    Raises ValueError if there are not as many groups.
    """
    if len(groups) != len(demonstrations):
        raise ValueError(f"groups: {len(groups)} given for {len(demonstrations)} demonstrations")
    if not demonstrations:
        return []
    paths = [_evenly(demonstration) for demonstration in demonstrations]
    measured = measure([demonstration.trajectory for demonstration in demonstrations])
    described = []
    for i, drawn in enumerate(demonstrations):
        others = [j for j in range(len(paths)) if j != i and groups[j] == groups[i]]
        apart = {j: float(np.linalg.norm(paths[i] - paths[j], axis=1).mean()) for j in others}
        same = next((j for j in others if j < i and apart[j] < SAME_M), None)
        nearest = min(apart.values(), default=None)
        speeds = drawn.executed_speeds
        acceleration = float(np.abs(np.diff(speeds)).max(initial=0.0) / CONTROL_DT_S)
        human = (
            float(measured.min_human_distance[i])
            - drawn.drawn_in.person.radius
            - get_setup(drawn.drawn_in.setup).robot.radius_m
        )
        room = float(measured.min_obstacle_distance[i])
        flags = {
            "jerk": acceleration > JERKY_M_S2,
            "clearance": min(human, room) < TIGHT_M,
            "duplicate": same is not None,
            "outlier": nearest is not None and nearest > OUTLYING_M,
        }
        described.append(
            DemonstrationQuality(
                length_m=float(measured.path_length[i]),
                duration_s=float(measured.time[i]),
                mean_speed=float(measured.mean_speed[i]),
                acceleration=acceleration,
                human_m=human,
                room_m=room,
                apart_m=nearest,
                same_as=same,
                flags=tuple(name for name, raised in flags.items() if raised),
            )
        )
    return described


def _evenly(demonstration: Demonstration) -> Doubles:
    """(PLACES, 2) metres, evenly along the smooth path."""
    return demonstration.spline.points(np.linspace(0.0, demonstration.spline.length_m, PLACES))
