"""A robot of ir-sim, which nobody here wrote: it sees what the fast engine sees, and the same policy arrives."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.deploy.inputs import Command
from desirepath.installed import ROOT
from desirepath.simulation import setups
from desirepath.simulation.disturbed import Disturbances
from desirepath.simulation.fast import clearance_m, raw_ranges
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath_experiments.robots.irsim_robot import IrSimRobot

ROOM = draw_scenes("study_room", range(50, 53))
AHEAD = Command(1.0, 0.0)
TOOLS = Path(sys.prefix).resolve().with_name(".venv-tools") / "bin" / "python"


@pytest.fixture
def mapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """A scene of a map with two rooms, and a rectangular robot whose lidar is mounted ahead and sees 270 degrees."""
    folder = tmp_path / "two_rooms"
    folder.mkdir()
    free = np.full((60, 80), 254, dtype=np.uint8)
    free[[0, -1]] = free[:, [0, -1]] = 0
    free[:35, 40] = 0
    free[45:50, 10:20] = 205  # unknown: stops robots and rays as walls do
    Image.fromarray(free).save(folder / "map.pgm")
    (folder / "map.yaml").write_text("{image: map.pgm, resolution: 0.1, origin: [-4, -3, 0]}")
    (folder / "setup.yaml").write_text(
        "robot: {name: cart, height_m: 0.4, footprint: [[0.3, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.3, -0.2]],\n"
        "  limits: {v_min: 0.0, v_max: 0.8, w_max: 2.0},\n"
        "  lidar: {beams: 270, sectors: 54, range_m: 5.0, height_m: 0.2, field_of_view_rad: 4.712389, x_m: 0.2}}\n"
        "world: {name: building, building: {map: map.yaml}}\n"
    )
    monkeypatch.setattr(setups, "_included", [])
    setups.include(folder)
    return draw_scenes("two_rooms", [1])[0]


def off_m(scene: Scene) -> np.ndarray:
    """(poses, beams) m: by how much ir-sim's lidar differs from the engine's, turned about where it starts."""
    robot, lidar = IrSimRobot(scene), setups.get_setup(scene.setup).robot.lidar
    bearings = (np.array(lidar.bearings()) + math.pi) % (2 * math.pi) - math.pi
    off = []
    for yaw in (0.0, 0.7, -2.2):
        robot.place(scene.start.x, scene.start.y, yaw)
        scan = robot.scan()
        beams = np.round((bearings - scan.angle_min) / scan.angle_increment).astype(int)
        seen = np.minimum(scan.ranges[beams], lidar.range_m)
        off.append(np.abs(seen - raw_ranges(robot.setup, scene, Pose(scene.start.x, scene.start.y, yaw))))
    return np.array(off)


@pytest.mark.parametrize("scene", ROOM)
def test_in_a_room_every_beam_is_the_engines(scene: Scene) -> None:
    apart = off_m(scene)
    assert np.quantile(apart, 0.99) < 0.001  # a circle is a polygon there
    assert (apart > 0.02).mean() < 0.003


def test_in_a_map_too_with_a_lidar_mounted_elsewhere(mapped: Scene) -> None:
    apart = off_m(mapped)
    assert np.quantile(apart, 0.98) < 0.001
    assert (apart > 0.05).mean() < 0.01


def test_a_cart_that_drives_on_touches_a_wall_where_its_outline_does(mapped: Scene) -> None:
    robot = IrSimRobot(mapped)
    assert clearance_m(mapped, np.array([robot.pose])) > 0
    while not robot.hit and robot.now_s < 10:
        robot.drive(Command(0.8, 0.0))
    assert robot.hit
    x, y, yaw = robot.pose
    before = (x - 0.03 * math.cos(yaw), y - 0.03 * math.sin(yaw), yaw)  # a step is 1.6 cm, and a cell counts as a disc
    assert 0 < min(clearance_m(mapped, np.array([before])), _to_person(mapped, before)) < 0.06
    stopped = robot.pose
    robot.drive(Command(0.8, 1.0))
    assert robot.pose == stopped


def _to_person(scene: Scene, pose: tuple[float, float, float]) -> float:
    return math.dist(pose[:2], (scene.person.pose.x, scene.person.pose.y)) - scene.person.radius - 0.36


def test_what_is_told_is_driven_late_slow_and_astray_as_said() -> None:
    def went(**of: float) -> tuple[float, float]:
        robot = IrSimRobot(ROOM[0], Disturbances(**of), seed=3)
        robot.drive(AHEAD)
        start, (x, y, yaw) = ROOM[0].start, robot.pose
        return math.dist((x, y), (start.x, start.y)), abs(math.remainder(yaw - start.yaw, 2 * math.pi))

    assert went() == pytest.approx((0.2, 0.0), abs=1e-9)
    assert went(delay_s=0.1)[0] == pytest.approx(0.1, abs=1e-9)
    assert went(slow=0.3)[0] == pytest.approx(0.14, abs=1e-9)
    far, turned = went(slip=0.3)
    assert 0.14 < far < 0.2
    assert turned > 0.01


def test_a_small_benchmark_arrives_as_the_engine_does_and_says_what_was_observed() -> None:
    found = CliRunner().invoke(app, ["benchmark", "robot", "--scenes", "6", "--json"])
    assert found.exit_code == 0, found.output
    told = json.loads(found.stdout)
    assert told["simulated"]
    assert told["engine_success"] == told["robot_success"] == 1
    assert told["median_distance_m"] < 0.05
    assert told["median_person_m"] < 0.05
    assert told["observed"]["lidar_p99_m"] < 0.002
    assert told["observed"]["goal_m"] < 1e-6
    assert told["ended"] == {"success/success": 6}
    assert told["p99_latency_ms"] > 0
    slipping = CliRunner().invoke(app, ["benchmark", "robot", "--scenes", "1", "--slip", "0.5", "--json"])
    assert json.loads(slipping.stdout)["disturbances"]["slip"] == 0.5
    alone = CliRunner().invoke(app, ["benchmark", "robot", "--scenes", "6", "--through", "engine", "--json"])
    assert [row["engine"] for row in json.loads(alone.stdout)["rows"]] == ["success"] * 6
    assert "robot_success" not in json.loads(alone.stdout)


@pytest.mark.skipif(not TOOLS.exists(), reason="ROS comes with the tools: make setup-test")
def test_over_ros_2_the_node_drives_as_the_controller_does_and_stands_when_it_hears_nothing() -> None:
    words = ["benchmark", "robot", "--scenes", "2", "--json"]
    sources = os.pathsep.join(str(ROOT / folder) for folder in ("backend", "app", "experiments"))
    there = subprocess.run(
        [str(TOOLS), "-m", "desirepath", *words, "--through", "topics"],
        env={name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ} | {"PYTHONPATH": sources},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert there.returncode == 0, there.stderr[-4_000:]
    told, here = json.loads(there.stdout), json.loads(CliRunner().invoke(app, words).stdout)
    assert told["ended"] == here["ended"] == {"success/success": 2}
    assert told["median_distance_m"] == pytest.approx(here["median_distance_m"], abs=1e-5)
    assert told["refused"] == {}
    assert told["stop_s"]["drives"] == 2
    assert 0.2 < told["stop_s"]["longest"] < 0.301
