"""Whoever operates a robot, as a program of ROS's environment: starts robot and node, drives, stops, kills either side,
and writes what it saw as JSON on stdout. `test_node.py` runs it.

    python robots_operator.py BUNDLE WORLD
"""

import json
import subprocess
import sys
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

PATIENCE_S = 40
"""How long something may take on a busy machine."""


class Operator(Node):
    def __init__(self) -> None:
        super().__init__("operator")
        self.odometry, self.commands, self.states = Odometry(), [], []
        self.create_subscription(Odometry, "odom", lambda m: setattr(self, "odometry", m), qos_profile_sensor_data)
        self.create_subscription(Twist, "cmd_vel", self.commands.append, 10)
        kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, "desirepath/state", lambda m: self.states.append(m.data), kept)
        self.stop = self.create_publisher(Bool, "stop", 10)

    def wait(self, what: str, until: Any) -> None:
        end = time.monotonic() + PATIENCE_S
        while not until():
            if time.monotonic() > end:
                raise TimeoutError(f"{what}; states: {self.states}")
            rclpy.spin_once(self, timeout_sec=0.05)

    def call(self, name: str) -> Any:
        client = self.create_client(Trigger, f"desirepath/{name}")
        self.wait(f"the service {name}", client.service_is_ready)
        asked = client.call_async(Trigger.Request())
        self.wait(f"an answer of {name}", asked.done)
        self.destroy_client(client)
        return asked.result()

    def drive(self) -> None:
        """Until it moves; armed and started again where a busy machine kept scans back meanwhile."""
        end = time.monotonic() + PATIENCE_S
        while abs(self.odometry.twist.twist.linear.x) < 0.2:
            if time.monotonic() > end:
                raise TimeoutError(f"it does not drive; states: {self.states}")
            if not self.states or not self.states[-1].startswith(("armed", "driving")):
                self.call("arm")
            if not self.states or not self.states[-1].startswith("driving"):
                self.call("start")
            for _ in range(10):
                rclpy.spin_once(self, timeout_sec=0.05)

    def drive_to_stop_topic(self) -> None:
        """Again where a busy machine kept scans back just then: it stood for want of one before it heard the topic."""
        for _ in range(5):
            self.drive()
            self.stop.publish(Bool(data=True))
            self.wait("that it stops", self.stopped)
            self.wait("that it stands", lambda: self.stands)
            if "no fresh" not in self.states[-1]:
                return
            self.stop.publish(Bool(data=False))

    @property
    def stands(self) -> bool:
        return self.odometry.twist.twist.linear.x == 0

    def stopped(self) -> bool:
        return bool(self.states) and self.states[-1].startswith("stopped")


def main(bundle: str, world: str) -> dict[str, Any]:
    rclpy.init()
    one, saw = Operator(), {}
    simulated = [sys.executable, "-m", "desirepath.deploy.ros.simulated", world]
    robot = subprocess.Popen(simulated)
    driving = [sys.executable, "-m", "desirepath.deploy.ros", bundle, "--goal", "-0.6,4.2"]
    driving += ["--ros-args", "-p", "slowed_s:=10", "-p", "people_stale_s:=1"]  # ROS takes them for ints
    node = subprocess.Popen(driving)
    try:
        one.wait("the node", lambda: bool(one.states))
        saw["before"] = [one.states[-1], one.call("start").message]
        one.drive_to_stop_topic()
        saw["stop topic"] = [one.states[-1], one.call("arm").message]
        one.stop.publish(Bool(data=False))
        one.drive()
        robot.kill()
        one.wait("that the node stops", one.stopped)
        saw["robot killed"] = one.states[-1]
        del one.commands[:]
        one.wait("commands", lambda: len(one.commands) > 3)
        saw["told afterwards"] = sorted({(m.linear.x, m.angular.z) for m in one.commands})
        robot = subprocess.Popen(simulated)
        one.odometry = Odometry()
        one.drive()
        node.terminate()
        one.wait("that it stands", lambda: one.stands)
        saw["node ended"] = [one.states[-1], node.wait(PATIENCE_S)]
        del one.states[:]
        node = subprocess.Popen(driving)
        one.wait("another node", lambda: bool(one.states))
        one.drive()
        node.kill()
        one.wait("that the robot stands by itself", lambda: one.stands)
        saw["node killed"] = one.states[-1]
    finally:
        robot.kill()
        node.kill()
    return saw


if __name__ == "__main__":
    print(json.dumps(main(*sys.argv[1:])))
