"""`python -m desirepath.deploy.ros BUNDLE`: drive a robot by an exported policy, with the robot's own ROS 2 or PyPI's.

`desirepath drive POLICY` is the same, and finds policies and robots by their names too.
"""

from __future__ import annotations

import argparse
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

from desirepath.deploy.inputs import InputError
from desirepath.deploy.safety import Body, Rules

WORDS = ("arm", "start", "stop", "off", "quit")
HELP = "arm, start, stop (or only Enter), off, quit"
WORLD, GOAL = Path(__file__).with_name("world.yaml"), (-0.6, 4.2)
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
        description="Drive a robot by a policy, over ROS 2. It stands until you arm and start it, with the words "
        f"{HELP}, or by the services of these names. After --ros-args: remappings and parameters, as for every node.",
    )
    add = made.add_argument
    add("policy", metavar="POLICY", help="a bundle (folder or zip) that `desirepath policies export` wrote")
    add("--goal", type=_numbers(2), metavar="X,Y", help="where to, in the odometry's frame; else by goal_pose")
    add("--weights", type=_weights, default={}, metavar="NAME=W,...", help="of a policy that takes weights")
    add("--person", type=_numbers(2), action="append", default=[], metavar="X,Y", help="who stands there; may repeat")
    add("--nobody", action="store_true", help="there is nobody, whatever the policy observes")
    add("--robot", metavar="FILE", help="the robot.yaml of a robot that is not the policy's")
    add("--laser", type=_numbers(3), metavar="X,Y,YAW", help="where its lidar is, m and rad, if not as in the policy's")
    add(
        "--map-to-odom",
        type=_numbers(3),
        default=(0.0, 0.0, 0.0),
        metavar="X,Y,YAW",
        help="the odometry's frame in the map's",
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
    for one in fields(Rules):
        if one.name not in ("stale_s", "tick_s"):
            said = "as the robot's" if one.default is None else f"default {one.default:g}"
            add(f"--{one.name.replace('_', '-')}", type=float, metavar="NUMBER", help=f"a rule of safety; {said}")
    return made


def main(
    arguments: Sequence[str],
    prog: str = "python -m desirepath.deploy.ros",
    find: Callable[[str], Path | bytes] = Path,
    read_robot: Callable[[str], RobotHere] | None = None,
) -> int:
    """Drive until somebody ends it; the exit code. find: what `Controller.load` takes, of the policy's name. Raises
    ValueError for what cannot be driven by, RuntimeError where ROS is missing."""
    end = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    asked = parser(prog).parse_args(_with_negatives(arguments[:end]))
    ros = _ros()
    bundle, here = find(asked.policy), None
    if asked.robot is not None:
        if read_robot is None:
            raise InputError("--robot reads robot.yaml with the whole of Desire Path; here: --laser and the rules")
        here = read_robot(asked.robot)
    with _simulated(asked) as goal:
        drive = ros.Drive(
            goal=asked.goal or goal,
            people=tuple(asked.person),
            nobody=asked.nobody,
            stamped=asked.stamped,
            laser=asked.laser or (here.laser if here else ()),
            map_to_odom=asked.map_to_odom,
            rules=_rules(asked, here),
            weights=asked.weights,
            body=here.body if here else None,
        )
        return _spin(ros, lambda: ros.DriveNode(bundle, drive), list(arguments[end:]), once=asked.once)


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


def _spin(ros: Any, make: Callable[[], Any], arguments: list[str], once: bool) -> int:
    """The node, until a signal, `quit`, or the end of its one drive. Whatever ends it, the robot is told to stand."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    ended: list[str] = []
    before = {
        number: signal.signal(number, lambda number, _: ended.append(f"signal {number}"))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = None
    try:
        node, executor = make(), SingleThreadedExecutor()
        executor.add_node(node)
        said, drove = _hear(), False
        node.get_logger().info(f"say: {HELP}")
        gc.freeze()
        while not ended:
            executor.spin_once(timeout_sec=0.1)
            while not said.empty():
                if (word := said.get()) == "quit":
                    ended.append("quit")
                elif word in WORDS:
                    node.act(word)
                else:
                    node.get_logger().warning(f"{word[:40]!r} is no word here; say: {HELP}")
            state = node.supervisor.state.value
            drove = drove or state == "driving"
            if once and drove and state != "driving":
                break
        node.get_logger().info(f"scan to command, p99: {node.latency_p99_ms():.2f} ms")
        return int(once and node.supervisor.reason != "arrived")
    finally:
        if node is not None:
            node.supervisor.stop(f"the node ends: {ended[0] if ended else 'it is done'}")
            for _ in range(3):
                node.publish(node.supervisor.command)
                time.sleep(0.01)
            node.destroy_node()
        rclpy.shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)


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
