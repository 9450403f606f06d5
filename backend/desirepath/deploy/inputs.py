"""What a robot tells a controller, and what it is told: plain numbers, checked. No ROS, no clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_RANGES = 28_800
MOST_PEOPLE = 1_000
MOST_M = 1e6
"""Places and speeds beyond it are a mistake, not a place."""
FULL_TURN = 2 * math.pi
Pose = tuple[float, float, float]
"""x, y, metres, and yaw, radians."""


class InputError(ValueError):
    """Something of a robot that no controller can go by; names the field, the value and what would work."""


@dataclass(frozen=True, eq=False)
class Scan:
    """One turn of a lidar, as ROS's LaserScan: range k was measured at `angle_min + k * angle_increment`, radians,
    counter-clockwise from the laser's own x axis; a laser that is mounted upside down has a negative increment.

    stamp_s: when, seconds. ranges: (n,) metres; inf, or outside [range_min, range_max]: nothing seen; -inf: too near to
    be measured; NaN: invalid.
    """

    stamp_s: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.floating[Any]]

    def __post_init__(self) -> None:
        _require_finite(self, "scan", leave="ranges")
        if self.ranges.ndim != 1 or not 1 <= len(self.ranges) <= MOST_RANGES or self.ranges.dtype.kind != "f":
            raise InputError(
                f"scan field 'ranges' has shape {self.ranges.shape} of {self.ranges.dtype}: must be (n,) of floats, n "
                f"from 1 to {MOST_RANGES:,}"
            )
        turn = abs(self.angle_increment) * len(self.ranges)
        if not 0 < turn <= FULL_TURN + 2 * abs(self.angle_increment):
            raise InputError(
                f"scan field 'angle_increment' = {self.angle_increment:g}: {len(self.ranges)} ranges so far apart make "
                f"{turn:g} rad; must be above 0 and at most a turn"
            )
        if not 0 <= self.range_min < self.range_max:
            raise InputError(
                f"scan field 'range_max' = {self.range_max:g}: must be above range_min, {self.range_min:g}"
            )

    @property
    def angles(self) -> NDArray[np.float64]:
        """(n,) of each range, radians."""
        return self.angle_min + np.arange(len(self.ranges), dtype=np.float64) * self.angle_increment


@dataclass(frozen=True)
class Odometry:
    """Where a robot is and how it moves: stamp_s, seconds; x, y, metres, and yaw, radians, in one frame with the goal
    and people; v, m/s ahead; w, rad/s counter-clockwise."""

    stamp_s: float
    x: float
    y: float
    yaw: float
    v: float
    w: float

    def __post_init__(self) -> None:
        _require_finite(self, "odometry")


@dataclass(frozen=True)
class Person:
    """Where somebody is, metres, in the frame of the odometry, and how they move there, m/s, where that is known."""

    x: float
    y: float
    v_x: float = 0.0
    v_y: float = 0.0

    def __post_init__(self) -> None:
        _require_finite(self, "person")


@dataclass(frozen=True)
class Command:
    """What a robot is told: v, m/s ahead; w, rad/s counter-clockwise."""

    v: float
    w: float


def place_laser(robot: Pose, laser: Pose) -> Pose:
    """Where a lidar is that is mounted there on a robot, in the frame that the robot's pose is in."""
    x, y, yaw = robot
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * laser[0] - s * laser[1], y + s * laser[0] + c * laser[1], yaw + laser[2]


def check_goal(goal: tuple[float, float]) -> tuple[float, float]:
    """x, y, metres, in the frame of the odometry. Raises InputError."""
    x, y = goal
    if not (_is_number(x) and _is_number(y)):
        raise InputError(f"goal = {goal!r}: must be two numbers, metres")
    return float(x), float(y)


def _require_finite(of: Any, what: str, leave: str = "") -> None:
    for one in fields(of):
        value = getattr(of, one.name)
        if one.name == "stamp_s":
            if not math.isfinite(value):
                raise InputError(f"{what} field 'stamp_s' = {value!r}: must be a number, seconds")
        elif one.name != leave and not _is_number(value):
            raise InputError(f"{what} field {one.name!r} = {value!r}: must be a number within {MOST_M:g}")


def _is_number(value: float) -> bool:
    return bool(math.isfinite(value)) and (abs(value) <= MOST_M)
