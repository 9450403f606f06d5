"""`python -m desirepath.deploy.ros BUNDLE`: drive a robot by an exported policy, with the robot's own ROS 2 or PyPI's.

`desirepath drive POLICY` is the same, and finds policies and robots by their names too.
"""

from __future__ import annotations

import argparse
import functools
import gc
import math
import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from desirepath.deploy.deciding import Decider
from desirepath.deploy.inputs import InputError
from desirepath.deploy.outline import APART_M, PERSON_M, Body
from desirepath.deploy.safety import Rules

WORDS = ("arm", "start", "stop", "off", "quit")
TOKEN = "DESIREPATH_ROBOT_TOKEN"  # noqa: S105  (the name of a variable)
HELP = "arm, start, stop (or only Enter), off, quit"
WORLD, GOAL = Path(__file__).with_name("world.yaml"), (-0.6, 4.2)
RULES = {
    "people_stale_s": "stand where people come by messages and there were none for so long, s",
    "keep_out_m": "stand where somebody's centre is so near to the robot's, m; 0: by the stop zone alone",
    "collision_s": "slow down, or stand, where it would touch something so soon, s; 0: never",
    "braking": "how hard it brakes, m/s^2, for that",
    "slowed_s": "stand after it was slowed down for so long, s",
    "armed_s": "be off after it was armed and not started for so long, s",
    "v_max": "fastest, m/s",
    "w_max": "fastest turn, rad/s",
    "v_change": "largest change of speed, m/s^2",
    "w_change": "largest change of turning, rad/s^2",
}
EXAMPLES = """examples:
  {prog} POLICY --simulated                                a robot of ir-sim, to try it
  {prog} POLICY --goal 3,1.5 --nobody --v-max 0.15         slowly, 3 m ahead and 1.5 m to the left
  {prog} POLICY --record drive.mcap --once --ros-args -r scan:=/front/scan
  {prog} --from https://HOST --token-file FILE             as a study's robot"""
NO_ROS = (
    "ROS 2 is not to be found here: {problem}. On a robot: source /opt/ros/DISTRO/setup.bash and use its own Python. "
    'Elsewhere (Python 3.11, Linux): pip install "desirepath[ros]", in an environment of its own'
)


@dataclass(frozen=True)
class RobotHere:
    """A robot that is not the policy's: its outline, its limits (names of rules), where its lidar is."""

    body: Body
    rules: Mapping[str, float | None]
    laser: tuple[float, float, float]


def parser(prog: str) -> argparse.ArgumentParser:
    """What may be asked for."""
    made = argparse.ArgumentParser(
        prog=prog,
        epilog=EXAMPLES.format(prog=prog),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Drive a robot by a policy, over ROS 2. It stands until you arm and start it, with the words\n"
        f"{HELP},\nor by the services of these names. After --ros-args: remappings and parameters, as for\nevery node.",
    )
    add, named = made.add_argument, "a bundle (folder or zip) that `desirepath policies export` wrote"
    if prog.startswith("desirepath"):
        named += ", or a policy of this installation: its id, or a shipped name as study_room/base"
    add("policy", metavar="POLICY", nargs="?", help=named)
    add("--from", dest="server", metavar="URL", help="a server's robot instead: its runs, as its lab starts them")
    add("--token-file", type=Path, metavar="FILE", help=f"what the lab's page Robots told; else the variable {TOKEN}")
    add("--participant", metavar="CODE", help="with --from: only this participant's policy, driven from here")
    add("--arm", action="store_true", help="with --from: be armed as a run begins, so that the server alone starts it")
    add("--record", type=Path, metavar="FILE", help="write the drive as MCAP (needs the package mcap)")
    add("--goal", type=_numbers(2), metavar="X,Y", help="where to, in the odometry's frame; else by goal_pose")
    add("--weights", type=_weights, default={}, metavar="NAME=W,...", help="of a policy that takes weights")
    add("--person", type=_numbers(2), action="append", default=[], metavar="X,Y", help="who stands there; may repeat")
    add("--nobody", action="store_true", help="there is nobody, whatever the policy observes")
    add("--legs", action="store_true", help="look for people's legs in the scan where nobody tells of people; simple")
    add("--robot", metavar="FILE", help="the robot.yaml of a robot that is not the policy's")
    add("--laser", type=_numbers(3), metavar="X,Y,YAW", help="where its lidar is, m and rad, if not as in the policy's")
    add(
        "--map-to-odom",
        type=_numbers(3),
        metavar="X,Y,YAW",
        help="where the odometry's frame is in the map's, where the two are not the same",
    )
    add("--stamped", action="store_true", help="tell the robot by TwistStamped, not by Twist")
    add("--once", action="store_true", help="end when the robot has driven and stands; exit code 0 where it arrived")
    add(
        "--simulated",
        nargs="?",
        const=str(WORLD),
        metavar="WORLD",
        help="with a robot of ir-sim, in that world or ours",
    )
    rules = made.add_argument_group("rules of safety")
    for one in fields(Rules):
        if one.name not in ("stale_s", "tick_s"):
            said = "the robot's" if one.default is None else f"{one.default:g}"
            if one.name == "keep_out_m":
                said = f"by its outline, {APART_M:g} from it to {PERSON_M:g} around them"
            rules.add_argument(
                f"--{one.name.replace('_', '-')}",
                type=float,
                metavar="NUMBER",
                help=f"{RULES[one.name]}; default: {said}",
            )
    return made


def main(
    arguments: Sequence[str],
    prog: str = "python -m desirepath.deploy.ros",
    find: Callable[[str], Path | bytes] = Path,
    read_robot: Callable[[str], RobotHere] | None = None,
    decides: Callable[[bytes], Decider] | None = None,
) -> int:
    """Drive until somebody ends it; the exit code. find: what `Controller.load` takes, of the policy's name.
    decides: as of a `DriveNode`. Raises ValueError for what cannot be driven by, RuntimeError where ROS is missing."""
    end = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    asked = parser(prog).parse_args(_with_negatives(arguments[:end]))
    if (asked.policy is None) == (asked.server is None):
        raise InputError("POLICY or --from URL is needed, one of them")
    ros, here = _ros(), None
    if asked.robot is not None:
        if read_robot is None:
            raise InputError("--robot reads robot.yaml with the whole of Desire Path; here: --laser and the rules")
        here = read_robot(asked.robot)
    link = _link(asked) if asked.server else None
    bundle = None if asked.policy is None else find(asked.policy)
    if link is not None and asked.participant:
        bundle, link = _told(functools.partial(link.bundle, asked.participant)), None
    with _simulated(asked) as goal:
        drive = ros.Drive(
            goal=asked.goal or goal,
            people=tuple(asked.person),
            nobody=asked.nobody,
            legs=asked.legs,
            stamped=asked.stamped,
            laser=asked.laser or (here.laser if here else ()),
            map_to_odom=asked.map_to_odom or (0.0, 0.0, 0.0),
            in_map=asked.map_to_odom is not None or bool(goal),
            rules=_rules(asked, here),
            weights=asked.weights,
            body=here.body if here else None,
        )
        with _Ros(list(arguments[end:])) as session:
            if link is not None:
                return session.runs(
                    link, lambda bundle, recorder: ros.DriveNode(bundle, drive, recorder, decides), asked.arm
                )
            recorder = _recorder(drive.laser) if asked.record else None
            node = ros.DriveNode(bundle, drive, recorder, decides)
            session.drive(node, _once if asked.once else lambda node: False)
            if recorder is not None:
                asked.record.write_bytes(recorder.finish())
            return int(asked.once and node.supervisor.reason != "arrived")


def _once(node: Any) -> bool:
    return bool(node.stops)


def _link(asked: argparse.Namespace) -> Any:
    from desirepath.deploy.link import Link

    token = asked.token_file.read_text(encoding="utf-8") if asked.token_file else os.environ.get(TOKEN, "")
    if not token.strip():
        raise InputError(f"--from needs the robot's token: --token-file FILE, or the variable {TOKEN}")
    return _told(lambda: Link(asked.server, token.strip()))


def _told(ask: Callable[[], Any]) -> Any:
    """What a server answers. Raises RuntimeError with what it says where it refuses."""
    from desirepath.deploy.link import LinkError

    try:
        return ask()
    except LinkError as problem:
        raise RuntimeError(str(problem)) from None


def _recorder(laser: Any) -> Any:
    from desirepath.deploy.recorder import Recorder

    try:
        return Recorder(laser or (0.0, 0.0, 0.0))
    except ModuleNotFoundError:
        raise InputError("--record needs the package mcap: pip install mcap") from None


def _ros() -> Any:
    try:
        from desirepath.deploy.ros import node
    except ImportError as problem:
        raise RuntimeError(NO_ROS.format(problem=problem)) from None
    return node


def _rules(asked: argparse.Namespace, here: RobotHere | None) -> Rules:
    told = dict(here.rules) if here else {}
    told |= {one.name: value for one in fields(Rules) if (value := getattr(asked, one.name, None)) is not None}
    return Rules(**told)  # type: ignore[arg-type]


class _Ros:
    """rclpy, what somebody writes on the terminal, and the signals that end it, while the block lasts."""

    def __init__(self, arguments: list[str]) -> None:
        self._arguments, self._ended = arguments, ""

    def __enter__(self) -> _Ros:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        def end(number: int, _: Any) -> None:
            self._ended = self._ended or f"signal {number}"

        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        self._before = {number: signal.signal(number, end) for number in numbers}
        rclpy.init(args=self._arguments, signal_handler_options=SignalHandlerOptions.NO)
        self._words = _hear()
        return self

    def __exit__(self, *_: object) -> None:
        import rclpy

        rclpy.shutdown()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def drive(self, node: Any, over: Callable[[Any], bool]) -> None:
        """Spin a node until it is over, somebody writes `quit`, or a signal comes. Then the robot is told to stand."""
        from rclpy.executors import SingleThreadedExecutor

        try:
            executor = SingleThreadedExecutor()
            executor.add_node(node)
            node.get_logger().info(f"say: {HELP}")
            gc.freeze()
            while not self._ended and not over(node):
                executor.spin_once(timeout_sec=0.1)
                while not self._words.empty():
                    self._act(node, self._words.get())
            node.get_logger().info(f"scan to command, p99: {node.latency_p99_ms():.2f} ms{node.decisions()}")
        finally:
            node.supervisor.stop(f"the node ends: {self._ended or 'it is done'}")
            for _ in range(3):
                node.publish(node.supervisor.command)
                time.sleep(0.01)
            node.destroy_node()

    def _act(self, node: Any, word: str) -> None:
        if word == "quit":
            self._ended = word
        elif word in WORDS:
            node.act(word)
        else:
            node.get_logger().warning(f"{word[:40]!r} is no word here; say: {HELP}")

    def runs(self, link: Any, make: Callable[[bytes, Any], Any], arms: bool) -> int:
        """Drive what a server asks for, run after run. Raises RuntimeError where there is no bundle."""
        from desirepath.deploy.ros.linked import LinkedRun, recorder_for

        print(f"{_told(link.about)['robot']} waits for runs of {link.url}", file=sys.stderr)
        link.open()
        done: str | None = None
        while not self._ended:
            orders = link.wait(link.orders.number, 0.2)
            if orders.run is None or orders.run == done:
                continue
            recorder = recorder_for((0.0, 0.0, 0.0))
            node = make(_told(link.bundle), recorder)
            run = LinkedRun(link, orders, arms, recorder)
            self.drive(node, run)
            run.over(node)
            done = orders.run
        link.close()
        return 0


def _hear() -> queue.SimpleQueue[str]:
    """What somebody writes on stdin, word by word; Enter alone stops."""
    said: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            said.put(line.strip().lower() or "stop")

    threading.Thread(target=read, daemon=True).start()
    return said


@contextmanager
def _simulated(asked: argparse.Namespace) -> Iterator[tuple[float, ...]]:
    """A simulated robot in a process of its own while it is needed; yields a goal in our world."""
    if asked.simulated is None:
        yield ()
        return
    command = [sys.executable, "-m", "desirepath.deploy.ros.simulated", asked.simulated, str(os.getpid())]
    robot = subprocess.Popen(command, stdin=subprocess.DEVNULL, env={**os.environ, "MPLBACKEND": "agg"})
    try:
        yield GOAL if asked.simulated == str(WORLD) else ()
    finally:
        robot.terminate()
        robot.wait()


def _with_negatives(arguments: Sequence[str]) -> list[str]:
    """`--goal -1,2` as `--goal=-1,2`: argparse takes the former for two options."""
    joined: list[str] = []
    for one in arguments:
        if re.match(r"-[\d.]", one) and joined:
            joined[-1] += f"={one}"
        else:
            joined.append(one)
    return joined


def _numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    def read(text: str) -> tuple[float, ...]:
        numbers = tuple(float(part) for part in text.split(","))
        if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
            raise argparse.ArgumentTypeError(f"{text!r}: {count} numbers with commas are needed")
        return numbers

    return read


def _weights(text: str) -> dict[str, float]:
    pairs = [part.partition("=") for part in text.split(",")]
    return {name: float(value) for name, _, value in pairs}


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except (ValueError, RuntimeError, OSError) as told:
        sys.exit(f"error: {told}")
