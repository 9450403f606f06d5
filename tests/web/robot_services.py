"""A study with a robot, and a robot that drives in the fast engine's room by what the server tells it over HTTP."""

from __future__ import annotations

import math
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import Odometry, Person
from desirepath.deploy.link import Frame, Link, Orders, describe
from desirepath.deploy.predicting import predict_way
from desirepath.deploy.recorder import Recorder
from desirepath.learning.policies.bundles import scan_in
from desirepath.settings import Settings
from desirepath.simulation.scene import Pose
from desirepath.simulation.setups import get_setup
from desirepath.store.models import Study
from desirepath.study import robots
from desirepath.study.personalising.live_rollouts import scenes_of
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.running import served
from tests.study import walking
from tests.study.small_protocol import BLOCK, small_protocol
from tests.study.walking import GIVEN, Walker
from tests.web.lab_services import csrf, sign_in


def drive_stage() -> dict:
    """The step, to the goal of the room that the robot stands in."""
    scene = scenes_of("study_room")[0]
    goal = Frame(scene.start.x, scene.start.y, scene.start.yaw).into(scene.goal.x, scene.goal.y)
    return {"robot_drive": {"goal": [round(v, 3) for v in goal], "start": "learned"}}


@dataclass
class FakeRobot:
    """Drives in the first place of the study room by the bundle that it fetches and the weights that it hears of."""

    link: Link
    period_s: float = 0.02  # of the wall's clock: ten times as fast as a robot
    heard: list[tuple[float, Orders]] = field(default_factory=list)
    handed_in: list[str | None] = field(default_factory=list)
    longest: int = 400
    controllers: dict[str, Controller] = field(default_factory=dict)
    _stop: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.setup = get_setup("study_room")
        self.scene = scenes_of("study_room")[0]
        self.pose = (self.scene.start.x, self.scene.start.y, self.scene.start.yaw)
        self.thread = threading.Thread(target=self._work, daemon=True)

    def start(self) -> FakeRobot:
        self.link.open()
        self.thread.start()
        return self

    def stop(self) -> None:
        self._stop.set()
        self.thread.join(10)
        self.link.close()

    def _work(self) -> None:
        last, at_s = -1, 100.0
        while not self._stop.is_set():
            orders = self.link.orders
            if orders.number != last:
                self.heard.append((time.monotonic(), orders))
                last = orders.number
            if orders.run is not None and orders.run not in self.controllers:  # while somebody still gets ready
                self.controllers = {orders.run: Controller.load(self.link.bundle())}
            if orders.drive and orders.run is not None:
                self._drive(orders.run, at_s)
                self.pose = (self.scene.start.x, self.scene.start.y, self.scene.start.yaw)
            odometry = Odometry(at_s, *self.pose, 0.0, 0.0)
            scan = scan_in(self.setup, self.scene, Pose(*self.pose), at_s)
            self.link.say(describe(Frame.at(odometry), "armed", odometry, scan=scan))
            time.sleep(self.period_s)

    def _drive(self, run: str, at_s: float) -> None:
        controller, recorder, frame = self.controllers.pop(run), Recorder(), Frame(*self.pose)
        goal = frame.out_of(self.link.orders.goal)
        recorder.goal(at_s, goal)
        recorder.state(at_s, "driving")
        people = [Person(self.scene.person.pose.x, self.scene.person.pose.y)]
        began, last = at_s, -1
        odometry = Odometry(at_s, *self.pose, 0.0, 0.0)
        for _ in range(self.longest):
            orders = self.link.orders
            if orders.number != last:
                self.heard.append((time.monotonic(), orders))
                last = orders.number
            if orders.run != run or not orders.drive or controller.arrived:
                break
            controller.weights = orders.weights or {}
            scan = scan_in(self.setup, self.scene, Pose(*self.pose), at_s)
            command = controller.step(scan, odometry, goal, people)
            turned = self.pose[2] + 0.1 * command.w
            x = self.pose[0] + 0.2 * command.v * math.cos(turned)
            y = self.pose[1] + 0.2 * command.v * math.sin(turned)
            self.pose = (x, y, self.pose[2] + 0.2 * command.w)
            at_s += 0.2
            odometry = Odometry(at_s, *self.pose, command.v, command.w)
            recorder.scan(scan)
            recorder.odometry(odometry)
            recorder.people(at_s, people)
            recorder.command(at_s, command)
            recorder.weights(at_s, controller.weights)
            weighed = (controller.weights, 0.0)
            plan = predict_way(controller, scan, odometry, goal, people)
            self.link.say(
                describe(frame, "driving", odometry, scan=scan, goal=goal, people=people, plan=plan, driven_by=weighed)
            )
            time.sleep(self.period_s)
        reached = controller.arrived
        recorder.state(at_s, "stopped", "goal" if reached else "told to")
        stops = [(stop - began, why) for stop, why in recorder.stops]
        told = {"driven_s": at_s - began, "way_m": recorder.way_m, "reached": reached, "stops": stops}
        self.handed_in.append(self.link.over(run, **told, recording=recorder.finish()))
        while self.link.orders.run == run and not self._stop.is_set():
            self.link.wait(self.link.orders.number, 0.1)


@dataclass
class RobotLab:
    """A server with a study whose last step is a robot's drive."""

    services: Services
    url: str
    study: str
    others: str
    lab: httpx.Client

    def admit(self, name: str = "Turtle", study: str | None = None) -> str:
        """The token of a new robot."""
        page = f"/lab/studies/{study or self.study}/robots"
        answered = self.lab.post(page, data={"name": name, "csrf": csrf(self.lab, page)})
        assert answered.status_code == 200, answered.text
        return answered.text.partition('id="robot-token" value="')[2].partition('"')[0]

    def admit_id(self, token: str) -> str:
        """The robot of that token."""
        with self.services.database.session() as s:
            return robots.find_robot(s, token).id

    def skip(self, run: str) -> httpx.Response:
        """Let whoever waits go on without a drive."""
        page = f"/lab/studies/{self.study}"
        return self.lab.post(f"{page}/robot-runs/{run}/skip", data={"csrf": csrf(self.lab, f"{page}/robots")})

    def somebody(self, study: str | None = None) -> Walker:
        """A person who stands at the robot's step after two answers."""
        with self.services.database.session() as s:
            found = s.get_one(Study, study or self.study)
        walker = Walker(self.services.database, self.services.files, found)
        walker.now -= timedelta(minutes=3)  # whose clock runs ahead of ours while they watch
        walker.submit("consent", GIVEN)
        walker.walk_to("robot_drive")
        return walker

    def orders(self, token: str) -> dict:
        return httpx.get(f"{self.url}/api/robot/orders?wait=0", headers=bearer(token)).json()

    def press(self, path: str, **fields: str) -> httpx.Response:
        """Press a button of the lab's pages."""
        page = f"/lab/studies/{self.study}/robots"
        return self.lab.post(f"{page}/{path}", data={"csrf": csrf(self.lab, page), **fields})


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture(scope="session")
def robot_data(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """A data folder with two studies that end with a robot's drive; tests copy it."""
    folder = tmp_path_factory.mktemp("robots")
    data = shutil.copytree(fresh_data, folder / "data")
    queries = walking.twenty_queries(folder)
    services = build_services(Settings(data=data, _env_file=None))
    frozen = small_protocol(folder, [BLOCK, drive_stage()], query_set=str(queries))
    studies = {}
    with services.database.transaction() as s:
        for name in ("Robots", "Others"):
            study = create_study(s, services.files, frozen, name=name, created_by=None)
            studies[name] = study.id
    services.database.close()
    return data, studies


@pytest.fixture
def robot_lab(
    robot_data: tuple[Path, dict[str, str]], tmp_path: Path, database_of: Callable[[Path], str]
) -> Iterator[RobotLab]:
    data = shutil.copytree(robot_data[0], tmp_path / "data")
    services = build_services(Settings(data=data, database_url=database_of(data), _env_file=None))
    studies = robot_data[1]
    with served(create_application(services)) as url, httpx.Client(base_url=url, timeout=30) as lab:
        yield RobotLab(services, url, studies["Robots"], studies["Others"], sign_in(lab))
    services.database.close()


@pytest.fixture
def turtle(robot_lab: RobotLab) -> Iterator[FakeRobot]:
    """A robot that stands by."""
    robot = FakeRobot(Link(robot_lab.url, robot_lab.admit())).start()
    yield robot
    robot.stop()
