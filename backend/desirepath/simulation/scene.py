"""A scene: walls, obstacles, person, robot start and goal, everything but the behaviour.

Here live the plain data and its checks. Drawing scenes from a seed lives in `scenes.py`, moving robots through
them in the engines.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from desirepath.simulation.pedestrians import Crowd, PedestrianError
from desirepath.simulation.walks import Walk, WalkError

OBSTACLE_KINDS = ("cube", "box", "pillar", "wall", "couch", "table", "cupboard", "sofa", "chair", "bed", "lamp")
EYE_SHARE = 0.93  # of a body's height


class SceneError(ValueError):
    """A scene that cannot be run; names the field and the value."""

    def __init__(self, field: str, value: object, problem: str) -> None:
        self.field, self.value, self.problem = field, value, problem
        super().__init__(f"scene field '{field}' = {value!r}: {problem}")


@dataclass(frozen=True)
class Pose:
    """Position (m) and heading (rad, counter-clockwise from +x, in (-pi, pi])."""

    x: float
    y: float
    yaw: float = 0.0


@dataclass(frozen=True)
class Person:
    """A person: a vertical cylinder for the robot, a mannequin for people; yaw is where they face. sits: on a stool."""

    pose: Pose
    radius: float = 0.3
    height: float = 1.7
    sits: bool = False

    @property
    def eye_height_m(self) -> float:
        """Height of the eyes above the floor."""
        return EYE_SHARE * self.height


class UnrecordedPerson(Person):
    """Of a scene recorded elsewhere in which no person was: whoever asks where or how large they are is told so."""

    def __init__(self) -> None:
        """There is nothing to say of them."""

    def _missing(self) -> Never:
        raise SceneError("person", None, "was not recorded; what needs a person cannot be measured or shown here")

    pose = radius = height = property(_missing)
    sits = False

    def __repr__(self) -> str:
        return "UnrecordedPerson()"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, UnrecordedPerson)

    def __hash__(self) -> int:
        return hash(UnrecordedPerson)


@dataclass(frozen=True)
class Obstacle:
    """An oriented box on the floor. `length` along its own x axis, `width` along y, `height` along z, metres."""

    kind: str
    pose: Pose
    length: float
    width: float
    height: float

    def corners(self) -> list[tuple[float, float]]:
        """Its four corners on the floor, in order around it, metres."""
        c, s = math.cos(self.pose.yaw), math.sin(self.pose.yaw)
        return [
            (
                self.pose.x + c * a * self.length / 2 - s * b * self.width / 2,
                self.pose.y + s * a * self.length / 2 + c * b * self.width / 2,
            )
            for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))
        ]

    def distance_m(self, x: ArrayLike, y: ArrayLike) -> NDArray[Any]:
        """Metres from points on the floor, in the shape of x and y, to its surface; 0 inside."""
        c, s = math.cos(self.pose.yaw), math.sin(self.pose.yaw)
        dx, dy = np.subtract(x, self.pose.x), np.subtract(y, self.pose.y)
        along, across = np.abs(c * dx + s * dy) - self.length / 2, np.abs(c * dy - s * dx) - self.width / 2
        return np.asarray(np.hypot(np.maximum(along, 0), np.maximum(across, 0)))


@dataclass(frozen=True)
class Room:
    """A rectangular room centred on the origin; its walls stand around the free area of `length` (x) by `width` (y)."""

    length: float
    width: float
    wall_height: float = 2.0
    wall_thickness: float = 0.2

    def walls(self) -> tuple[Obstacle, ...]:
        """The four walls as obstacles, inner faces on the room's edge."""
        t, h = self.wall_thickness, self.wall_height
        x, y = (self.length + t) / 2, (self.width + t) / 2
        along, across = self.length + 2 * t, self.width + 2 * t
        return (
            Obstacle("wall", Pose(x, 0.0), t, across, h),
            Obstacle("wall", Pose(-x, 0.0), t, across, h),
            Obstacle("wall", Pose(0.0, y), along, t, h),
            Obstacle("wall", Pose(0.0, -y), along, t, h),
        )


@dataclass(frozen=True)
class Scene:
    """One scene of one setup. Same setup and seed, same scene, on every machine.

    `obstacles` excludes the walls; `solids()` has them all. `ground`: sha256 of the map that it lies in and that its
    setup names; None: it lies in none. `walk`: how the person moves, from `person.pose` on; None: they stand there.
    A recorded scene may have no person (`has_person`).
    """

    setup: str
    seed: int
    start: Pose
    goal: Pose
    goal_radius: float
    person: Person
    obstacles: tuple[Obstacle, ...] = ()
    room: Room | None = None
    walk: Walk | None = None
    crowd: Crowd | None = None
    ground: str | None = None

    def solids(self) -> tuple[Obstacle, ...]:
        """Obstacles and walls: everything box-shaped that stops a robot or a ray."""
        return self.obstacles + (self.room.walls() if self.room else ())

    @property
    def has_person(self) -> bool:
        """False only for scenes that were recorded without people."""
        return not isinstance(self.person, UnrecordedPerson)

    def human_distance_ceiling_m(self) -> float:
        """The largest minimum human distance any policy can reach: min(start-person, goal-person), centres."""
        person = self.person.pose
        return min(math.dist((p.x, p.y), (person.x, person.y)) for p in (self.start, self.goal))

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON-ready data; `from_dict` reads it back to an equal scene."""
        data = asdict(self if self.has_person else replace(self, person=Person(self.start)))
        if not self.has_person:
            data["person"] = None
        elif not self.person.sits:
            del data["person"]["sits"]  # likewise
        if self.walk is None:
            del data["walk"]  # a standing person's scene keeps the digest it always had
        if self.crowd is None:
            del data["crowd"]
        if self.ground is None:
            del data["ground"]
        return data

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Scene:
        """Read a scene written by `as_dict`. Raises SceneError naming a missing or unknown field."""
        try:
            return cls(
                setup=data["setup"],
                seed=int(data["seed"]),
                start=Pose(**data["start"]),
                goal=Pose(**data["goal"]),
                goal_radius=float(data["goal_radius"]),
                person=UnrecordedPerson()
                if data["person"] is None
                else Person(
                    Pose(**data["person"]["pose"]),
                    radius=data["person"]["radius"],
                    height=data["person"]["height"],
                    sits=bool(data["person"].get("sits", False)),
                ),
                obstacles=tuple(Obstacle(**{**o, "pose": Pose(**o["pose"])}) for o in data["obstacles"]),
                room=Room(**data["room"]) if data.get("room") else None,
                walk=Walk(**{name: tuple(knots) for name, knots in data["walk"].items()}) if data.get("walk") else None,
                crowd=Crowd.from_dict(data["crowd"]) if data.get("crowd") else None,
                ground=data.get("ground"),
            )
        except KeyError as missing:
            raise SceneError(str(missing.args[0]), None, "is missing") from None
        except TypeError as wrong:
            raise SceneError("scene", sorted(data), str(wrong)) from None
        except WalkError as wrong:
            raise SceneError("walk", "given", str(wrong)) from None
        except PedestrianError as wrong:
            raise SceneError("crowd", "given", str(wrong)) from None

    def person_poses(self, times_s: ArrayLike) -> NDArray[np.float64]:
        """(n, 3) where the person is at times (n,): x, y (m), yaw (rad)."""
        if self.walk is not None:
            return self.walk.poses_at(times_s)
        pose = self.person.pose
        return np.tile([pose.x, pose.y, pose.yaw], (len(np.asarray(times_s)), 1))

    def people_at(self, times_s: ArrayLike) -> NDArray[np.float64]:
        """(people, n, 2) where everybody is at times (n,), m: the person first, then the crowd as it walked or, where
        nobody avoids anybody, walks. Nobody where no person was recorded."""
        if not self.has_person:
            return np.zeros((0, len(np.asarray(times_s)), 2))
        person = self.person_poses(times_s)[:, :2]
        crowd = self.crowd.pedestrians if self.crowd else ()
        return np.stack([person, *(one.places_at(np.asarray(times_s, dtype=np.float64)) for one in crowd)])

    def people_poses_at(self, times_s: ArrayLike) -> NDArray[np.float64]:
        """(people, n, 3) the same with where they face, rad."""
        places = self.people_at(times_s)
        if not self.has_person:
            return np.zeros((0, places.shape[1], 3))
        crowd = self.crowd.pedestrians if self.crowd else ()
        yaws = [self.person_poses(times_s)[:, 2]]
        yaws += [
            np.full(places.shape[1], one.yaw) if one.walk is None else one.walk.poses_at(times_s)[:, 2] for one in crowd
        ]
        return np.concatenate([places, np.stack(yaws)[..., None]], axis=2)

    def digest(self) -> str:
        """sha256 of the canonical JSON, the scene's identity in the store."""
        return hashlib.sha256(json.dumps(self.as_dict(), sort_keys=True).encode()).hexdigest()
