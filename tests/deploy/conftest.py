"""The server of a study with a robot, for the test in which one drives over ROS 2."""

from __future__ import annotations

from tests.web.lab_services import fresh_data
from tests.web.robot_services import robot_data, robot_lab

__all__ = ["fresh_data", "robot_data", "robot_lab"]
