"""SocNav3 JSON, social navigation's own: grid, walls, and a sequence of robot, goal, people and objects; and out again.

Schema: `sequence` of {timestamp, robot {shape, x, y, angle, speed_x, speed_y, speed_a}, goal {x, y, angle,
pos_threshold, ...}, people [{id, x, y, angle}], objects [{id, type, x, y, angle, shape}]}, `walls` of {x1, y1, x2, y2},
`grid`, optional `metadata`; metres, radians, seconds.
"""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as AnyMapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.recordings.grids import grid_of, walls_of
from desirepath.recordings.mapping import Mapping
from desirepath.recordings.recording import (
    BOUNDS,
    Bounds,
    Goal,
    Recording,
    RecordingError,
    Source,
    Thing,
    read_bounded,
    sha256_of,
    track,
)
from desirepath.recordings.resampling import body_speeds
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
FORMAT = "socnav3"
DEEPEST = 32
MOST_VALUES = 5_000_000
WALL_M = 0.05  # walls are lines without a thickness
_SOCNAV1 = {b"score", b"identifier", b"humans", b"room"}


def read_socnav3(path: Path, mapping: Mapping, bounds: Bounds = BOUNDS) -> list[Recording]:
    """The one run of a file, named by it. Raises RecordingError by field."""
    content = read_bounded(path, bounds.json_bytes)
    source = Source(path.name, FORMAT, sha256_of(content))
    if set(re.findall(rb'"(\w+)":', content[:20_000])) >= _SOCNAV1 and b'"sequence"' not in content[:20_000]:
        problem = "is SocNav1: moments without motion, each rated 0-100; only sequences (SocNav3) can be shown"
        raise RecordingError(path.name, "", None, problem)
    data = parse_json(path.name, content)
    if not isinstance(data, dict) or "sequence" not in data:
        keys = list(data)[:10] if isinstance(data, dict) else type(data).__name__
        raise RecordingError(path.name, "sequence", keys, "is missing; SocNav3 has sequence, walls and grid on top")
    frames = _list(path.name, "sequence", data["sequence"], bounds.rows)
    how: list[str] = []
    robot: list[tuple[float, ...]] = []
    people: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    places: dict[str, list[int]] = defaultdict(list)
    goal: Goal | None = None
    things: dict[str, Thing] = {}
    for k, frame in enumerate(frames):
        at = f"sequence[{k}]"
        if not isinstance(frame, dict):
            raise RecordingError(path.name, at, frame, "must be an object of timestamp, robot, people, objects, goal")
        time_s = _number(path.name, at, frame, "timestamp")
        robot.append((time_s, *_pose(path.name, f"{at}.robot", frame.get("robot"), mapping)))
        for j, person in enumerate(_list(path.name, f"{at}.people", frame.get("people", []), bounds.things)):
            where = f"{at}.people[{j}]"
            who = _identity(path.name, where, person)
            if who in mapping.leave_out:
                continue
            if who not in people and len(people) >= bounds.people:
                problem = f"at most {bounds.people} people are shown; `leave_out` names others"
                raise RecordingError(path.name, where, len(people) + 1, problem)
            people[who].append((time_s, *_pose(path.name, where, person, mapping)))
            places[who].append(k)
        for j, thing in enumerate(_list(path.name, f"{at}.objects", frame.get("objects", []), bounds.things)):
            where = f"{at}.objects[{j}]"
            found = _thing(path.name, where, thing, mapping, how)
            first = things.setdefault(_identity(path.name, where, thing), found)
            if len(things) > bounds.things:
                raise RecordingError(path.name, where, len(things), f"objects; at most {bounds.things} are read")
            if math.dist((first.x, first.y), (found.x, found.y)) > 0.1:
                how.append("objects that were moved stay where they were first")
        if isinstance(frame.get("goal"), dict) and goal is None:
            goal = _goal(path.name, f"{at}.goal", frame["goal"], mapping, how)
    walls = [
        _wall(path.name, f"walls[{k}]", wall, mapping)
        for k, wall in enumerate(_list(path.name, "walls", data.get("walls", []), bounds.things))
    ]
    if walls:
        how.append(f"walls are lines without a thickness: {WALL_M:g} m thick and 2 m high")
    rows = np.array(robot, dtype=np.float64).reshape(-1, 4)
    if isinstance(data.get("grid"), dict) and data["grid"].get("data"):
        if walls:
            how.append("the grid is left out: walls and objects are shown")
        else:
            walls = list(_grid_walls(path.name, data["grid"], rows[:, 1:3], mapping, how, bounds))
    return [
        Recording(
            source=source,
            run=path.stem,
            scene=mapping.scene or path.parent.name or path.stem,
            robot=track(path.name, "robot", rows[:, 0], rows[:, 1:], lambda k: f"sequence[{k}]", bounds=bounds),
            people={
                who: track(
                    path.name,
                    f"person {who!r}",
                    np.array(seen)[:, 0],
                    np.array(seen)[:, 1:],
                    lambda k, at=places[who]: f"sequence[{at[k]}]",  # type: ignore[misc]
                    bounds=bounds,
                    gaps=True,
                )
                for who, seen in people.items()
            },
            things=(*things.values(), *walls),
            goal=goal,
            how=tuple(dict.fromkeys(how)),
        )
    ]


def parse_json(file: str, content: bytes) -> Any:
    """JSON of at most DEEPEST levels and MOST_VALUES values, without NaN. Raises RecordingError by line."""
    values = sum(content.count(sign) for sign in (b",", b"[", b"{"))
    if values > MOST_VALUES:
        raise RecordingError(file, "values", values, f"at most {MOST_VALUES} are read; thin the recording")
    depth = deepest = 0
    for found in _BRACKETS.finditer(content):  # strings are skipped, so brackets in them do not count
        token = found[0][:1]
        if token in b"[{":
            depth += 1
            deepest = max(deepest, depth)
        elif token in b"]}":
            depth -= 1
        if deepest > DEEPEST:
            line = content.count(b"\n", 0, found.start()) + 1
            raise RecordingError(file, f"line {line}", None, f"more than {DEEPEST} objects and lists within each other")

    def refuse(constant: str) -> float:
        raise RecordingError(file, "number", constant, "is none of JSON; leave such moments out")

    try:
        return json.loads(content.decode("utf-8-sig"), parse_constant=refuse, parse_int=_whole)
    except UnicodeDecodeError as wrong:
        raise RecordingError(file, f"byte {wrong.start}", None, "is not UTF-8 text") from None
    except json.JSONDecodeError as wrong:
        raise RecordingError(file, f"line {wrong.lineno}", None, f"is no JSON ({wrong.msg}); was it cut?") from None
    except RecursionError:
        raise RecordingError(file, "", None, "too many objects and lists within each other") from None


_BRACKETS = re.compile(rb'"(?:[^"\\]|\\.)*+"?|[\[\]{}]', re.DOTALL)  # possessive: a text without an end is read once


def _whole(digits: str) -> float | int:
    return int(digits) if len(digits) < 20 else float(digits)


def _list(file: str, where: str, value: Any, most: int) -> list[Any]:
    if not isinstance(value, list):
        raise RecordingError(file, where, value, "must be a list")
    if len(value) > most:
        raise RecordingError(file, where, len(value), f"at most {most} are read")
    return value


def _number(file: str, where: str, of: AnyMapping[str, Any], name: str) -> float:
    value = of.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        problem = "is missing" if value is None else "must be a finite number"
        raise RecordingError(file, f"{where}.{name}", value, problem)
    return float(value)


def _identity(file: str, where: str, of: Any) -> str:
    found = of.get("id") if isinstance(of, dict) else None
    if isinstance(found, bool) or not isinstance(found, int | str):
        raise RecordingError(file, f"{where}.id", found, "must be a number or a text")
    return str(found)


def _pose(file: str, where: str, of: Any, mapping: Mapping) -> tuple[float, float, float]:
    if not isinstance(of, dict):
        raise RecordingError(file, where, of, "must be an object with x, y and angle")
    x, y, angle = (_number(file, where, of, name) for name in ("x", "y", "angle"))
    return x - mapping.origin[0], y - mapping.origin[1], angle


def _goal(file: str, where: str, of: AnyMapping[str, Any], mapping: Mapping, how: list[str]) -> Goal | None:
    if of.get("x") is None or of.get("y") is None:
        how.append(f"the goal is of type {of.get('type')!r} without a place: left out")
        return None
    x, y = (_number(file, where, of, name) for name in ("x", "y"))
    angle = _number(file, where, of, "angle") if of.get("angle") is not None else 0.0
    radius = _number(file, where, of, "pos_threshold") if of.get("pos_threshold") is not None else None
    return Goal(x - mapping.origin[0], y - mapping.origin[1], angle, radius if radius and 0 < radius <= 100 else None)


def _thing(file: str, where: str, of: Any, mapping: Mapping, how: list[str]) -> Thing:
    x, y, angle = _pose(file, where, of, mapping)
    shape = of.get("shape")
    if not isinstance(shape, dict):
        raise RecordingError(file, f"{where}.shape", shape, "must be an object with type, width and length")
    width = _number(file, f"{where}.shape", shape, "width")
    length = _number(file, f"{where}.shape", shape, "length") if shape.get("length") is not None else width
    for name, value in (("width", width), ("length", length)):
        if not 0 < value <= 1_000:
            raise RecordingError(file, f"{where}.shape.{name}", value, "must be above 0 and at most 1,000 m")
    if shape.get("type") == "circle":
        how.append("round objects are shown as boxes of the same width")
    return Thing(str(of.get("type", "box"))[:40], x, y, angle, length, width)


def _grid_walls(
    file: str, grid: dict[str, Any], ways: Doubles, mapping: Mapping, how: list[str], bounds: Bounds
) -> tuple[Thing, ...]:
    """What is occupied in a grid: 1, or from 65 of 100 on, row by row from its origin."""
    try:
        cells = np.asarray(grid["data"], dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise RecordingError(file, "grid.data", None, "must be numbers, row by row") from None
    if not np.isfinite(cells).all():
        raise RecordingError(file, "grid.data", None, "must be finite numbers")
    scaled = np.clip(cells * (100 if cells.max() <= 1 else 1), -1, 100).astype(np.int8)
    width, height = (int(_number(file, "grid", grid, name)) for name in ("width", "height"))
    x, y, angle = (_number(file, "grid", {name: 0.0, **grid}, name) for name in ("x_orig", "y_orig", "angle_orig"))
    origin = (x - mapping.origin[0], y - mapping.origin[1], angle)
    found = grid_of(file, "grid", scaled, width, height, _number(file, "grid", grid, "cell_size"), origin)
    return walls_of(found, ways, how, bounds)


def _wall(file: str, where: str, of: Any, mapping: Mapping) -> Thing:
    if not isinstance(of, dict):
        raise RecordingError(file, where, of, "must be an object with x1, y1, x2, y2")
    x1, y1, x2, y2 = (_number(file, where, of, name) for name in ("x1", "y1", "x2", "y2"))
    long = math.hypot(x2 - x1, y2 - y1)
    middle = (x1 + x2) / 2 - mapping.origin[0], (y1 + y2) / 2 - mapping.origin[1]
    return Thing("wall", *middle, math.atan2(y2 - y1, x2 - x1), max(long, WALL_M), WALL_M)


# ---- out -------------------------------------------------------------------------------------------------------------


def to_socnav3(trajectory: Trajectory, robot_radius_m: float) -> dict[str, Any]:
    """One trajectory as SocNav3's plain data. Speeds are those between poses, in the robot's frame."""
    scene = trajectory.scene
    speeds = body_speeds(trajectory.poses.astype(np.float64), trajectory.dt)
    people = scene.people_poses_at(trajectory.times.astype(np.float64))
    return {
        "metadata": {
            "software": "Desire Path",
            "setup": scene.setup,
            "scene": scene.digest(),
            "recorded": trajectory.recorded.as_dict() if trajectory.recorded else None,
        },
        "grid": {
            "width": 0, "height": 0, "cell_size": 0.05, "x_orig": 0.0, "y_orig": 0.0, "angle_orig": 0.0, "data": [],
        },
        "walls": [line for solid in scene.solids() if solid.kind == "wall" for line in _edges(solid.corners())],
        "sequence": [
            _moment(trajectory, robot_radius_m, k, speeds[k], people[:, k]) for k in range(len(trajectory.poses))
        ],
    }  # fmt: skip


def _edges(corners: Sequence[tuple[float, float]]) -> Iterator[dict[str, float]]:
    for (x1, y1), (x2, y2) in zip(corners, (*corners[1:], corners[0]), strict=True):
        yield {"x1": x1, "y1": y1, "x2": x2, "y2": y2}


def _moment(trajectory: Trajectory, robot_radius_m: float, k: int, speeds: Doubles, people: Doubles) -> dict[str, Any]:
    """speeds (3,): of the robot; people (n, 3): their poses."""
    scene, pose = trajectory.scene, trajectory.poses[k]
    disc = {"type": "circle", "width": 2 * robot_radius_m, "length": 2 * robot_radius_m}
    return {
        "timestamp": round(float(trajectory.times[k]), 3),
        "robot": {
            "id": 0, "shape": disc, "x": float(pose[0]), "y": float(pose[1]), "angle": float(pose[2]),
            "speed_x": float(speeds[0]), "speed_y": float(speeds[1]), "speed_a": float(speeds[2]),
        },
        "goal": {
            "type": "go-to", "human": None, "x": scene.goal.x, "y": scene.goal.y, "angle": scene.goal.yaw,
            "pos_threshold": scene.goal_radius, "angle_threshold": math.pi,
        },
        "people": [
            {"id": n + 1, "x": float(x), "y": float(y), "angle": float(yaw)} for n, (x, y, yaw) in enumerate(people)
        ],
        "objects": [
            {
                "id": n + 1, "type": one.kind, "x": one.pose.x, "y": one.pose.y, "angle": one.pose.yaw,
                "shape": {"type": "rectangle", "width": one.width, "length": one.length},
            }
            for n, one in enumerate(scene.obstacles)
            if one.kind != "wall"
        ],
    }  # fmt: skip
