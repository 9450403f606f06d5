"""What a supervised robot is told: nothing before somebody starts it, nothing beyond its limits, and 0 with the reason
as soon as something is wrong."""

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from desirepath.deploy.inputs import Command, InputError, Odometry, Person, Scan
from desirepath.deploy.manifest import Limits, Robot
from desirepath.deploy.safety import Refused, Rules, State, Supervisor, Transition
from desirepath_experiments.benchmarks.robot_safety import RobotSafetyConfig, benchmark_robot_safety

LIMITS = Limits(v_min=0.0, v_max=1.0, w_max=3.0, v_change=None, w_change=None)
STANDING = Command(0.0, 0.0)


class Scripted:
    """Commands what the test says: which policy it is does not matter to who supervises it."""

    period_s, laser = 0.2, (0.0, 0.0, 0.0)

    def __init__(self, limits: Limits, robot: Robot) -> None:
        self.limits, self.robot = limits, robot
        self.command, self.wanted, self.arrived, self.steps = STANDING, Command(0.5, 0.0), False, 0

    def reset(self) -> None:
        self.command = STANDING

    def step(self, scan, odometry, goal, people=()):
        self.steps += 1
        if isinstance(self.wanted, Exception):
            raise self.wanted
        return self.wanted


class Rig:
    """A supervised robot whose scans (10 Hz) and odometry (20 Hz) come as they should until the test says otherwise."""

    def __init__(self, limits=LIMITS, robot=Robot("disc", 0.2, None), rules=Rules(), **more):  # noqa: B008
        self.t, self.changes = 100.0, []
        self.controller = Scripted(limits, robot)
        self.supervisor = Supervisor(self.controller, lambda: self.t, rules, told=self.changes.append, **more)
        self.supervisor.goal((9.0, 0.0))
        self.scans, self.odometry, self.told = {}, {}, []
        self.scan_off = self.odometry_off = False
        self.each = lambda: None  # what else happens every 10 ms

    def scan(self, **values):
        ranges = np.full(360, 5.0)
        for degrees, metres in values.pop("at", {}).items():
            ranges[degrees % 360] = metres
        good = {
            "stamp_s": self.t,
            "angle_min": 0.0,
            "angle_increment": math.tau / 360,
            "range_min": 0.05,
            "range_max": 6.0,
        }
        self.supervisor.scan(Scan(**{**good, "ranges": ranges, **values}))

    def pass_time(self, seconds):
        for k in range(1, round(seconds / 0.01) + 1):
            self.t += 0.01
            self.each()
            if k % 10 == 0 and not self.scan_off:
                self.scan(**self.scans)
            if k % 5 == 0 and not self.odometry_off:
                good = {"stamp_s": self.t, "x": 0, "y": 0, "yaw": 0, "v": 0, "w": 0}
                self.supervisor.odometry(Odometry(**{**good, **self.odometry}))
            self.told.append((self.t, self.supervisor.tick()))

    def drive(self):
        self.supervisor.arm()
        self.pass_time(0.5)
        self.supervisor.start()
        self.pass_time(0.5)
        return self

    @property
    def stopped(self):
        """That it stands, and why."""
        assert self.supervisor.tick() == STANDING
        assert self.supervisor.state is State.STOPPED
        return self.supervisor.reason


def test_drives_by_the_controllers_commands_once_armed_and_started():
    rig = Rig().drive()
    assert rig.supervisor.tick() == Command(0.5, 0.0) == rig.controller.command
    rig.pass_time(2.0)
    assert 9 <= rig.controller.steps <= 13, "one step per control period of 0.2 s"
    assert [(change.state.value, change.reason) for change in rig.changes] == [
        ("armed", "armed by hand"),
        ("driving", "started by hand"),
    ]


def test_nothing_but_arming_and_starting_makes_it_drive():
    rig = Rig()
    rig.pass_time(1)
    with pytest.raises(Refused, match=r"it is off .*arm it first"):
        rig.supervisor.start()
    rig.supervisor.arm()
    with pytest.raises(Refused, match="no fresh scan: none yet"):
        rig.supervisor.start()
    rig.pass_time(1)
    rig.supervisor.goal((1.0, 1.0))
    assert {command for _, command in rig.told} == {STANDING}
    assert rig.controller.steps == 0
    rig.supervisor.stop("the stop topic")
    with pytest.raises(Refused, match=r"it is stopped \(the stop topic\)"):
        rig.supervisor.start()


def test_an_armed_robot_that_nobody_starts_turns_off():
    rig = Rig(rules=Rules(armed_s=2.0))
    rig.supervisor.arm()
    rig.pass_time(2.1)
    assert (rig.supervisor.state, rig.supervisor.reason) == (State.OFF, "armed for 2 s and not started")


def test_a_stop_that_is_held_lets_nobody_arm():
    rig = Rig().drive()
    rig.supervisor.hold("/stop", True)
    assert rig.stopped == "/stop says stop"
    with pytest.raises(Refused, match="/stop still says stop"):
        rig.supervisor.arm()
    rig.supervisor.hold("/stop", False)
    rig.drive()
    assert rig.supervisor.state is State.DRIVING


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (lambda rig: setattr(rig, "scan_off", True), "no fresh scan: the last 0.2[67] s ago"),
        (lambda rig: setattr(rig, "odometry_off", True), "no fresh odometry"),
        (lambda rig: rig.scans.update(ranges=np.full(360, math.nan)), "360 of 360 ranges are NaN"),
        (lambda rig: rig.scans.update(ranges=np.full(180, 5.0)), "180 ranges from 0 by .* were 360"),
        (lambda rig: rig.scans.update(angle_increment=-math.tau / 360), "by -0.01.* were 360 from 0 by 0.01"),
        (lambda rig: rig.scans.update(stamp_s=rig.t), "its time went not on"),
        (lambda rig: rig.scans.update(stamp_s=3.0), "its time went back"),
        (lambda rig: rig.scans.update(stamp_s=9e5), "its clock gained"),
        (lambda rig: rig.odometry.update(stamp_s=-9e5), "no fresh odometry.*its time went back"),
        (lambda rig: rig.odometry.update(x=30.0), "no fresh odometry.*it jumped by 30.00 m"),
        (lambda rig: rig.odometry.update(yaw=3.0), "it jumped by 0.00 m and 3.00 rad"),
        (lambda rig: rig.scans.update(stamp_s=1e18), "its clock gained"),
        (lambda rig: rig.odometry.update(v=1e5), "no fresh odometry.*the robot cannot"),
    ],
)  # fmt: skip
def test_stands_within_0_3_s_of_the_last_good_message(wrong, reason):
    rig = Rig().drive()
    wrong(rig)
    last = rig.t
    rig.pass_time(0.5)
    assert max(t for t, command in rig.told if command != STANDING) <= last + 0.3
    assert re.search(reason, rig.stopped), rig.stopped


def test_scans_that_come_ever_later_are_stale():
    rig = Rig().drive()
    for k in range(8):
        rig.scans["stamp_s"] = rig.t + 0.1 - 0.05 * k
        rig.pass_time(0.1)
    assert "s late" in rig.stopped or "no fresh scan" in rig.stopped


@pytest.mark.parametrize("command", [Command(math.nan, 0.0), Command(0.1, math.inf), ValueError("no network")])
def test_a_command_that_is_none_stops_at_once(command):
    rig = Rig().drive()
    rig.controller.wanted = command
    rig.pass_time(0.3)
    assert "commanded" in rig.stopped or "the controller failed: no network" in rig.stopped
    assert all(math.isfinite(told.v + told.w) for _, told in rig.told)


def test_no_command_beyond_limits_and_accelerations():
    limits = Limits(v_min=-0.2, v_max=0.6, w_max=1.0, v_change=1.0, w_change=2.0)
    rig = Rig(limits, rules=Rules(v_max=0.4, collision_s=0)).drive()
    for wanted in (Command(9.0, -50.0), Command(-9.0, 50.0), Command(0.3, 0.0)):
        rig.controller.wanted = wanted
        rig.pass_time(2.0)
    told = [command for _, command in rig.told]
    assert (min(c.v for c in told), max(c.v for c in told)) == pytest.approx((-0.2, 0.4))
    assert max(abs(c.w) for c in told) <= 1.0
    assert max(abs(b.v - a.v) for a, b in itertools.pairwise(told)) <= 0.2 + 1e-9
    assert max(abs(b.w - a.w) for a, b in itertools.pairwise(told)) <= 0.4 + 1e-9


def test_a_tighter_limit_keeps_the_way_and_slows_it():
    rig = Rig(rules=Rules(v_max=0.25))
    assert rig.supervisor.limited(Command(1.0, 1.2), 0.2) == Command(0.25, pytest.approx(0.3))


@pytest.mark.parametrize("v", [-1e-9, -0.3])
def test_a_robot_that_cannot_drive_back_turns_where_it_is(v):
    rig = Rig().drive()
    rig.controller.wanted = Command(v, 1.0)
    rig.pass_time(0.5)
    assert rig.supervisor.tick() == Command(0.0, 1.0)


def test_slows_down_and_stops_for_what_it_would_touch_and_says_where():
    rig = Rig().drive()
    rig.controller.wanted = Command(0.5, 0.0)
    rig.scans["at"] = {90: 0.25, 270: 0.25, 0: 1.0}
    rig.pass_time(0.4)
    assert rig.supervisor.tick() == Command(0.5, 0.0), "beside it, and far enough ahead"
    rig.scans["at"] = {0: 0.3}
    rig.pass_time(0.2)
    assert 0.2 < rig.supervisor.tick().v < 0.5
    assert rig.supervisor.state is State.DRIVING
    rig.scans["at"] = {0: 0.205}
    rig.pass_time(0.4)
    assert rig.stopped.startswith("something 0.20 m away at 0 degrees touches the robot in 0.")


def test_what_is_in_the_way_is_left_by_turning_but_not_for_ever():
    rig = Rig(rules=Rules(slowed_s=3.0))
    rig.controller.wanted, rig.scans["at"] = STANDING, {0: 0.205}
    rig.drive()
    rig.controller.wanted = Command(0.5, 1.0)
    rig.pass_time(1.0)
    assert rig.supervisor.tick() == Command(0.0, 1.0)
    rig.pass_time(3.0)
    assert rig.stopped.endswith("slowed down for 3 s")


def test_the_stop_zone_follows_the_way_it_is_commanded_also_backwards():
    rig = Rig(replace(LIMITS, v_min=-1.0))
    rig.controller.wanted = Command(-0.5, 0.0)
    rig.drive()
    rig.scans["at"] = {0: 0.3}
    rig.pass_time(0.4)
    assert rig.supervisor.state is State.DRIVING
    rig.scans["at"] = {180: 0.205}
    rig.pass_time(0.4)
    assert "at 180 degrees" in rig.stopped or "at -180 degrees" in rig.stopped


def test_a_long_robot_may_not_turn_into_what_stands_beside_it():
    long = Robot("long", 0.54, ((0.5, 0.2), (-0.5, 0.2), (-0.5, -0.2), (0.5, -0.2)))
    rig = Rig(robot=long, rules=Rules(slowed_s=1.0)).drive()
    rig.controller.wanted = Command(0.0, 0.0)
    rig.scans["at"] = {40: 0.45}
    rig.pass_time(0.5)
    assert rig.supervisor.state is State.DRIVING
    rig.controller.wanted = Command(0.0, 1.5)
    rig.pass_time(0.6)
    assert 0 < rig.supervisor.tick().w < 1.5
    rig.pass_time(1.0)
    assert "0.45 m away at 40 degrees" in rig.stopped


def test_too_near_to_be_measured_counts_as_there():
    rig = Rig().drive()
    rig.scans["at"] = {10: -math.inf}
    rig.pass_time(0.2)
    assert "at 10 degrees" in rig.stopped


BURGER = Robot("burger", 0.105, None)
WAFFLE = Robot("waffle", 0.257, ((0.077, 0.155), (-0.205, 0.155), (-0.205, -0.155), (0.077, -0.155)))
HUSKY = Robot("husky", 0.598, ((0.495, 0.335), (-0.495, 0.335), (-0.495, -0.335), (0.495, -0.335)))


@pytest.mark.parametrize(
    ("robot", "degrees", "kept"),
    [
        (BURGER, 0, 0.425),
        (BURGER, 180, 0.425),
        (Robot("turtlebot2", 0.18, None), -120, 0.5),
        (WAFFLE, 0, 0.397),
        (WAFFLE, 180, 0.525),
        (HUSKY, 0, 0.815),
        (HUSKY, 90, 0.655),
        (HUSKY, math.degrees(math.atan2(0.335, 0.495)), 0.918),
    ],
)
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_who_steps_in_stops_it_as_near_as_its_outline_allows_on_every_side(robot, degrees, kept, yaw):
    """0.32 m from a robot's outline: 0.3 m that the engines count as a collision, and 2 cm."""

    def person(metres: float) -> list[Person]:
        return [Person(3, 3), Person(metres * math.cos(towards), metres * math.sin(towards))]

    towards = yaw + math.radians(degrees)
    rig = Rig(robot=robot, rules=Rules(collision_s=0))
    rig.odometry["yaw"] = yaw
    rig.drive()
    rig.supervisor.people(person(kept + 0.006), lasting=True)
    rig.pass_time(0.3)
    assert rig.supervisor.tick() == Command(0.5, 0.0)
    rig.supervisor.people(person(kept - 0.006), lasting=True)
    assert rig.stopped == f"somebody is {kept - 0.006:.2f} m away, the keep-out distance is {kept:.3g} m"
    with pytest.raises(Refused, match="somebody is"):
        rig.drive()
    rig.supervisor.people([], lasting=True)
    rig.pass_time(1.0)
    assert rig.supervisor.tick() == STANDING, "who steps out again does not start it"


def test_a_keep_out_distance_that_is_told_is_between_centres():
    rig = Rig(robot=HUSKY, rules=Rules(keep_out_m=1.2)).drive()
    rig.supervisor.people([Person(-1.19, 0.0)], lasting=True)
    assert rig.stopped == "somebody is 1.19 m away, the keep-out distance is 1.2 m"
    rig = Rig(rules=Rules(keep_out_m=0, collision_s=0)).drive()
    rig.supervisor.people([Person(0.1, 0.0)], lasting=True)
    rig.pass_time(0.3)
    assert rig.supervisor.tick() == Command(0.5, 0.0), "0 is no keep-out distance, not the usual one"


def test_somebody_whom_the_lidar_does_not_see_is_not_driven_into():
    """At 1 m/s straight at a person it was told of, braking by 2.5 m/s^2: it slows down for them, and stands."""
    rig = Rig(robot=Robot("turtlebot2", 0.18, None))
    rig.supervisor.people([Person(3.0, 0.0)], lasting=True)
    rig.controller.wanted = Command(1.0, 0.0)
    rig.drive()
    x = v = fastest = 0.0
    for _ in range(60):
        for told in [command.v for _, command in rig.told[-10:]]:
            v += min(max(told - v, -0.025), 0.025)
            x += v * 0.01
        fastest = max(fastest, v)
        rig.odometry.update(x=x, v=v)
        rig.pass_time(0.1)
    assert re.match(r"somebody 0\.5. m away at 0 degrees is too near", rig.stopped), (
        "slowed down to it, it does not creep to where it must stand"
    )
    assert (fastest, v) == (pytest.approx(1.0), 0.0)
    assert 0.5 < 3.0 - x < 0.55
    rig.controller.wanted = Command(0.5, 1.0)
    rig.drive()
    assert rig.supervisor.tick() == Command(0.0, 1.0), "started again it turns away, though they stay"


def test_whoever_is_told_of_between_two_scans_is_in_the_stop_zone_at_once():
    rig = Rig(rules=Rules(keep_out_m=0)).drive()
    rig.scan_off = True
    rig.supervisor.people([Person(0.55, 0.0)], lasting=True)
    rig.pass_time(0.02)
    assert rig.supervisor.tick().v < 0.5 or rig.stopped.startswith("somebody 0.55 m away")
    rig.supervisor.people([Person(0.05, 0.0)], lasting=True)
    assert rig.stopped.startswith("somebody 0.05 m away at 0 degrees touches the robot")
    rig.scan_off = False
    with pytest.raises(Refused, match="touches the robot"):
        rig.drive()


def test_a_thin_outline_does_not_pass_between_people():
    """Tines 3 cm wide at 1 m/s, straight at somebody: they never touch the circle of 0.3 m."""
    tines = Robot("fork", 0.5, ((-0.5, -0.015), (0.5, -0.015), (0.5, 0.015), (-0.5, 0.015)))
    rig = Rig(robot=tines, rules=Rules(keep_out_m=0))
    rig.controller.wanted = Command(1.0, 0.0)
    rig.drive()
    rig.supervisor.people([Person(0.85, 0.02)], lasting=True)
    rig.pass_time(0.05)
    assert rig.supervisor.tick().v < 1.0 or "somebody" in rig.stopped


@pytest.mark.parametrize("slows", [1.5, None])
def test_a_long_robot_that_turns_on_the_spot_sweeps_nobody(slows):
    """Told of somebody beside it, it stops turning so early that it stands before its corner touches their circle."""
    body = ((-0.6, -0.2), (0.6, -0.2), (0.6, 0.2), (-0.6, 0.2))
    limits = Limits(v_min=0.0, v_max=1.0, w_max=1.5, v_change=None, w_change=slows)
    rig = Rig(limits, Robot("long", 0.63, body), Rules(keep_out_m=0, slowed_s=2.0))
    rig.supervisor.people([Person(0.0, 0.65)], lasting=True)
    rig.controller.wanted = Command(0.0, 1.5)
    rig.drive()
    yaw = w = 0.0
    corners = np.array(body)
    for _ in range(100):
        for told in [command.w for _, command in rig.told[-5:]]:
            w += min(max(told - w, -0.015), 0.015)
            yaw += w * 0.01
        rig.odometry.update(yaw=yaw, w=w)
        rig.pass_time(0.05)
        c, s = math.cos(yaw), math.sin(yaw)
        swept = corners @ np.array([[c, s], [-s, c]])
        assert np.hypot(swept[:, 0], swept[:, 1] - 0.65).min() > 0.3
    assert w == pytest.approx(0.0, abs=0.02)


class Wheels:
    """A robot that changes its speeds by no more than m/s^2, rad/s^2; `least`: how near it came to somebody's circle,
    metres from its outline."""

    def __init__(self, rig, slows, slows_turning=math.inf, person=(9.0, 9.0)):
        self.rig, self.most = rig, np.array([slows, slows_turning]) * 0.01
        self.person, self.least = np.array(person), math.inf
        self.pose, self.speeds = np.zeros(3), np.zeros(2)
        rig.each = self.step

    def step(self):
        told = self.rig.supervisor.command
        self.speeds += np.clip((told.v, told.w) - self.speeds, -self.most, self.most)
        v, w = self.speeds
        self.pose += np.array([v * math.cos(self.pose[2]), v * math.sin(self.pose[2]), w]) * 0.01
        self.rig.odometry.update(zip(("x", "y", "yaw", "v", "w"), (*self.pose, v, w), strict=True))
        c, s = math.cos(self.pose[2]), math.sin(self.pose[2])
        there = (self.person - self.pose[:2]) @ np.array([[c, -s], [s, c]])
        self.least = min(self.least, float(self.rig.supervisor._body.distances(there)) - 0.3)


@pytest.mark.parametrize("slows", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("seen", [True, False])
def test_a_robot_that_brakes_less_is_slowed_down_sooner_and_stands_before_it(slows, seen):
    """A wall 2 m ahead that the lidar sees, or somebody there whom it was told of."""
    rig = Rig(replace(LIMITS, v_change=slows), robot=Robot("turtlebot2", 0.18, None))
    rig.controller.wanted = Command(0.65, 0.0)
    wheels = Wheels(rig, slows)
    step = rig.each
    if seen:
        rig.each = lambda: (step(), rig.scans.update(at={0: max(2.0 - wheels.pose[0], 0.06)}))
    else:
        rig.supervisor.people([Person(2.0 + 0.3, 0.0)], lasting=True)
    rig.drive()
    rig.pass_time(14.0)
    assert rig.supervisor.state is State.STOPPED
    kept = 0.0 if seen else 0.02
    assert kept - 1e-3 < 2.0 - 0.18 - wheels.pose[0] < kept + 0.02, "it is not stopped sooner either"


@pytest.mark.parametrize("person", [(0.0, 0.75), (-0.42, 0.74), (0.42, -0.74)])
@pytest.mark.parametrize("v", [0.05, 0.12, 0.2, 0.3])
def test_a_long_robot_that_turns_as_it_drives_stands_before_its_corner_reaches_somebody(v, person):
    """Its turning brakes by 1 rad/s^2, which takes longer than its driving."""
    body = ((-0.6, -0.2), (0.6, -0.2), (0.6, 0.2), (-0.6, 0.2))
    limits = Limits(v_min=0.0, v_max=1.0, w_max=1.5, v_change=None, w_change=1.0)
    rig = Rig(limits, Robot("long", 0.63, body), Rules(keep_out_m=0))
    rig.supervisor.people([Person(*person)], lasting=True)
    rig.controller.wanted = Command(v, 1.5)
    wheels = Wheels(rig, 2.5, 1.0, person)
    rig.drive()
    rig.pass_time(4.0)
    assert wheels.least > 0


@pytest.mark.parametrize("w", [1.5, 3.0])
@pytest.mark.parametrize(("slows", "drives"), [(0.5, 0.65), (1.0, 1.0), (2.5, 1.0)])
@pytest.mark.parametrize("person", [(1.0, 0.7), (1.2, 0.8)])
def test_commanded_to_turn_alone_while_it_rolls_it_stands_before_it_reaches_somebody(slows, drives, w, person):
    """It turns at once, but rolls on, by then along an arc that nothing looked at before."""
    rig = Rig(robot=HUSKY, rules=Rules(braking=slows))
    rig.controller.wanted = STANDING
    wheels = Wheels(rig, slows, person=person)
    rig.supervisor.people([Person(*person)], lasting=True)
    rig.drive()
    rig.controller.wanted = Command(drives, 0.0)
    rig.pass_time(0.7 if drives == 1.0 else 0.9)
    assert wheels.speeds[0] > 0.3
    rig.controller.wanted = Command(0.0, w)
    rig.pass_time(3.0)
    assert wheels.least > 0


@pytest.mark.parametrize("v", [0.03, 0.1])
@pytest.mark.parametrize(("w", "person"), [(2.0, (2.1, 0.75)), (3.0, (1.8, 0.95))])
def test_commanded_to_turn_far_slower_than_it_rolls_it_stands_before_it_reaches_somebody(w, v, person):
    rig = Rig(robot=HUSKY, rules=Rules(braking=0.5))
    rig.controller.wanted = STANDING
    wheels = Wheels(rig, 0.5, person=person)
    rig.supervisor.people([Person(*person)], lasting=True)
    rig.drive()
    rig.controller.wanted = Command(1.0, 0.0)
    rig.pass_time(2.0)
    rig.controller.wanted = Command(v, w)
    rig.pass_time(2.0)
    assert wheels.least > 0


class Walker:
    """Somebody who walks, straight at the robot wherever it goes or as `velocity` says; the robot brakes by 2.5 m/s^2
    and is told of them 10 times a second, `late` s after they were seen."""

    def __init__(self, rig, at, speed=0.0, late=0.0, velocity=None):
        self.rig, self.speed, self.late, self.velocity, self.steps = rig, speed, late, velocity, 0
        self.at, self.x, self.v, self.contact, self.seen = np.array(at), 0.0, rig.supervisor.command.v, None, []
        self.least, self.speeds = math.inf, []
        rig.each = self.step

    def step(self):
        self.steps += 1
        self.v += min(max(self.rig.supervisor.command.v - self.v, -0.025), 0.025)
        self.x += self.v * 0.01
        towards = np.array([self.x, 0.0]) - self.at
        walking = self.speed * towards / np.hypot(*towards) if self.velocity is None else np.array(self.velocity)
        self.at = self.at + walking * 0.01
        self.rig.odometry.update(x=self.x, v=self.v)
        self.seen.append((self.rig.t, Person(*map(float, (*self.at, *walking)))))
        late = round(self.late / 0.01)
        if self.steps % 10 == 0 and len(self.seen) > late:
            stamp, person = self.seen[-1 - late]
            self.rig.supervisor.people([person], stamp_s=stamp)
        self.speeds.append(self.v)
        self.least = min(self.least, self.gap)
        if self.contact is None and self.gap <= 0:
            self.contact = self.v, round(self.v * (self.gap - self.gap_from(self.x + 1e-3)) / 1e-3, 3)

    @property
    def gap(self):
        return self.gap_from(self.x)

    def gap_from(self, x):
        """Metres from the robot's outline, were it there, to the circle around them."""
        return float(self.rig.supervisor._body.distances(self.at - (x, 0.0))) - 0.3

    def meet(self):
        """How fast the robot drives when they touch, and how fast towards them, m/s; None: they never met."""
        while self.contact is None and self.steps < 600:
            self.rig.pass_time(0.1)
        return self.contact


DISC = Robot("turtlebot2", 0.18, None)


def test_who_brakes_for_longer_than_anybody_looks_ahead_is_refused():
    with pytest.raises(InputError, match=r"braking = 0.02 m/s.* at most 10 s"):
        Rig(robot=HUSKY, rules=Rules(braking=0.02))
    with pytest.raises(InputError, match="at most 10 s"):
        Rig(robot=HUSKY, rules=Rules(v_change=1e-6))


@pytest.mark.parametrize("late", [0.0, 0.1])
@pytest.mark.parametrize("speed", [0.7, 1.0, 1.6])
@pytest.mark.parametrize(("robot", "drives"), [(DISC, 0.65), (WAFFLE, 0.26), (HUSKY, 1.0)])
@pytest.mark.parametrize("degrees", [0, 40, -90])
def test_it_stands_when_somebody_walks_into_it(robot, drives, degrees, speed, late):
    """They would meet after 2 s if it went on."""
    rig = Rig(robot=robot)
    rig.controller.wanted = Command(drives, 0.0)
    towards = 2 * speed * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    at = towards[0] + 2 * drives, towards[1]
    met = Walker(rig.drive(), at, speed, late).meet()
    assert met is not None or degrees
    assert met is None or met[0] == 0 or met[1] < 0, "it stands or moves away"


@pytest.mark.parametrize("told", [0.35, 1.0, 2.5])
@pytest.mark.parametrize(("robot", "drives"), [(DISC, 0.65), (HUSKY, 1.0)])
def test_who_is_told_of_as_walking_away_and_stands_is_not_driven_at(robot, drives, told):
    rig = Rig(robot=robot)
    rig.controller.wanted = Command(drives, 0.0)
    walker, tell = Walker(rig.drive(), (2.8, 0.0), velocity=(0.0, 0.0)), rig.supervisor.people
    rig.supervisor.people = lambda seen, stamp_s=None: tell(
        [replace(one, v_x=told, v_y=0.0) for one in seen], stamp_s=stamp_s
    )
    met = walker.meet()
    assert met is None or met[0] == 0


@pytest.mark.parametrize("w", [0.05, 1e-3, 1e-6, 1e-15, 5e-324])
def test_a_command_that_hardly_turns_is_looked_at_within_bounds(w):
    """While it still turns as it was told before: braking from that takes no longer way for turning less."""
    rig = Rig(robot=DISC).drive()
    rig.controller.wanted = Command(0.05, w)
    rig.odometry.update(w=0.3)
    rig.pass_time(0.4)
    assert rig.supervisor.state is State.DRIVING


def test_whatever_fails_while_it_looks_ahead_it_stands_and_says_so(monkeypatch):
    rig = Rig(robot=DISC).drive()
    monkeypatch.setattr(rig.supervisor, "_way", lambda *_: np.zeros(-1))
    rig.pass_time(0.1)
    assert (rig.supervisor.state, rig.supervisor.command) == (State.STOPPED, Command(0.0, 0.0))
    assert "it failed to look ahead" in rig.supervisor.reason


def test_it_waits_for_somebody_to_pass_and_goes_on():
    """They cross its way; nobody starts it again."""
    rig = Rig(robot=DISC)
    rig.controller.wanted = Command(0.65, 0.0)
    passer = Walker(rig.drive(), (1.7, -2.3), velocity=(0.0, 1.0))
    rig.pass_time(5.0)
    assert rig.supervisor.state is State.DRIVING
    assert passer.least > 0.02
    assert min(passer.speeds) < 0.1
    assert passer.x > 1.7


@pytest.mark.parametrize(
    "person", [(math.nan, 0.0), (0.0, -math.inf), (1e7, 0.0), (1.0, 0.0, math.nan, 0.0), (1.0, 0.0, 1e9)]
)
def test_nobody_is_nowhere_nor_walks_there(person):
    with pytest.raises(InputError, match="person field"):
        Person(*person)


def test_nobody_walks_faster_than_people_do():
    rig = Rig().drive()
    rig.supervisor.people([Person(2.5, 0.0, -9e5, 0.0), Person(-1.0, 0.0, -9e5, 9e5)])
    rig.pass_time(0.05)
    assert rig.supervisor.tick() == Command(0.5, 0.0)


def test_somebody_inside_the_robot_stops_it_however_they_walk():
    rig = Rig(robot=HUSKY).drive()
    rig.supervisor.people([Person(-0.1, 0.0, -2.0, 0.0)])
    assert rig.stopped.startswith("somebody is")


def test_more_people_than_there_can_be_stop_it_and_as_many_as_there_can_be_do_not_slow_it():
    rig = Rig(robot=HUSKY).drive()
    around = np.linspace(0, math.tau, 1_000, endpoint=False)
    rig.supervisor.people([Person(3 * math.cos(a), 3 * math.sin(a), -2 * math.cos(a), 0.0) for a in around])
    rig.pass_time(0.1)
    assert rig.supervisor.state is State.DRIVING
    rig.supervisor.people([Person(9.0, 9.0)] * 10_000)
    assert rig.stopped == "10,000 people are told of; at most 1,000 can be"


@pytest.mark.parametrize(
    ("stamp", "reason"),
    [
        (lambda t, last: last, "its time went not on"),
        (lambda t, last: last - 5, "its time went back"),
        (lambda t, last: t + 60, "its clock gained"),
    ],
)
def test_news_of_people_whose_stamps_are_wrong_counts_as_none(stamp, reason):
    rig = Rig().drive()
    last = rig.t - 3.0
    rig.supervisor.people([Person(3.0, 0.0)], stamp_s=last)
    news = rig.t
    while rig.supervisor.state is State.DRIVING and rig.t < news + 3:
        rig.supervisor.people([Person(0.1, 0.0)], stamp_s=stamp(rig.t, last))
        rig.pass_time(0.1)
    assert re.match(rf"no fresh news of people: .*({reason})", rig.stopped)
    assert rig.t <= news + 1.2


@pytest.mark.parametrize(("late", "slowed"), [(0.0, False), (0.5, True)])
def test_old_news_of_somebody_who_walks_is_where_they_are_by_now(late, slowed):
    rig = Rig(robot=DISC).drive()
    rig.supervisor.people([Person(3.0, 0.0)], stamp_s=rig.t)
    rig.pass_time(0.6)
    rig.supervisor.people([Person(1.45, 0.0, -1.0, 0.0)], stamp_s=rig.t - late)
    rig.supervisor.tick()
    assert (rig.supervisor.command.v < 0.5) is slowed


@pytest.mark.parametrize("ahead", [0.3, 0.5, 0.9])
@pytest.mark.parametrize("degrees", [0, 90, 140])
@pytest.mark.parametrize("speed", [0.7, 1.0])
def test_a_stamp_of_the_future_does_not_hide_somebody_who_walks(speed, degrees, ahead):
    """Whose news comes at once, but once with a stamp so far ahead: all later ones look that old."""
    rig = Rig(robot=DISC)
    rig.controller.wanted, tell, told = Command(0.65, 0.0), rig.supervisor.people, []

    def hear(people, stamp_s):
        told.append(stamp_s)
        tell(people, stamp_s=stamp_s + ahead * (len(told) == 2))

    walks = -speed * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    rig.drive()
    rig.supervisor.people = hear
    met = Walker(rig, (1.6 - 2 * walks[0], -2 * walks[1]), velocity=walks).meet()
    assert met is None or met[0] < 0.02 or met[1] < 0.02, "it stands or moves away"


def test_arming_forgets_the_stamps_of_people():
    rig = Rig().drive()
    rig.supervisor.people([Person(3.0, 0.0)], stamp_s=rig.t + 0.9)
    rig.supervisor.stop("by hand")
    with pytest.raises(Refused, match="no fresh news of people: none yet"):
        rig.drive()
    rig.supervisor.stop("by hand")
    rig.each = lambda: rig.supervisor.people([Person(3.0, 0.0)], stamp_s=rig.t - 0.2)
    assert rig.drive().supervisor.state is State.DRIVING


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_news_of_people_by_stamps_that_are_none_is_no_news(stamp):
    rig = Rig().drive()
    rig.supervisor.people([Person(3.0, 0.0)], stamp_s=stamp)
    assert rig.stopped == f"no fresh news of people: none yet; its stamp is {stamp}"


def test_who_stays_does_not_walk():
    rig = Rig().drive()
    rig.supervisor.people([Person(1.0, 0.0, -2.0, 0.0)], lasting=True)
    rig.pass_time(1.0)
    assert rig.supervisor.tick() == Command(0.5, 0.0)


def test_people_who_come_by_messages_must_go_on_coming():
    rig = Rig().drive()
    rig.supervisor.people([Person(3.0, 0.0)])
    rig.pass_time(1.2)
    assert rig.stopped.startswith("no fresh news of people: the last 1.0")


def test_a_policy_that_observes_people_is_not_started_before_somebody_tells_of_them():
    rig = Rig(needs_people=True)
    with pytest.raises(Refused, match="nobody said where they are"):
        rig.drive()
    rig.supervisor.people([], lasting=True)
    assert rig.drive().supervisor.state is State.DRIVING


@pytest.mark.parametrize("now", [99.0, -1e9, math.nan, -math.inf, math.inf])
def test_a_clock_that_goes_back_or_says_nothing_stops_it(now):
    rig = Rig().drive()
    rig.t = now
    assert rig.supervisor.tick() == STANDING
    assert "the clock went from" in rig.stopped


def test_news_of_people_from_before_the_clock_went_back_is_none():
    rig = Rig().drive()
    rig.supervisor.people([Person(3.0, 0.0)])
    rig.t = 10.0
    assert "the clock went from" in rig.stopped
    with pytest.raises(Refused, match="no fresh news of people"):
        rig.drive()


def test_stamps_too_huge_to_count_in_do_not_keep_a_silent_lidar_fresh():
    rig = Rig()
    rig.scans["stamp_s"] = 1e18
    rig.supervisor.arm()
    for _ in range(5):
        rig.scans["stamp_s"] += 128
        rig.pass_time(0.1)
    with pytest.raises(Refused, match="no fresh scan"):
        rig.supervisor.start()
    rig = Rig()
    rig.scan(stamp_s=1e17)
    assert rig.supervisor._scans.fresh_at <= rig.t


@pytest.mark.parametrize("scan", [{"range_max": 0.4}, {"range_min": 1.0}])
def test_a_lidar_that_does_not_see_the_stop_zone_starts_nothing(scan):
    rig = Rig()
    rig.scans.update(scan)
    with pytest.raises(Refused, match=r"the stop zone reaches to 0\.6"):
        rig.drive()


def test_when_scans_cease_it_stands_before_what_the_last_one_saw():
    """At 1 m/s, braking by 2.5 m/s^2: it needs 0.2 m, and what it saw is 0.45 m ahead of it."""
    rig = Rig(rules=Rules(braking=2.5))
    rig.controller.wanted = Command(1.0, 0.0)
    rig.drive()
    rig.scans["at"], rig.odometry["v"] = {0: 0.2 + 0.45}, 1.0
    rig.pass_time(0.1)
    assert rig.supervisor.state is State.DRIVING
    seen, rig.scan_off = rig.t, True
    rig.pass_time(0.5)
    assert "touches the robot" in rig.stopped
    driven = max(t for t, command in rig.told if command != STANDING) + 0.01 - seen
    assert driven + 1.0 / 2.5 / 2 <= 0.45


def test_when_odometry_ceases_it_stands_before_whom_it_was_told_of():
    """The same, of somebody whose circle is 0.45 m ahead of where it last said it was."""
    rig = Rig(rules=Rules(keep_out_m=0))
    rig.controller.wanted = Command(1.0, 0.0)
    rig.drive()
    rig.odometry["v"] = 1.0
    rig.pass_time(0.1)
    rig.supervisor.people([Person(0.2 + 0.3 + 0.45, 0.0)], lasting=True)
    seen, rig.odometry_off = rig.t, True
    rig.pass_time(0.5)
    driven = sum(0.01 * command.v for t, command in rig.told if t > seen)
    fastest = max(command.v for t, command in rig.told if command.v and t > seen)
    assert driven + fastest / 2.5 / 2 <= 0.45


def test_a_clock_that_stands_is_noticed_by_the_messages():
    rig = Rig().drive()
    for k in range(1, 6):
        rig.scan(stamp_s=rig.t + 0.1 * k)
        rig.supervisor.tick()
    assert "its clock gained" in rig.stopped


def test_arrives_and_waits_to_be_armed_again():
    rig = Rig().drive()
    rig.controller.wanted, rig.controller.arrived = STANDING, True
    rig.pass_time(0.3)
    assert rig.stopped == "arrived"


def test_a_goal_on_the_way_forgets_the_way_but_not_the_speed():
    limits = replace(LIMITS, v_change=0.5)
    rig = Rig(limits).drive()
    rig.pass_time(1.0)
    rig.supervisor.goal((2.0, 2.0))
    assert rig.controller.command == rig.supervisor.command == Command(0.5, 0.0)


def test_who_listens_cannot_keep_it_from_standing():
    def full(change: Transition) -> None:
        raise OSError("no space left")

    rig = Rig().drive()
    rig.supervisor._told = full
    rig.supervisor.stop("by hand")
    assert rig.stopped == "by hand (not recorded: no space left)"


@pytest.mark.parametrize("limits", [replace(LIMITS, v_min=0.1), replace(LIMITS, w_max=0.0)])
def test_refuses_a_robot_that_cannot_stand(limits):
    with pytest.raises(InputError, match="v_min <= 0 < v_max and w_max > 0 are needed"):
        Rig(limits)


@pytest.mark.parametrize("wrong", [{"v_max": 0.0}, {"stale_s": math.nan}, {"keep_out_m": -1}, {"tick_s": 0.2}])
def test_refuses_rules_that_are_none(wrong):
    with pytest.raises(InputError, match=f"rule {next(iter(wrong))}"):
        Rules(**wrong)


def test_a_few_thousand_messages_of_every_trouble_never_make_it_drive_on():
    found = benchmark_robot_safety(RobotSafetyConfig(messages=6_000, seed=3))
    counts = {key: value for key, value in found.items() if key.startswith(("commands_", "stops_without", "refusals"))}
    assert set(counts.values()) == {0}
    assert 0.2 < found["stop_s"] <= 0.3
    assert found["stop_without_news_of_people_s"] <= 1.02
    assert found["drove_s"] > 20
    assert len(found["stops_by_trouble"]) > 12
