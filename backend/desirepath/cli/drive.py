"""`desirepath drive POLICY`: the node of `deploy/ros`, which finds policies and robots by their names here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from desirepath.cli.output import in_data_folder
from desirepath.cli.science import policy_file

if TYPE_CHECKING:
    from desirepath.deploy.deciding import Decider
    from desirepath.deploy.ros.__main__ import RobotHere


def register(app: typer.Typer) -> None:
    """Add this module's command to the main one. Its options are read by the node's own parser."""
    further = {"allow_extra_args": True, "ignore_unknown_options": True}
    app.command(context_settings=further, add_help_option=False)(drive)


@in_data_folder
def drive(context: typer.Context) -> None:
    """Drive a robot by a policy, over ROS 2; `desirepath drive --help` says more."""
    from desirepath.deploy.ros.__main__ import main

    code = main(context.args, "desirepath drive", find_bundle, read_robot_here, decide_by)
    if code:
        raise typer.Exit(code)


def find_bundle(policy: str) -> Path | bytes:
    """An exported bundle as it is, or one of a policy: by id, path or shipped name, a conditioned one with its weights
    (`ID@farther=1`). Raises LookupError, or what a policy that no robot can be driven by raises."""
    path = Path(policy)
    if path.is_dir() or path.suffix == ".zip":
        return path
    from desirepath.learning.policies.bundles import driving_files, zipped
    from desirepath.learning.policies.policy import read_policy

    stored, weights = read_policy(policy_file(policy)), policy.partition("@")[2]
    return zipped(driving_files(stored.driving(weights) if weights else stored))


def decide_by(content: bytes) -> Decider:
    """Who decides which of several policies drives, of that policy's file. Raises PolicyError."""
    from desirepath.learning.policies.robot_choice import RobotChoice

    return RobotChoice.read(content)


def read_robot_here(file: str) -> RobotHere:
    """The robot of a robot.yaml, or a shipped one. Raises ProtocolError."""
    from desirepath.deploy.manifest import Robot
    from desirepath.deploy.ros.__main__ import RobotHere
    from desirepath.simulation.setup_files import read_robot, shipped_robots

    found = read_robot(shipped_robots().get(file, Path(file)))
    limits, lidar = found.limits, found.lidar
    return RobotHere(
        body=Robot(found.name, found.radius_m, found.footprint),
        rules={name: getattr(limits, name) for name in ("v_max", "w_max", "v_change", "w_change")},
        laser=(lidar.x_m, lidar.y_m, lidar.yaw_rad),
    )
