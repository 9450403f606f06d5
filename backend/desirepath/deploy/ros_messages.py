"""The few ROS 2 messages that are written of a run, to CDR, with their definitions. They are read by
`recordings/ros_messages.py`."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np

from desirepath.deploy.inputs import Scan

Placed = tuple[float, float, float]
"""x, y (m), yaw (rad)."""
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
POSE_ARRAY, SCAN = "geometry_msgs/msg/PoseArray", "sensor_msgs/msg/LaserScan"
COMMAND, TEXT, TRANSFORMS = "geometry_msgs/msg/TwistStamped", "std_msgs/msg/String", "tf2_msgs/msg/TFMessage"


class _Writer:
    """One message; every number is aligned to its size, counted from behind the four bytes of the header."""

    def __init__(self) -> None:
        self._parts = bytearray()

    @classmethod
    def stamped(cls, time_s: float, frame: str) -> _Writer:
        out = cls()
        out.header(time_s, frame)
        return out

    def header(self, time_s: float, frame: str) -> None:
        seconds = math.floor(time_s)
        self.put("i", 4, seconds)
        self.put("I", 4, min(round((time_s - seconds) * 1e9), 999_999_999))
        self.text(frame)

    def put(self, form: str, size: int, *values: float) -> None:
        self._parts += bytes(-len(self._parts) % size)
        self._parts += struct.pack(f"<{len(values)}{form}", *values)

    def text(self, value: str) -> None:
        raw = value.encode() + b"\0"
        self.put("I", 4, len(raw))
        self._parts += raw

    def raw(self, content: bytes) -> None:
        self._parts += content

    def pose(self, x: float, y: float, yaw: float) -> None:
        self.put("d", 8, x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    def bytes(self) -> bytes:
        return b"\x00\x01\x00\x00" + bytes(self._parts)


def encode_odometry(time_s: float, frame: str, place: Placed, speeds: Sequence[float]) -> bytes:
    """speeds: ahead, to the left (m/s), turning (rad/s), in base_link."""
    out = _Writer.stamped(time_s, frame)
    out.text("base_link")
    out.pose(*place)
    out.put("d", 8, *([0.0] * 36))
    out.put("d", 8, speeds[0], speeds[1], 0.0, 0.0, 0.0, speeds[2])
    out.put("d", 8, *([0.0] * 36))
    return out.bytes()


def encode_pose(time_s: float, frame: str, place: Placed) -> bytes:
    out = _Writer.stamped(time_s, frame)
    out.pose(*place)
    return out.bytes()


def encode_transform(time_s: float, parent: str, child: str, place: Placed) -> bytes:
    out = _Writer()
    out.put("I", 4, 1)
    out.header(time_s, parent)
    out.text(child)
    out.pose(*place)
    return out.bytes()


def encode_grid(frame: str, cells: bytes, width: int, height: int, cell_m: float, origin: Placed) -> bytes:
    out = _Writer.stamped(0.0, frame)
    out.put("I", 4, 0, 0)
    out.put("f", 4, cell_m)
    out.put("I", 4, width, height)
    out.pose(*origin)
    out.put("I", 4, len(cells))
    out.put("B", 1, *cells)
    return out.bytes()


def encode_poses(time_s: float, frame: str, places: Sequence[Placed]) -> bytes:
    out = _Writer.stamped(time_s, frame)
    out.put("I", 4, len(places))
    for place in places:
        out.pose(*place)
    return out.bytes()


def encode_scan(frame: str, scan: Scan) -> bytes:
    out = _Writer.stamped(scan.stamp_s, frame)
    end = scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment
    out.put("f", 4, scan.angle_min, end, scan.angle_increment, 0.0, 0.0, scan.range_min, scan.range_max)
    out.put("I", 4, len(scan.ranges))
    out.raw(np.asarray(scan.ranges, "<f4").tobytes())
    out.put("I", 4, 0)  # intensities
    return out.bytes()


def encode_command(time_s: float, v: float, w: float) -> bytes:
    """v: m/s ahead; w: rad/s."""
    out = _Writer.stamped(time_s, "base_link")
    out.put("d", 8, v, 0.0, 0.0, 0.0, 0.0, w)
    return out.bytes()


def encode_text(text: str) -> bytes:
    out = _Writer()
    out.text(text)
    return out.bytes()


_HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
_POSE = """
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w"""
_TWIST = """
================================================================================
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance"""
_VELOCITY = """
================================================================================
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z"""
SCHEMAS = {
    ODOMETRY: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    f"geometry_msgs/TwistWithCovariance twist{_HEADER}{_POSE}{_TWIST}{_VELOCITY}\n",
    POSE: f"std_msgs/Header header\ngeometry_msgs/Pose pose{_HEADER}{_POSE}\n",
    POSE_ARRAY: f"std_msgs/Header header\ngeometry_msgs/Pose[] poses{_HEADER}{_POSE}\n",
    SCAN: "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n"
    "float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\n"
    f"float32[] intensities{_HEADER}\n",
    COMMAND: f"std_msgs/Header header\ngeometry_msgs/Twist twist{_HEADER}{_VELOCITY}\n",
    TEXT: "string data\n",
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms\n" + "=" * 80 + "\nMSG: geometry_msgs/TransformStamped\n"
    f"std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform{_HEADER}\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
"""By type, as MCAP holds it (`ros2msg`)."""
