"""A robot's side of `desirepath drive`, in lock step: ROS's node in a process of its own, simulated time, one scan at a
time. It runs in an environment that has ROS (`scripts/setup_tools.sh`)."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from desirepath.deploy.inputs import Command, Odometry, Person, Scan

PATIENCE_S = 60
AGAIN_S = 5  # without an answer: topics of sensors may lose what they carry
TICK_S = 0.02
PERIOD_S = 0.2
ROUNDS = 3  # of scans that a supervisor wants to have heard before it starts


class TopicsController:
    """A controller at the other end of topics: its `step` is a scan's way there and its command's way back.

    refusals: why the node stood still instead, a reason each. latencies_s: from a scan to the command that answers it.
    sent_again: scans that no command answered within AGAIN_S. bundle: what `policies export` wrote.
    """

    def __init__(self, bundle: Path, arguments: Sequence[str] = ()) -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
        import rclpy
        from geometry_msgs.msg import PoseArray, PoseStamped, TwistStamped
        from nav_msgs.msg import Odometry as OdometryMessage
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import LaserScan
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        rclpy.init()
        self._rclpy, self._trigger = rclpy, Trigger
        here = f"/robot_{os.getpid()}"  # another one may drive on this machine
        self._node = node = rclpy.create_node("robot", namespace=here)
        kinds = {
            "/clock": Clock,
            "odom": OdometryMessage,
            "people": PoseArray,
            "goal_pose": PoseStamped,
            "scan": LaserScan,
        }
        self._kinds = kinds
        self._out = {name: node.create_publisher(kind, name, 10) for name, kind in kinds.items()}
        self._answers: list[Any] = []
        self._state = ""
        kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(TwistStamped, "cmd_vel", self._answers.append, 50)
        node.create_subscription(String, "desirepath/state", self._hear, kept)
        command = [sys.executable, "-m", "desirepath.deploy.ros", str(bundle), "--stamped", *arguments]
        self._process = subprocess.Popen(
            [*command, "--ros-args", "-p", "use_sim_time:=true", "-r", f"__ns:={here}", "--log-level", "error"],
            stdin=subprocess.DEVNULL,
        )
        self._now_s, self._driving, self._stood = 1.0, False, False
        self.refusals: list[str] = []
        self.latencies_s: list[float] = []
        self.scans = self.sent_again = 0
        self.observation = np.zeros(0, dtype=np.float32)  # stays with the node
        try:
            self._wait("the node", lambda: all(one.get_subscription_count() for one in self._out.values()))
            self._wait("its state", lambda: bool(self._state))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> TopicsController:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def reset(self) -> None:
        """Another scene: the node is turned off, and will be armed and started at the first step."""
        self._call("off")
        self._driving = self._stood = False

    def step(self, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Sequence[Person] = ()) -> Command:
        """What the node tells a robot that sees and does this. It stands from when the node has stopped."""
        if self._driving:
            return self._round(scan, odometry, people) if self._state.startswith("driving") else self._refused()
        self._driving = True
        self._call("arm")
        self._round(scan, odometry, people)  # says which frame odometry has
        message = self._message("goal_pose")
        message.pose.position.x, message.pose.position.y = goal
        self._out["goal_pose"].publish(message)
        for _ in range(ROUNDS):
            self._round(scan, odometry, people)
        if not (started := self._call("start")).startswith("driving"):
            self._state = started
            return self._refused()
        self._tick(TICK_S)  # what it told before it started may still be under way
        return self._tick(TICK_S)

    def silence_s(self) -> float:
        """Say nothing from the last scan on: after how long it is told to stand, s of simulated time."""
        began, told = self._now_s, Command(1.0, 0.0)
        while told != Command(0.0, 0.0) and self._now_s < began + PATIENCE_S:
            told = self._tick(TICK_S)
        return self._now_s - began

    def _refused(self) -> Command:
        if not self._stood:
            self.refusals.append(self._state)
        self._stood = True
        return Command(0.0, 0.0)

    def _round(self, scan: Scan, odometry: Odometry, people: Sequence[Person]) -> Command:
        """A control period later: odometry and people, then the time, then the scan that is answered."""
        self._tick(PERIOD_S - TICK_S)
        self._out["odom"].publish(self._odometry(odometry, self._now_s + TICK_S))
        message = self._message("people")
        for one in people:
            message.poses.append(_pose(one.x, one.y))
        self._out["people"].publish(message)
        self._tick(TICK_S)
        message = self._scan(scan)
        stamp = message.header.stamp
        del self._answers[:]
        began = again = time.perf_counter()
        self._out["scan"].publish(message)
        self.scans += 1

        def answered() -> bool:
            nonlocal again
            if any(one.header.stamp == stamp for one in self._answers):
                return True
            if time.perf_counter() - again > AGAIN_S:
                again = time.perf_counter()
                self.sent_again += 1
                self._out["scan"].publish(message)
            return False

        self._wait(f"an answer to scan {self.scans:,} (of all, {self.sent_again} were sent again)", answered)
        self.latencies_s.append(time.perf_counter() - began)
        return _command(next(one for one in self._answers if one.header.stamp == stamp))

    def _tick(self, by_s: float) -> Command:
        """Time goes on, and the node says what it commands."""
        self._now_s += by_s
        message = self._kinds["/clock"]()
        message.clock = _time(self._now_s)
        del self._answers[:]
        self._out["/clock"].publish(message)
        self._wait("what it commands", lambda: bool(self._answers))
        return _command(self._answers[-1])

    def _message(self, name: str) -> Any:
        message = self._kinds[name]()
        message.header.stamp, message.header.frame_id = _time(self._now_s), "odom"
        return message

    def _odometry(self, said: Odometry, at_s: float) -> Any:
        message = self._message("odom")
        message.header.stamp, message.child_frame_id = _time(at_s), "base_link"
        message.pose.pose = _pose(said.x, said.y, said.yaw)
        message.twist.twist.linear.x, message.twist.twist.angular.z = said.v, said.w
        return message

    def _scan(self, said: Scan) -> Any:
        message = self._message("scan")
        message.header.frame_id = "laser"
        for name in ("angle_min", "angle_increment", "range_min", "range_max"):
            setattr(message, name, float(getattr(said, name)))
        message.angle_max = said.angle_min + (len(said.ranges) - 1) * said.angle_increment
        message.ranges = said.ranges.astype(np.float32)
        return message

    def _hear(self, message: Any) -> None:
        self._state = message.data

    def _call(self, name: str) -> str:
        """One of the node's services; what came of it, in its words."""
        client = self._node.create_client(self._trigger, f"desirepath/{name}")
        self._wait(f"the service {name}", client.service_is_ready)
        asked = client.call_async(self._trigger.Request())
        self._wait(f"an answer of {name}", asked.done)
        self._node.destroy_client(client)
        return str(asked.result().message)

    def _wait(self, what: str, until: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not until():
            if (code := self._process.poll()) is not None:
                raise ChildProcessError(f"the node ended with {code} before {what} came; it was {self._state!r}")
            if time.monotonic() > end:
                raise TimeoutError(f"{what} did not come within {PATIENCE_S} s; the node: {self._state!r}")
            self._rclpy.spin_once(self._node, timeout_sec=0.05)


def _pose(x: float, y: float, yaw: float = 0.0) -> Any:
    from geometry_msgs.msg import Pose

    pose = Pose()
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return pose


def _time(at_s: float) -> Any:
    from builtin_interfaces.msg import Time

    sec, nanosec = divmod(round(at_s * 1e9), 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def _command(message: Any) -> Command:
    return Command(message.twist.linear.x, message.twist.angular.z)
