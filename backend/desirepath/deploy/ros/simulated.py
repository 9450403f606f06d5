"""A robot to try a policy on, in a world of ir-sim: scan, odom and people as a real one publishes them, cmd_vel obeyed.

    python -m desirepath.deploy.ros.simulated WORLD.yaml

Its wheels stop half a second after the last command, as every robot's should. Circles of the world are people.
"""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import irsim
import numpy as np
import rclpy
from geometry_msgs.msg import Pose, PoseArray, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan

STEP_S = 0.05
SCAN_EVERY = 2  # steps
PEOPLE_EVERY = 4
WATCHDOG_S = 0.5


class SimulatedRobot(Node):  # type: ignore[misc]  # rclpy has no types
    """In real time. It says so once it touches something, and stands."""

    def __init__(self, world: Path) -> None:
        super().__init__("simulated_robot")
        self._env = irsim.make(str(world), headless=True, log_level="CRITICAL")
        self._robot = self._env.robot
        self._command, self._told_at, self._steps = (0.0, 0.0), -math.inf, 0
        self._scan = self.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
        self._odometry = self.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self._people = self.create_publisher(PoseArray, "people", qos_profile_sensor_data)
        self.create_subscription(Twist, "cmd_vel", self._obey, 1)
        self.hit = False

    def _obey(self, message: Any) -> None:
        self._command, self._told_at = (message.linear.x, message.angular.z), time.monotonic()

    def step(self) -> None:
        """Drive for STEP_S, and say what is there now."""
        fresh = time.monotonic() - self._told_at <= WATCHDOG_S
        v, w = self._command if fresh and not self.hit else (0.0, 0.0)
        self._steps += 1
        looks = self._steps % SCAN_EVERY == 0
        if looks:
            self._env.step(np.array([[v], [w]]))
        else:  # the lidar takes most of the time
            self._robot.step(np.array([[v], [w]]), sensor_step=False)
            self._robot.check_collision_status()
        if self._robot.collision_flag and not self.hit:
            self.hit = True
            self.get_logger().error("the robot touched something; it stands")
        stamp = self.get_clock().now().to_msg()
        self._say_odometry(stamp)
        if looks:
            self._say_scan(stamp)
        if self._steps % PEOPLE_EVERY == 0:
            self._say_people(stamp)

    def _say_odometry(self, stamp: Any) -> None:
        (x, y, yaw), (v, w) = self._robot.state[:3, 0], self._robot.velocity[:2, 0]
        message = Odometry()
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "odom", "base_link"
        message.pose.pose.position.x, message.pose.pose.position.y = float(x), float(y)
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = float(v), float(w)
        self._odometry.publish(message)

    def _say_scan(self, stamp: Any) -> None:
        said = self._env.get_lidar_scan()
        message = LaserScan(
            angle_min=float(said["angle_min"]),
            angle_max=float(said["angle_max"]),
            angle_increment=float(said["angle_increment"]),
            range_min=float(said["range_min"]),
            range_max=float(said["range_max"]),
            scan_time=STEP_S * SCAN_EVERY,
            ranges=np.where(said["valid"], said["ranges"], np.inf).astype(np.float32),
        )
        message.header.stamp, message.header.frame_id = stamp, "laser"
        self._scan.publish(message)

    def _say_people(self, stamp: Any) -> None:
        message = PoseArray()
        message.header.stamp, message.header.frame_id = stamp, "odom"
        for one in self._env.obstacle_list:
            if one.shape == "circle":
                pose = Pose()
                pose.position.x, pose.position.y = float(one.state[0, 0]), float(one.state[1, 0])
                message.poses.append(pose)
        self._people.publish(message)


def main(world: Path, parent: int | None = None) -> None:
    """Until the process ends, or the one that started it has."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    robot = SimulatedRobot(world)
    due = time.monotonic()
    while rclpy.ok() and (parent is None or os.getppid() == parent):
        robot.step()
        due = max(due + STEP_S, time.monotonic())
        while (left := due - time.monotonic()) > 0:
            rclpy.spin_once(robot, timeout_sec=left)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else None)
    except KeyboardInterrupt:
        sys.exit(130)
