"""The node on ROS 2's topics, with a robot of ir-sim: it drives, stops, and survives whatever is killed beside it.

ROS lives in the tools' environment (`scripts/setup_tools.sh`), so everything that speaks it is a process of that.
"""

import json
import math
import os
import re
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.deploy.inputs import Command, InputError, Odometry, Scan
from desirepath.deploy.ros.__main__ import RULES, main, parser
from desirepath.deploy.ros.messages import moved, number_of, numbers_of
from desirepath.deploy.safety import Rules
from desirepath.installed import ROOT
from desirepath.learning.policies.bundles import bundle_files
from desirepath.learning.policies.policy import read_policy
from desirepath.learning.shipped_files import resolve
from desirepath.store.database import Database
from desirepath.store.models import RobotRun
from tests.fences import fences_of
from tests.running import until
from tests.test_fences import commands_of
from tests.web.lab_services import csrf

HERE = Path(__file__).parent
PAGE = "docs/your-robot.md"
PYTHON = Path(sys.prefix).resolve().with_name(".venv-tools") / "bin" / "python"
SOURCES = os.pathsep.join(str(ROOT / folder) for folder in ("backend", "app", "experiments"))
WORLD = ROOT / "backend/desirepath/deploy/ros/world.yaml"
needs_ros = pytest.mark.skipif(not PYTHON.exists(), reason="ROS comes with the tools: make setup-test")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("bundle")
    for name, content in bundle_files(read_policy(resolve("study_room/base").read_bytes())).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture
def ros() -> dict[str, str]:
    """An environment of ROS that nothing else on this machine hears."""
    domain = {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    kept = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    return {**kept, **domain, "PYTHONPATH": SOURCES, "MPLBACKEND": "agg"}


@needs_ros
def test_it_stands_whatever_is_killed_and_says_why(bundle, ros):
    words = [str(PYTHON), str(HERE / "robots_operator.py"), str(bundle), str(WORLD)]
    alone = ros | {"PYTHONPATH": str(bundle)}  # nothing of Desire Path but what was exported
    ran = subprocess.run(words, env=alone, capture_output=True, text=True, timeout=200)
    assert ran.returncode == 0, ran.stderr[-4_000:]
    saw = json.loads(ran.stdout.splitlines()[-1])
    assert saw["before"] == ["off: not armed yet", "not started: it is off (not armed yet); arm it first"]
    assert saw["stop topic"] == ["stopped: the stop topic says stop", "not armed: the stop topic still says stop"]
    assert re.match(r"stopped: no fresh (scan|odometry): the last \d\.\d\d s ago", saw["robot killed"])
    assert saw["told afterwards"] == [[0.0, 0.0]]
    assert saw["node ended"] == ["stopped: the node ends: signal 15", 0]
    assert saw["node killed"].startswith("driving"), (
        "it had no time to say anything; the robot's own watchdog stopped it"
    )


@needs_ros
def test_a_parameter_that_is_no_number_is_named(bundle, ros):
    command = [str(PYTHON), "-m", "desirepath.deploy.ros", str(bundle), "--ros-args", "-p"]
    ran = subprocess.run([*command, "keep_out_m:=near"], env=ros, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 1
    assert "error: parameter keep_out_m = 'near': must be a number" in ran.stderr


@needs_ros
def test_the_commands_of_the_page_drive_it_to_its_goal(ros, tmp_path):
    """Those of *In five minutes*, with somebody at the keyboard; to a goal that is near."""
    (fence,) = fences_of(PAGE, "In five minutes, without a robot")
    program, *words = commands_of(fence)[-1]
    assert program == "desirepath"
    command = [str(PYTHON), "-m", "desirepath", *words, "--goal", "0.5,-2.6", "--data", str(tmp_path)]
    with subprocess.Popen(
        command, env=ros, text=True, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as node:
        said: list[str] = []
        for line in node.stderr:
            said.append(line)
            word = {"off": "arm", "armed": "start", "not started": "start", "stopped": "arm"}.get(_state(line))
            if "stopped: arrived" in line:
                word = "quit"
            if word is not None:
                time.sleep(0.3)
                print(word, file=node.stdin, flush=True)
    assert node.returncode == 0, "".join(said)
    assert "stopped: arrived" in "".join(said), "".join(said)
    assert re.search(r"scan to command, p99: \d+\.\d+ ms", said[-1] + said[-2])


@needs_ros
def test_the_labs_order_reaches_wheels_over_ros(robot_lab, ros, tmp_path):
    """Server, robot's node and a robot on ROS 2's topics: started, steered and stopped from the lab's page."""
    token, words = robot_lab.admit(), ["drive", "--simulated", "--arm", "--v-max", "0.2"]
    robot = robot_lab.admit_id(token)
    environment = ros | {"DESIREPATH_ROBOT_TOKEN": token}
    command = [str(PYTHON), "-m", "desirepath", *words, "--from", robot_lab.url, "--data", str(tmp_path / "here")]
    mirror, database = robot_lab.services.mirror, robot_lab.services.database

    def say(name: str) -> object:
        return (mirror.latest(robot) or {}).get(name)

    assert robot_lab.press(f"{robot}/drive", setup="study_room", x="3", y="0").status_code == 303
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL) as node:
        try:
            until(lambda: say("state") == "driving", "the lab's order starts it")
            until(lambda: abs(say("speed")[0]) > 0.05, "wheels turn")
            assert say("in_map") is not None, "its world is the setup's room"
            page = f"/lab/studies/{robot_lab.study}/robots/{robot}"
            given = {"X-CSRF": csrf(robot_lab.lab, page)}
            moved = robot_lab.lab.post(f"/api{page}/weights", json={"weights": {"farther": 0.8}}, headers=given)
            assert moved.status_code == 204
            until(lambda: say("weights") == {"farther": 0.8}, "it drives by new weights")
            assert robot_lab.press(f"{robot}/stop").status_code == 303
            until(lambda: say("speed") == [0.0, 0.0] or say("run") is None, "it stands")
            with database.session() as s:
                run = s.scalars(select(RobotRun)).one()
            until(lambda: _recorded(database, run.id), "its recording was handed in")
        finally:
            node.terminate()
    robot_lab.press(f"{robot}/revoke")  # what still waits for its orders is told
    with database.session() as s:
        run = s.scalars(select(RobotRun)).one()
    assert run.moved_at is not None
    assert [stop["reason"] for stop in run.summary["stops"]][-1] == "experimenter"


def _recorded(database: Database, run: str) -> bool:
    with database.session() as s:
        return s.get_one(RobotRun, run).recording is not None


def _state(line: str) -> str:
    found = re.search(r"\[desirepath\]: (off|armed|not started|driving|stopped):", line)
    return found[1] if found else ""


def test_without_ros_it_says_what_to_install():
    result = CliRunner().invoke(app, ["drive", "study_room/base"])
    assert result.exit_code == 1
    assert 'pip install "desirepath[ros]"' in " ".join(result.output.split())


@pytest.mark.parametrize("words", [["--goal", "1"], ["--weights", "x"], ["--keep-out-m", "far"], ["--fly"]])
def test_options_that_are_none_are_named(words, capsys):
    with pytest.raises(SystemExit):
        main(["bundle", *words])
    assert words[0] in capsys.readouterr().err


def test_every_drive_of_the_page_is_one_that_there_is():
    drives = [words for fence in fences_of(PAGE, language="bash") for words in commands_of(fence) if "drive" in words]
    assert len(drives) == 5
    for words in drives:
        end = words.index("--ros-args") if "--ros-args" in words else len(words)
        asked = parser("drive").parse_args(words[2:end])
        assert asked.policy or asked.server


def test_help_says_every_rule_of_safety_with_its_number(capsys):
    with pytest.raises(SystemExit):
        main(["--help"], "desirepath drive")
    said = " ".join(capsys.readouterr().out.split())
    for rule in (
        "--keep-out-m NUMBER stand where somebody's centre is so near",
        "default: by its outline, 0.02 from it to 0.3 around them",
        "default: 0.2",
        "default: the robot's",
    ):
        assert rule in said
    assert "desirepath drive --from https://HOST" in said
    assert set(RULES) == {one.name for one in fields(Rules)} - {"stale_s", "tick_s"}


def test_the_loop_of_the_page_drives_a_robot_of_ones_own(bundle):
    """In an empty field, in which this robot does exactly as it is told."""
    (fence,) = fences_of(PAGE, "With your own stack", "python")
    told: dict = {}
    exec(fence.text, told)

    class Robot:
        now, x, y, yaw, command = 0.0, 0.0, 0.0, 0.0, Command(0.0, 0.0)

        def tell(self, v, w):
            self.command = Command(v, w)

        def odometry(self):
            self.now += 0.1
            self.yaw += self.command.w * 0.1
            self.x += self.command.v * math.cos(self.yaw) * 0.1
            self.y += self.command.v * math.sin(self.yaw) * 0.1
            return Odometry(self.now, self.x, self.y, self.yaw, self.command.v, self.command.w)

        def scan(self):
            return Scan(self.now, -math.pi, math.tau / 720, 0.0, 6.0, np.full(720, math.inf))

        def start_was_pressed(self):
            return self.now > 1

    robot = Robot()
    assert told["drive"](robot, bundle, (2.0, 1.0), clock=lambda: robot.now) == "arrived"
    assert (robot.x, robot.y) == pytest.approx((2.0, 1.0), abs=0.4)


def test_places_of_another_frame_come_into_the_odometrys():
    assert moved((1.0, 0.0), (2.0, 3.0, math.pi / 2)) == pytest.approx((2.0, 4.0))


def test_parameters_may_be_told_without_a_decimal_point():
    assert number_of("keep_out_m", 0) == 0.0
    assert numbers_of("goal", np.array([3, 1]), (0, 2)) == (3.0, 1.0)
    assert numbers_of("goal", [], (0, 2)) == ()


@pytest.mark.parametrize("value", ["near", True, None, [1.0], b"1"])
def test_parameters_that_are_no_number_are_named(value):
    with pytest.raises(InputError, match=r"parameter keep_out_m = .*: must be a number"):
        number_of("keep_out_m", value)


@pytest.mark.parametrize("value", ["here", 3.0, [1.0], [1.0, "2"], [True, 2.0], [1.0, math.nan], None])
def test_places_that_are_none_are_named(value):
    with pytest.raises(InputError, match="parameter goal"):
        numbers_of("goal", value, (0, 2))


def test_a_robot_yaml_needs_the_whole_of_desire_path(bundle, monkeypatch):
    monkeypatch.setattr("desirepath.deploy.ros.__main__._ros", lambda: None)
    with pytest.raises(InputError, match="here: --laser and the rules"):
        main([str(bundle), "--robot", "robot.yaml"])
