"""The node: what comes over topics goes to the supervisor, what it commands goes to the robot. It decides nothing.

scan (sensor_msgs/LaserScan), odom (nav_msgs/Odometry), goal_pose (geometry_msgs/PoseStamped), people (PoseArray),
map_to_odom (TransformStamped), stop (std_msgs/Bool) -> cmd_vel (Twist or TwistStamped), diagnostics, ~/state
(std_msgs/String). Services ~/arm, ~/start, ~/stop, ~/off (std_srvs/Trigger).
"""

from __future__ import annotations

import functools
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseArray, PoseStamped, TransformStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from desirepath.deploy.controller import Controller
from desirepath.deploy.deciding import Decider
from desirepath.deploy.inputs import Command, InputError, Odometry, Person, Scan
from desirepath.deploy.legs import find_people
from desirepath.deploy.outline import Body
from desirepath.deploy.ros.messages import Place, moved, number_of, numbers_of, odometry_of, people_of, scan_of, seconds
from desirepath.deploy.safety import Refused, Rules, State, Supervisor, Transition
from desirepath.deploy.walks import Walks

DIAGNOSED_EVERY_S = 1.0
KEPT_LATENCIES = 10_000
DECISION_IS_OLD_S = 1.5
STILL = ("arrived", "by hand")
"""Ends of reasons of stops that nothing was wrong in."""
UNSET = {"keep_out_m": -1.0}
"""Parameters' values of rules that are not told, where that is not 0: nothing is kept out then."""


class Listener(Protocol):
    """Who hears what a node hears and does: a recorder."""

    def scan(self, scan: Scan) -> None: ...
    def odometry(self, odometry: Odometry) -> None: ...
    def people(self, at_s: float, people: Sequence[Person]) -> None: ...
    def goal(self, at_s: float, goal: tuple[float, float]) -> None: ...
    def command(self, at_s: float, command: Command) -> None: ...
    def weights(self, at_s: float, weights: Mapping[str, float]) -> None: ...
    def state(self, at_s: float, state: str, reason: str) -> None: ...


@dataclass(frozen=True)
class Drive:
    """How a policy drives here. Every field but body, weights, people, nobody, in_map and legs is a parameter of the
    node too.

    goal: (x, y) in the odometry's frame, or none yet. people: where they stand; nobody: there is nobody. legs: where
    nobody tells of people, they are looked for in the scan (`deploy/legs.py`). stamped: tell
    the robot by TwistStamped, with the time of the scan that is answered. laser: where the lidar is, if not where the
    policy's was; map_to_odom: where the odometry's frame is in the map's; in_map: it is there also where that is all
    zeros, which else only says that nobody knows. body: the robot's outline, if not the one of the policy's.
    """

    goal: tuple[float, ...] = ()
    people: tuple[tuple[float, float], ...] = ()
    nobody: bool = False
    legs: bool = False
    stamped: bool = False
    laser: tuple[float, ...] = ()
    map_to_odom: tuple[float, ...] = (0.0, 0.0, 0.0)
    in_map: bool = False
    map_frame: str = "map"
    rules: Rules = field(default_factory=Rules)
    weights: Mapping[str, float] = field(default_factory=dict)
    body: Body | None = None


class DriveNode(Node):  # type: ignore[misc]  # rclpy has no types
    """One run: a bundle's `controller`, under its `supervisor`, between a robot's topics."""

    def __init__(
        self,
        bundle: Any,
        drive: Drive,
        listener: Listener | None = None,
        decides: Callable[[bytes], Decider] | None = None,
        **node: Any,
    ) -> None:
        """bundle: what `Controller.load` takes. decides: makes who decides which policy of several drives, of the
        policy's file. Raises BundleError, InputError."""
        super().__init__("desirepath", **node)
        self.drive = drive = self._with_parameters(drive)
        laser: Any = drive.laser or None
        self.controller = Controller.load(bundle, laser)
        if drive.weights:
            self.controller.weights = drive.weights
        self.decisions_s: deque[float] = deque(maxlen=KEPT_LATENCIES)
        self._thinks = ThreadPoolExecutor(1, "decides")
        self._decision: tuple[int, float, Future[int]] | None = None  # the drive that it is of, since when
        if self.controller.choices:
            self._decide_by(decides)
        self.stops: list[tuple[float, str]] = []  # when, by time.monotonic, and why
        self.latencies_s: deque[float] = deque(maxlen=KEPT_LATENCIES)
        self._listener = listener
        self._told_of_people, self._walks = False, Walks()
        simulated = bool(self.get_parameter("use_sim_time").value)
        clock = self.get_clock()
        self.now: Callable[[], float] = (lambda: clock.now().nanoseconds * 1e-9) if simulated else time.monotonic
        names = [one["name"] for one in self.controller.manifest["observation"]["layout"]]
        self.supervisor = Supervisor(
            self.controller,
            self.now,
            drive.rules,
            told=self._changed,
            needs_people=any(name.startswith(("person_", "pedestrian_")) for name in names),
            body=drive.body,
        )
        self._odom_frame, self._stamp = "", None
        self.odom_in_map: Place | None = None  # where it was told
        self._map_in_odom: Place = (0.0, 0.0, 0.0)
        if drive.in_map or any(drive.map_to_odom):
            self._be_in_map((drive.map_to_odom[0], drive.map_to_odom[1], drive.map_to_odom[2]))
        self._diagnosed_at = -math.inf
        self._connect()
        if drive.goal:
            self.set_goal((drive.goal[0], drive.goal[1]))
        if drive.people or drive.nobody:
            self.set_people([Person(x, y) for x, y in drive.people], lasting=True)
        steady = clock if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(drive.rules.tick_s, self._tick, clock=steady)

    def _connect(self) -> None:
        latest = QoSProfile(depth=1)
        self.create_subscription(LaserScan, "scan", self._scan, qos_profile_sensor_data)
        self.create_subscription(OdometryMessage, "odom", self._odometry, qos_profile_sensor_data)
        self.create_subscription(PoseStamped, "goal_pose", self._goal, latest)
        self.create_subscription(PoseArray, "people", self._people, qos_profile_sensor_data)
        self.create_subscription(TransformStamped, "map_to_odom", self._transform, latest)
        self.create_subscription(Bool, "stop", self._stop, QoSProfile(depth=10))
        kind = TwistStamped if self.drive.stamped else Twist
        self._told = self.create_publisher(kind, "cmd_vel", latest)
        self._diagnostics = self.create_publisher(DiagnosticArray, "diagnostics", QoSProfile(depth=10))
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._state = self.create_publisher(String, "~/state", kept)
        one = self.supervisor
        for name in ("arm", "start", "stop", "off"):
            self.create_service(Trigger, f"~/{name}", self._service(name))
        self._changed(Transition(self.now(), one.state, one.reason))

    def _with_parameters(self, drive: Drive) -> Drive:
        """With what launch files and `--ros-args -p` say."""
        told: dict[str, Any] = {}
        for name, counts in (("goal", (0, 2)), ("laser", (0, 3)), ("map_to_odom", (3,))):
            told[name] = numbers_of(name, self._parameter(name, list(getattr(drive, name))), counts)
        for name, kind, what in (("stamped", bool, "true or false"), ("map_frame", str, "text")):
            told[name] = self._parameter(name, getattr(drive, name))
            if not isinstance(told[name], kind):
                raise InputError(f"parameter {name} = {told[name]!r}: must be {what}")
        rules: dict[str, Any] = {}
        for one in fields(drive.rules):
            if one.name not in ("stale_s", "tick_s"):
                given, unset = getattr(drive.rules, one.name), UNSET.get(one.name, 0.0)
                value = number_of(one.name, self._parameter(one.name, unset if given is None else float(given)))
                rules[one.name] = None if one.default is None and value == unset else value
        return replace(drive, **told, rules=replace(drive.rules, **rules))

    def _parameter(self, name: str, default: Any) -> Any:
        """Of whatever type it was told: ROS itself would end a node for 0 where it expects 0.0."""
        return self.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=True)).value

    # What comes in

    def _scan(self, message: Any) -> None:
        began = time.perf_counter()
        steps = self.supervisor.steps
        try:
            scan = scan_of(message)
        except InputError as problem:
            return self.supervisor.broken("scan", str(problem))
        where = self.supervisor.where
        if self.drive.legs and not self._told_of_people and where is not None:
            self._see_people(find_people(scan, where, self.controller.laser))
        self.supervisor.scan(scan)
        self._stamp = message.header.stamp
        self._tell()
        if self.supervisor.steps > steps:
            self.latencies_s.append(time.perf_counter() - began)
        if self.controller.choices:
            self._choose_again(self.supervisor.steps > steps)
        if self._listener is not None:
            self._listener.scan(scan)

    def _decide_by(self, decides: Callable[[bytes], Decider] | None) -> None:
        if decides is None:
            return self._say("the policy is several: without the whole of Desire Path its usual one drives alone")
        try:
            self.controller.decider = decides(self.controller.content)
        except Exception as problem:  # whatever is wrong there, the usual policy drives
            return self._undecided(problem)
        self.controller.reset()
        sys.setswitchinterval(0.001)  # a scan waits no longer for whoever decides

    def _undecided(self, problem: Exception | str) -> None:
        self.controller.decider, self._decision = None, None
        self.controller.drive_by(0)
        self._say(f"who drives cannot be decided ({problem or type(problem).__name__}): the usual policy does")

    def _choose_again(self, stepped: bool) -> None:
        """Who drives on is decided beside the drive; whatever fails there, the usual policy drives."""
        one, decision = self.controller, self._decision
        if one.undecided:
            self._undecided(one.undecided)
            one.undecided = ""
        elif decision is None:
            ask = one.ask_who_drives() if stepped else None
            if ask is not None:
                self._decision = (one.drives, time.monotonic(), self._thinks.submit(self._timed, ask))
        elif decision[2].done():
            self._decision = None
            of_drive, asked_at, answer = decision
            if of_drive != one.drives or time.monotonic() - asked_at > DECISION_IS_OLD_S:
                return
            try:
                place = answer.result()
                if place != one.chosen:
                    one.drive_by(place)
                    self._say(f"drives on by policy {place} of {one.choices - 1}")
            except Exception as problem:  # it may be anything
                self._undecided(problem)

    def _timed(self, ask: Callable[[], int]) -> int:
        began = time.perf_counter()
        place = ask()
        self.decisions_s.append(time.perf_counter() - began)
        return place

    def _odometry(self, message: Any) -> None:
        self._odom_frame = message.header.frame_id
        try:
            odometry = odometry_of(message)
        except InputError as problem:
            return self.supervisor.broken("odometry", str(problem))
        self.supervisor.odometry(odometry)
        if self._listener is not None:
            self._listener.odometry(odometry)

    def _goal(self, message: Any) -> None:
        try:
            at = message.pose.position
            self.set_goal(moved((at.x, at.y), self._frame(message.header.frame_id, "goal_pose")))
        except InputError as problem:
            self.supervisor.stop(f"a goal that is none: {problem}")

    def _people(self, message: Any) -> None:
        try:
            people = people_of(message, self._frame(message.header.frame_id, "people"))
            stamp_s = seconds(message.header.stamp)
            if stamp_s:
                self.set_people(self._walks.follow(people, stamp_s), stamp_s=stamp_s)
            else:  # whoever sends it does not stamp
                self.set_people(people)
        except InputError as problem:
            self.supervisor.stop(f"people who are none: {problem}")

    def _transform(self, message: Any) -> None:
        at, turn = message.transform.translation, message.transform.rotation
        place = (at.x, at.y, 2 * math.atan2(turn.z, turn.w))
        if not all(math.isfinite(value) for value in place):
            return self.supervisor.stop(f"map_to_odom = {place}: must be numbers")
        self._be_in_map(place)

    def _be_in_map(self, place: Place) -> None:
        self.odom_in_map, self._map_in_odom = place, _inverse(place)

    def _stop(self, message: Any) -> None:
        self.supervisor.hold("the stop topic", bool(message.data))

    def _frame(self, named: str, topic: str) -> Place:
        """Where that frame is in the odometry's."""
        if named in ("", self._odom_frame):
            return (0.0, 0.0, 0.0)
        if named == self.drive.map_frame:
            return self._map_in_odom
        raise InputError(
            f"{topic} field 'frame_id' = {named!r}: must be the odometry's frame, {self._odom_frame!r}, or "
            f"{self.drive.map_frame!r}"
        )

    def set_goal(self, goal: tuple[float, float]) -> None:
        """Where to, in the odometry's frame. Raises InputError."""
        self.supervisor.goal(goal)
        if self._listener is not None:
            self._listener.goal(self._stamped(), goal)

    def set_people(self, people: Sequence[Person], lasting: bool = False, stamp_s: float | None = None) -> None:
        """Where people are, in the odometry's frame; lasting: until something else is heard; stamp_s: when they were
        there, by who tells of them. From then on their legs are not looked for."""
        self._told_of_people = True
        self._see_people(people, lasting, stamp_s)

    def _see_people(self, people: Sequence[Person], lasting: bool = False, stamp_s: float | None = None) -> None:
        self.supervisor.people(people, lasting, stamp_s)
        if self._listener is not None:
            self._listener.people(self._stamped(), people)

    def set_weights(self, weights: Mapping[str, float]) -> None:
        """Of a conditioned policy, while it drives. Raises WeightsError."""
        self.controller.weights = weights
        if self._listener is not None:
            self._listener.weights(self._stamped(), self.controller.weights)

    # Acts

    def act(self, name: str, by: str = "by hand") -> str:
        """arm, start, stop or off by somebody: what came of it, in words."""
        one = self.supervisor
        stop = functools.partial(one.stop, f"stopped {by}")
        acts: dict[str, Callable[[], None]] = {
            "arm": lambda: one.arm(by),
            "start": lambda: one.start(by),
            "stop": stop,
            "off": one.off,
        }
        try:
            acts[name]()
        except Refused as why:
            self._say(str(why))
            return str(why)
        self._tell()
        return f"{one.state.value}: {one.reason}"

    def _service(self, name: str) -> Callable[[Any, Any], Any]:
        def serve(_: Any, response: Any) -> Any:
            response.message = self.act(name)
            response.success = not response.message.startswith("not ")
            return response

        return serve

    # What goes out

    def _tick(self) -> None:
        self._tell()
        if self._decision is not None:
            self._choose_again(stepped=False)
        if self.now() - self._diagnosed_at >= DIAGNOSED_EVERY_S:
            self._diagnose()

    def _tell(self) -> None:
        """Ask the supervisor, tell the robot. A robot that is off is told nothing: others may steer it."""
        before = self.supervisor.command
        command = self.supervisor.tick()
        if self.supervisor.state is not State.OFF:
            self.publish(command)
        if self._listener is not None and command != before:
            self._listener.command(self._stamped(), command)

    def publish(self, command: Command) -> None:
        """Tell the robot."""
        message: Any = TwistStamped() if self.drive.stamped else Twist()
        twist = message
        if self.drive.stamped:
            message.header.frame_id = "base_link"
            message.header.stamp = self._stamp or self.get_clock().now().to_msg()
            twist = message.twist
        twist.linear.x, twist.angular.z = float(command.v), float(command.w)
        self._told.publish(message)

    def _changed(self, change: Transition) -> None:
        self._say(f"{change.state.value}: {change.reason}")
        self._state.publish(String(data=f"{change.state.value}: {change.reason}"))
        if self._listener is not None:
            self._listener.state(self._stamped(), change.state.value, change.reason)
        if change.state is State.STOPPED:
            self.stops.append((time.monotonic(), change.reason))
        if change.state is State.OFF:
            self.publish(Command(0.0, 0.0))
        self._diagnosed_at = -math.inf

    def _stamped(self) -> float:
        """Now, on the clock that messages have their stamps of."""
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _say(self, words: str) -> None:
        self.get_logger().info(words)

    def _diagnose(self) -> None:
        self._diagnosed_at = self.now()
        one = self.supervisor
        wrong = one.state is State.STOPPED and not one.reason.endswith(STILL)
        values = {
            "state": one.state.value,
            "v_m_s": f"{one.command.v:.3f}",
            "w_rad_s": f"{one.command.w:.3f}",
            "driven_by": self.controller.driven_by,
            **({"chosen": f"{self.controller.chosen}"} if self.controller.choices else {}),
            "scan_to_command_p99_ms": f"{self.latency_p99_ms():.2f}",
            **{f"weight_{name}": f"{value:g}" for name, value in self.controller.weights.items()},
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if wrong else DiagnosticStatus.OK,
            name="desirepath: driving",
            message=f"{one.state.value}: {one.reason}",
            hardware_id=str(self.controller.robot.name),
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def latency_p99_ms(self) -> float:
        """From a scan's arrival to the command that answers it; 0 where there was none."""
        return float(np.percentile(self.latencies_s, 99) * 1e3) if self.latencies_s else 0.0

    def decisions(self) -> str:
        """How long it took to decide who drives, in words; nothing where nobody decided."""
        if not self.decisions_s:
            return ""
        return (
            f"; who drives, p99 of {len(self.decisions_s)}: {float(np.percentile(self.decisions_s, 99) * 1e3):.0f} ms"
        )


def _inverse(frame: Sequence[float]) -> Place:
    """Where we are in a frame that is there in ours."""
    x, y, yaw = frame
    c, s = math.cos(yaw), math.sin(yaw)
    return (-c * x - s * y, s * x - c * y, -yaw)
