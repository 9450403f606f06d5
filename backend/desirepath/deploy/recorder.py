"""A run of a robot as MCAP of ROS 2: what it was told, what it did, and why it stopped. For Rerun and Foxglove;
it comes back as a trajectory (`desirepath queries import`). Needs the package mcap.

| topic | type | |
|---|---|---|
| `/scan` | LaserScan | frame `laser`, whose place `/tf_static` says |
| `/odom`, `/tf` | Odometry, TFMessage | frame `odom` |
| `/people`, `/goal_pose` | PoseArray, PoseStamped | frame `odom` |
| `/cmd_vel` | TwistStamped | |
| `/desirepath/weights` | String | JSON: objective to weight, at every change |
| `/desirepath/state` | String | JSON: state and reason, at every change |
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from desirepath.deploy.inputs import Command, Odometry, Person, Scan
from desirepath.deploy.ros_messages import (
    COMMAND,
    ODOMETRY,
    POSE,
    POSE_ARRAY,
    SCAN,
    SCHEMAS,
    TEXT,
    TRANSFORMS,
    encode_command,
    encode_odometry,
    encode_pose,
    encode_poses,
    encode_scan,
    encode_text,
    encode_transform,
)

TOPICS = {
    "/scan": SCAN, "/odom": ODOMETRY, "/tf": TRANSFORMS, "/tf_static": TRANSFORMS, "/people": POSE_ARRAY,
    "/goal_pose": POSE, "/cmd_vel": COMMAND, "/desirepath/weights": TEXT, "/desirepath/state": TEXT,
}  # fmt: skip
LARGEST = 30 * 2**20  # bytes: servers take 32 MiB; beyond it scans are left out


class Recorder:
    """One run, kept in memory. All times are seconds of one clock, the one that stamps odometry."""

    def __init__(self, laser: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """laser: x, y (m), yaw (rad) of the lidar in base. Raises ModuleNotFoundError without the package mcap."""
        from mcap.writer import CompressionType, Writer

        self._out = io.BytesIO()
        self._writer: Any = Writer(self._out, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="desirepath")
        self._channels = {}
        for topic, kind in TOPICS.items():
            schema = self._writer.register_schema(name=kind, encoding="ros2msg", data=SCHEMAS[kind].encode())
            self._channels[topic] = self._writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
        self._laser: tuple[float, float, float] | None = laser
        self._said: dict[str, str] = {}
        self._last: Odometry | None = None
        self.way_m = 0.0
        """How far it drove, by its odometry."""
        self.stops: list[tuple[float, str]] = []
        """When it stopped, and why."""

    def scan(self, scan: Scan) -> None:
        if self._out.tell() < LARGEST:
            self._put("/scan", scan.stamp_s, encode_scan("laser", scan))

    def odometry(self, odometry: Odometry) -> None:
        at_s, place = odometry.stamp_s, (odometry.x, odometry.y, odometry.yaw)
        if self._laser is not None:
            self._put("/tf_static", at_s, encode_transform(at_s, "base_link", "laser", self._laser))
            self._laser = None
        if self._last is not None:
            self.way_m += math.hypot(odometry.x - self._last.x, odometry.y - self._last.y)
        self._last = odometry
        self._put("/odom", at_s, encode_odometry(at_s, "odom", place, (odometry.v, 0.0, odometry.w)))
        self._put("/tf", at_s, encode_transform(at_s, "odom", "base_link", place))

    def people(self, at_s: float, people: Sequence[Person]) -> None:
        self._put("/people", at_s, encode_poses(at_s, "odom", [(one.x, one.y, 0.0) for one in people]))

    def goal(self, at_s: float, goal: tuple[float, float]) -> None:
        self._put("/goal_pose", at_s, encode_pose(at_s, "odom", (*goal, 0.0)))

    def command(self, at_s: float, command: Command) -> None:
        self._put("/cmd_vel", at_s, encode_command(at_s, command.v, command.w))

    def weights(self, at_s: float, weights: Mapping[str, float]) -> None:
        """What it drives by; written where that changed."""
        self._say("/desirepath/weights", at_s, dict(weights))

    def state(self, at_s: float, state: str, reason: str = "") -> None:
        """off, armed, driving or stopped, and why; written where that changed."""
        if self._say("/desirepath/state", at_s, {"state": state, "reason": reason}) and state == "stopped":
            self.stops.append((at_s, reason))

    def finish(self) -> bytes:
        """The file. Nothing can be added afterwards."""
        self._writer.finish()
        return self._out.getvalue()

    def _say(self, topic: str, at_s: float, what: Mapping[str, Any]) -> bool:
        text = json.dumps(what, sort_keys=True)
        changed = self._said.get(topic) != text
        if changed:
            self._said[topic] = text
            self._put(topic, at_s, encode_text(text))
        return changed

    def _put(self, topic: str, at_s: float, data: bytes) -> None:
        stamp = max(0, round(at_s * 1e9))
        self._writer.add_message(self._channels[topic], log_time=stamp, data=data, publish_time=stamp)
