"""ROS's messages as a controller's inputs, and back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from desirepath.deploy.inputs import MOST_PEOPLE, InputError, Odometry, Person, Scan

Place = tuple[float, float, float]
"""x, y (m), yaw (rad): where one frame is in another."""


def number_of(name: str, value: object) -> float:
    """Of a parameter, with or without a decimal point. Raises InputError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"parameter {name} = {value!r}: must be a number")
    return float(value)


def numbers_of(name: str, value: Any, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Of a parameter that is as many numbers as one of the counts. Raises InputError."""
    told = value if isinstance(value, str) or not hasattr(value, "__iter__") else list(value)
    if not isinstance(told, list) or len(told) not in counts:
        raise InputError(f"parameter {name} = {told!r}: must be {counts[-1]} numbers, as [1.0, 2.0]")
    numbers = tuple(number_of(name, one.item() if isinstance(one, np.generic) else one) for one in told)
    if not all(math.isfinite(one) for one in numbers):
        raise InputError(f"parameter {name} = {told!r}: must be finite")
    return numbers


def seconds(stamp: Any) -> float:
    """Of a builtin_interfaces/Time."""
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def scan_of(message: Any) -> Scan:
    """Of a sensor_msgs/LaserScan. Raises InputError."""
    return Scan(
        stamp_s=seconds(message.header.stamp),
        angle_min=message.angle_min,
        angle_increment=message.angle_increment,
        range_min=message.range_min,
        range_max=message.range_max,
        ranges=np.asarray(message.ranges, dtype=np.float32),
    )


def odometry_of(message: Any) -> Odometry:
    """Of a nav_msgs/Odometry. Raises InputError, also where its orientation is none."""
    at, twist = message.pose.pose, message.twist.twist
    return Odometry(
        stamp_s=seconds(message.header.stamp),
        x=at.position.x,
        y=at.position.y,
        yaw=_yaw(at.orientation),
        v=twist.linear.x,
        w=twist.angular.z,
    )


def people_of(message: Any, frame: Place) -> list[Person]:
    """Of a geometry_msgs/PoseArray; frame: where its frame is in the odometry's. Raises InputError."""
    if len(message.poses) > MOST_PEOPLE:
        raise InputError(f"people: {len(message.poses):,} of them; at most {MOST_PEOPLE:,}")
    return [Person(*moved((pose.position.x, pose.position.y), frame)) for pose in message.poses]


def moved(place: tuple[float, float], frame: Place) -> tuple[float, float]:
    """A place that was told in another frame, which is there in ours."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    return frame[0] + c * place[0] - s * place[1], frame[1] + s * place[0] + c * place[1]


def _yaw(q: Any) -> float:
    if not abs(math.hypot(q.x, q.y, q.z, q.w) - 1) < 0.1:
        raise InputError(f"odometry field 'orientation' = ({q.x:g}, {q.y:g}, {q.z:g}, {q.w:g}): must have the length 1")
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
