"""The few ROS 2 messages that are read of a recording, from CDR: plain numbers. To it: `deploy/ros_messages.py`."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from desirepath.deploy.ros_messages import ODOMETRY, POSE, POSE_ARRAY, Placed

MOST_PEOPLE = 1_000  # of one message
LONGEST_TEXT = 4_096


class CdrError(ValueError):
    """Bytes that are not the message they are said to be."""


@dataclass(frozen=True)
class Stamped:
    """time_s: of the header, 0 where it has none; frame: its frame_id; bodies: name (or "") and place of each."""

    time_s: float
    frame: str
    bodies: tuple[tuple[str, Placed], ...]


class _Cdr:
    """Reads one message; every number is aligned to its size, counted from behind the four bytes of the header."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise CdrError("is no CDR of ROS 2 (its first bytes say another encoding)")
        self._data, self._at, self._order = data[4:], 0, "<" if data[1] else ">"

    def _take(self, form: str, size: int, count: int = 1) -> tuple[float, ...]:
        begin = -(-self._at // size) * size
        if begin + size * count > len(self._data):
            raise CdrError(f"ends after {len(self._data) + 4} bytes, in the middle of a number")
        self._at = begin + size * count
        return struct.unpack_from(f"{self._order}{count}{form}", self._data, begin)

    def whole(self) -> int:
        return int(self._take("I", 4)[0])

    def doubles(self, count: int) -> tuple[float, ...]:
        return self._take("d", 8, count)

    def floats(self, count: int) -> tuple[float, ...]:
        return self._take("f", 4, count)

    def text(self) -> str:
        length = self.whole()
        if length > LONGEST_TEXT:
            raise CdrError(f"holds a text of {length} bytes; at most {LONGEST_TEXT} are read")
        raw = bytes(self._take("B", 1, length)) if length else b""  # type: ignore[arg-type]
        return raw.rstrip(b"\0").decode("utf-8", errors="replace")

    def raw(self, count: int) -> bytes:
        begin, self._at = self._at, self._at + count
        if self._at > len(self._data):
            raise CdrError(f"ends after {len(self._data) + 4} bytes, {self._at + 4} are needed")
        return self._data[begin : self._at]

    def count(self) -> int:
        found = self.whole()
        if found > MOST_PEOPLE:
            raise CdrError(f"holds {found} of something; at most {MOST_PEOPLE} are read")
        return found

    def header(self) -> tuple[float, str]:
        seconds, nanoseconds = self._take("i", 4)[0], self.whole()
        return seconds + nanoseconds * 1e-9, self.text()

    def pose(self) -> Placed:
        x, y, _, qx, qy, qz, qw = self.doubles(7)
        if not all(map(math.isfinite, (x, y, qx, qy, qz, qw))):
            return x, y, math.nan
        if abs(math.hypot(qx, qy, qz, qw) - 1) > 0.05:
            return x, y, math.nan  # no orientation: many senders leave it at zero
        return x, y, math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))


def _odometry(cdr: _Cdr) -> Stamped:
    time_s, frame = cdr.header()
    return Stamped(time_s, frame, ((cdr.text(), cdr.pose()),))


def _pose(cdr: _Cdr) -> Stamped:
    time_s, frame = cdr.header()
    return Stamped(time_s, frame, (("", cdr.pose()),))


def _poses(cdr: _Cdr) -> Stamped:
    time_s, frame = cdr.header()
    return Stamped(time_s, frame, tuple(("", cdr.pose()) for _ in range(cdr.count())))


def _people(cdr: _Cdr) -> Stamped:
    time_s, frame = cdr.header()
    found = []
    for _ in range(cdr.count()):
        name = cdr.text()
        x, y, *_ = cdr.doubles(7)  # position, velocity, reliability
        for _ in range(2):  # tagnames, tags
            for _ in range(cdr.count()):
                cdr.text()
        found.append((name, (x, y, math.nan)))
    return Stamped(time_s, frame, tuple(found))


POSE_WITH_COVARIANCE, PEOPLE = "geometry_msgs/msg/PoseWithCovarianceStamped", "people_msgs/msg/People"
DECODED: dict[str, Callable[[_Cdr], Stamped]] = {
    ODOMETRY: _odometry, POSE: _pose, POSE_WITH_COVARIANCE: _pose, POSE_ARRAY: _poses, PEOPLE: _people,
}  # fmt: skip
"""By type."""


GRID = "nav_msgs/msg/OccupancyGrid"


def decode_transforms(data: bytes) -> list[tuple[float, str, str, Placed]]:
    """Time, parent, child and where the child is, of each transform. Raises CdrError."""
    cdr, found = _Cdr(data), []
    for _ in range(cdr.count()):
        time_s, parent = cdr.header()
        child = cdr.text()
        found.append((time_s, parent, child, cdr.pose()))  # a Transform is laid out as a Pose
    return found


@dataclass(frozen=True)
class GridMessage:
    """cells: a byte each, row by row. origin: of the lower left corner."""

    frame: str
    width: int
    height: int
    cell_m: float
    origin: Placed
    cells: bytes


def decode_grid(data: bytes) -> GridMessage:
    """Raises CdrError."""
    cdr = _Cdr(data)
    _, frame = cdr.header()
    cdr.whole(), cdr.whole()  # when it was loaded
    cell_m = float(cdr.floats(1)[0])
    width, height = cdr.whole(), cdr.whole()
    origin = cdr.pose()
    return GridMessage(frame, width, height, cell_m, origin, cdr.raw(cdr.whole()))


def decode(kind: str, data: bytes) -> Stamped:
    """Raises CdrError; KeyError for a type that is not read."""
    return DECODED[kind](_Cdr(data))
