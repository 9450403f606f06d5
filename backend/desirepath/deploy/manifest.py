"""What a policy is made for, as its bundle's manifest says: what it observes, its lidar, its limits, its robot. Read
from JSON that anybody may have written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from desirepath.deploy.inputs import FULL_TURN, MOST_RANGES
from desirepath.deploy.steering import Recovery, SteeringError

MANIFEST_BYTES = 2**20
MOST_INPUTS = 8_000
FEWEST_HZ, MOST_HZ = 0.5, 100


class BundleError(ValueError):
    """A bundle that cannot drive a robot; names the field, the value and what would work."""


@dataclass(frozen=True)
class Lidar:
    """The lidar that a policy learned with. Beams stand in the order that it sees them in: from straight ahead
    counter-clockwise; where it does not see all round, those to the left, then those to the right up to straight ahead.

    beams: how many; sectors: of each, the smallest range is observed; range_m: what is further is not seen;
    field_of_view_rad: all round, or half to either side. x, y (m), yaw (rad): where it is mounted in the robot's frame.
    """

    beams: int
    sectors: int
    range_m: float
    field_of_view_rad: float
    x: float
    y: float
    yaw: float

    @property
    def sectors_of_a_turn(self) -> int:
        """How many sectors of this size a whole turn has."""
        return max(self.sectors, round(self.sectors * FULL_TURN / self.field_of_view_rad))

    @property
    def beams_of_a_turn(self) -> int:
        return self.beams // self.sectors * self.sectors_of_a_turn


@dataclass(frozen=True)
class Limits:
    """v in [v_min, v_max] m/s, w in [-w_max, w_max] rad/s; v_change, w_change: the most that they change in a second,
    m/s^2 and rad/s^2; None: as quick as commanded."""

    v_min: float
    v_max: float
    w_max: float
    v_change: float | None
    w_change: float | None


@dataclass(frozen=True)
class Robot:
    """radius_m: of the circle around it. footprint: corners x, y (m) in its frame, of one that is no disc."""

    name: str
    radius_m: float
    footprint: tuple[tuple[float, float], ...] | None


@dataclass(frozen=True)
class Input:
    """One number of an observation: what it is, and by what it was divided."""

    name: str
    divided_by: float


@dataclass(frozen=True)
class Manifest:
    """inputs: of the observation, in order. period_s: from command to command. goal_radius_m: how near to its goal a
    robot has arrived. recovery: when it is stuck, or none. content: all of the file."""

    setup: str
    inputs: tuple[Input, ...]
    lidar: Lidar
    limits: Limits
    robot: Robot
    period_s: float
    goal_radius_m: float
    recovery: Recovery | None
    policy_sha256: str
    conditioning: Mapping[str, Any] | None
    content: Mapping[str, Any]

    def place(self, name: str) -> int | None:
        """Where an input stands in the observation, or None."""
        return next((k for k, one in enumerate(self.inputs) if one.name == name), None)


def read_json(content: bytes, named: str) -> dict[str, Any]:
    """An object of a bundle. Raises BundleError for anything else."""
    if len(content) > MANIFEST_BYTES:
        raise BundleError(f"{named}: {len(content):,} bytes; at most {MANIFEST_BYTES:,} are read")

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is no number of JSON")

    try:
        value = json.loads(content.decode("utf-8"), parse_constant=refuse)
    except (ValueError, RecursionError) as problem:
        raise BundleError(f"{named}: no JSON: {str(problem)[:200]}") from None
    if not isinstance(value, dict):
        raise BundleError(f"{named}: must be an object, is {type(value).__name__}")
    return value


def read_manifest(content: bytes) -> Manifest:
    """The manifest of a bundle. Raises BundleError."""
    given = read_json(content, "manifest.json")
    lidar, action = _part(given, "lidar"), _part(given, "action")
    mounted, robot = lidar.get("mounted_at"), _part(given, "robot")
    if not isinstance(mounted, list) or len(mounted) != 3:
        raise _wrong("lidar.mounted_at", mounted, "must be x, y (m) and yaw (rad)")
    rate = _number(given, "control_rate_hz", FEWEST_HZ, MOST_HZ)
    found = Manifest(
        setup=_text(given, "setup"),
        inputs=_inputs(_part(given, "observation")),
        lidar=Lidar(
            beams=_count(lidar, "lidar.beams", MOST_RANGES),
            sectors=_count(lidar, "lidar.sectors", MOST_INPUTS),
            range_m=_number(lidar, "lidar.range_m", 0.01, 1_000),
            field_of_view_rad=_number(lidar, "lidar.field_of_view_rad", 0.01, FULL_TURN + 1e-3),
            x=_number({"x": mounted[0]}, "lidar.mounted_at.x", -5, 5),
            y=_number({"y": mounted[1]}, "lidar.mounted_at.y", -5, 5),
            yaw=_number({"yaw": mounted[2]}, "lidar.mounted_at.yaw", -math.pi, math.pi),
        ),
        limits=_limits(action, robot),
        robot=Robot(_text(robot, "robot.name"), _number(robot, "robot.radius_m", 0.01, 10), _footprint(robot)),
        period_s=1 / rate,
        goal_radius_m=_number(given, "goal_radius_m", 0.0, 100),
        recovery=_recovery(given.get("recovery")),
        policy_sha256=_text(given, "policy_sha256"),
        conditioning=_part(given, "conditioning") if given.get("conditioning") is not None else None,
        content=given,
    )
    _check_lidar(found)
    if found.place("goal_distance") is None:
        raise _wrong("observation.layout", found.inputs[0].name, "must have goal_distance, by which progress is told")
    return found


def _check_lidar(found: Manifest) -> None:
    lidar = found.lidar
    if lidar.beams % lidar.sectors or lidar.beams_of_a_turn > MOST_RANGES:
        raise _wrong("lidar.sectors", lidar.sectors, f"must divide the {lidar.beams} beams")
    named = [one.name for one in found.inputs if one.name.startswith("lidar_")]
    if named != [f"lidar_{k}" for k in range(lidar.sectors)] or found.inputs[-1].name != named[-1]:
        raise _wrong("observation.layout", len(named), f"must end with lidar_0 to lidar_{lidar.sectors - 1}")


def _inputs(observation: Mapping[str, Any]) -> tuple[Input, ...]:
    layout = observation.get("layout")
    if not isinstance(layout, list) or not 1 <= len(layout) <= MOST_INPUTS:
        raise _wrong("observation.layout", type(layout).__name__, f"must be a list of 1 to {MOST_INPUTS:,} inputs")
    if observation.get("shape") != [len(layout)]:
        raise _wrong("observation.shape", observation.get("shape"), f"its layout has {len(layout)} inputs")
    if not all(isinstance(one, dict) for one in layout):
        raise _wrong("observation.layout", layout[0], "must be objects with name and divided_by")
    inputs = [Input(_text(one, "layout.name"), _number(one, "layout.divided_by", 1e-6, 1e6)) for one in layout]
    if len({one.name for one in inputs}) != len(inputs):
        raise _wrong("observation.layout", "the same name", "must be there once")
    return tuple(inputs)


def _limits(action: Mapping[str, Any], robot: Mapping[str, Any]) -> Limits:
    layout = action.get("layout")
    names = ["linear_velocity", "angular_velocity"]
    if not isinstance(layout, list) or [one.get("name") for one in layout if isinstance(one, dict)] != names:
        raise _wrong("action.layout", layout, f"must be {names}")
    ranges = [one.get("range") for one in layout]
    if not all(isinstance(one, list) and len(one) == 2 for one in ranges):
        raise _wrong("action.layout.range", ranges, "must be two numbers each")
    (v_min, v_max), (w_min, w_max) = (
        [_number({"range": value}, "action.layout.range", -100, 100) for value in one] for one in ranges
    )
    if not 0 <= v_min < v_max or not w_max > 0 or not math.isclose(w_min, -w_max):
        raise _wrong("action.layout.range", ranges, "must be [v_min, v_max] from 0 on, and [-w_max, w_max]")

    def change(name: str) -> float | None:
        return None if robot.get(name) is None else _number(robot, f"robot.{name}", 1e-6, 1e6)

    return Limits(v_min, v_max, w_max, change("v_change"), change("w_change"))


def _footprint(robot: Mapping[str, Any]) -> tuple[tuple[float, float], ...] | None:
    given = robot.get("footprint")
    if given is None:
        return None
    if not isinstance(given, list) or not 3 <= len(given) <= 40:
        raise _wrong("robot.footprint", given, "must be 3 to 40 corners [x, y]")
    if not all(isinstance(one, list) and len(one) == 2 for one in given):
        raise _wrong("robot.footprint", given, "must be corners [x, y]")
    corners = [[_number({"footprint": value}, "robot.footprint", -10, 10) for value in one] for one in given]
    return tuple((x, y) for x, y in corners)


def _recovery(given: Any) -> Recovery | None:
    if given is None:
        return None
    if not isinstance(given, dict):
        raise _wrong("recovery", given, "must be an object")
    numbers = [_number(given, f"recovery.{name}", 0, 1_000) for name in ("patience_s", "closer_m", "free_m")]
    try:
        return Recovery(*numbers)
    except SteeringError as problem:
        raise BundleError(f"manifest.json: {problem}") from None


def _part(of: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = of.get(name)
    if not isinstance(found, dict):
        raise _wrong(name, found, "must be an object")
    return found


def _text(of: Mapping[str, Any], path: str) -> str:
    found = of.get(path.rpartition(".")[2])
    if not isinstance(found, str) or not 0 < len(found) <= 200:
        raise _wrong(path, found, "must be a text of up to 200 characters")
    return found


def _count(of: Mapping[str, Any], path: str, most: int) -> int:
    found = of.get(path.rpartition(".")[2])
    if not isinstance(found, int) or isinstance(found, bool) or not 1 <= found <= most:
        raise _wrong(path, found, f"must be a whole number from 1 to {most:,}")
    return found


def _number(of: Mapping[str, Any], path: str, least: float, most: float) -> float:
    found = of.get(path.rpartition(".")[2])
    if not isinstance(found, int | float) or isinstance(found, bool) or not least <= found <= most:
        raise _wrong(path, found, f"must be a number from {least:g} to {most:g}")
    return float(found)


def _wrong(path: str, found: object, must: str) -> BundleError:
    said = repr(found)
    return BundleError(f"manifest.json: field {path!r} = {said if len(said) <= 80 else said[:79] + '…'}: {must}")
