"""A robot's outline, and what it touches on its way: things where a scan saw them, people where they will be then.

Pure geometry in the robot's frame; what follows from a touch is decided in `safety.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.inputs import Command, Odometry, Person, Scan

Points = NDArray[np.float64]
MOST_POINTS = 720  # of a scan, in the stop zone; of denser ones the nearest of neighbours
MOST_NEAR = 32  # people who are looked at along a way: those who may be reached first
FINEST_M = 0.02  # how far a robot moves between two looks along its way
FORESEEN = 5  # looks at who walks into the keep-out distance while the robot brakes
STEPS_M = 0.05  # how far a robot and a person together move between two looks
PERSON_M = 0.3  # of the circle around somebody's centre, by which every engine counts collisions
APART_M = 0.02  # at least, between that circle and the outline: what 0.5 m between centres leaves a TurtleBot 2
SHY_M = 0.005  # more than that, on a robot's own way: so that it never creeps to where it must stand
NEARER_M = 1e-6
FASTEST = 2.5  # m/s: who is told to walk faster does not
HARDLY = 1e-6  # of their pace: of who may stand and still is somebody who walks, whom it waits for
UNSURE = 0.25  # of the way that somebody went since they were told of: so far they may be beside it


class Body(Protocol):
    """A robot's outline, metres: a disc, or corners around its centre."""

    @property
    def radius_m(self) -> float: ...
    @property
    def footprint(self) -> Sequence[tuple[float, float]] | None: ...


class Touch(NamedTuple):
    """What would be touched: in how many seconds, where that is now (x, y in the robot's frame); who: how fast they
    walk, m/s, None: a thing."""

    when_s: float
    x: float
    y: float
    who: float | None = None

    def __str__(self) -> str:
        what = "something" if self.who is None else "somebody who walks," if self.who else "somebody"
        at = f"{math.hypot(self.x, self.y):.2f} m away at {math.degrees(math.atan2(self.y, self.x)):.0f} degrees"
        does = "touches" if self.who is None or not self.when_s else "is too near to"
        return f"{what} {at} {does} the robot{f' in {self.when_s:.2f} s' if self.when_s else ''}"


@dataclass(frozen=True)
class Way:
    """How a robot goes on: by its command for react_s, then braking on the same arc for brake_s until it stands;
    `longer`: by how much that is farther in all than react_s alone."""

    command: Command
    react_s: float
    longer: float = 1.0
    brake_s: float = 0.0

    @property
    def all_s(self) -> float:
        return self.react_s + self.brake_s

    @property
    def braking_s(self) -> float:
        """What braking is as long as, in seconds at the command's speed."""
        return (self.longer - 1) * self.react_s

    def speed(self, around_m: float) -> float:
        """m/s of the fastest point of an outline, at most."""
        quicker = max(1.0, 2 * self.braking_s / self.brake_s) if self.brake_s else 1.0
        return quicker * (abs(self.command.v) + abs(self.command.w) * around_m)

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, 3) x, y, yaw in the robot's frame of now, after (k,) seconds."""
        left = 1 - np.clip((times - self.react_s) / self.brake_s, 0, 1) if self.brake_s else np.ones(len(times))
        gone = np.minimum(times, self.react_s) + self.braking_s * (1 - left**2)
        v, w = self.command.v, self.command.w
        turned = w * gone
        if abs(w) > 1e-6:
            return np.column_stack([v / w * np.sin(turned), v / w * (1 - np.cos(turned)), turned])
        return np.column_stack([v * gone, np.zeros(len(times)), turned])


@dataclass(frozen=True)
class People:
    """(n, 2) where somebody is, metres, and how they walk, m/s; unsure: (n,) metres that they may be beside it."""

    places: Points
    walking: Points
    unsure: NDArray[np.float64]

    @classmethod
    def told(cls, people: Sequence[Person], staying: bool = False) -> People:
        """As they were told of; nobody walks faster than FASTEST, nor at all where they are staying."""
        rows = np.array([(one.x, one.y, one.v_x, one.v_y) for one in people], dtype=np.float64).reshape(-1, 4)
        walking = rows[:, 2:]
        speeds = np.hypot(*walking.T)
        walking *= 0.0 if staying else (FASTEST / np.maximum(speeds, FASTEST))[:, None]
        return cls(rows[:, :2], walking, np.zeros(len(rows)))

    def seen_from(self, where: Odometry, age_s: float) -> People:
        """In the robot's frame, so many seconds after they were told of; who walks away from it also as if they stood
        where they were, since a pace that is not kept makes no room."""
        c, s = math.cos(where.yaw), math.sin(where.yaw)
        turn = np.array([[c, -s], [s, c]])
        gone = self.walking * age_s
        away, at_first = self.places + gone - (where.x, where.y), self.places - (where.x, where.y)
        leaving = (at_first * self.walking).sum(1) > 0
        return People(
            np.concatenate([away, at_first[leaving]]) @ turn,
            np.concatenate([self.walking, HARDLY * self.walking[leaving]]) @ turn,
            np.concatenate([UNSURE * np.hypot(*gone.T), np.zeros(leaving.sum())]),
        )

    def pick(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> People:
        return People(self.places[which], self.walking[which], self.unsure[which])

    @property
    def speeds(self) -> NDArray[np.float64]:
        return np.asarray(np.hypot(*self.walking.T))

    def __len__(self) -> int:
        return len(self.places)


def points_of(scan: Scan, laser: tuple[float, float, float]) -> Points:
    """(n, 2) x, y in the robot's frame of what a scan saw, metres."""
    ranges = np.where(np.isneginf(scan.ranges), scan.range_min, scan.ranges).astype(np.float64)
    angles = scan.angles
    seen = (ranges >= scan.range_min) & (ranges <= scan.range_max)
    ranges, angles = ranges[seen], angles[seen]
    if (groups := -(-len(ranges) // MOST_POINTS)) > 1:
        padded = np.pad(ranges, (0, -len(ranges) % groups), constant_values=np.inf).reshape(-1, groups)
        nearest = padded.argmin(axis=1) + groups * np.arange(len(padded))
        ranges, angles = ranges[nearest], angles[nearest]
    x, y, yaw = laser
    return np.column_stack([x + ranges * np.cos(angles + yaw), y + ranges * np.sin(angles + yaw)])


@dataclass
class Outline:
    """A robot's outline; keep_out_m: that people's centres are kept from its own, None: by the outline."""

    robot: Body
    keep_out_m: float | None = None
    around_m: float = field(init=False)
    _sides: NDArray[np.float64] | None = field(init=False, default=None)  # (corners, 2, 2)

    def __post_init__(self) -> None:
        corners = self.robot.footprint
        self.around_m = self.robot.radius_m
        if corners is not None:
            a = np.asarray(corners, dtype=np.float64)
            self._sides = np.stack([a, np.roll(a, -1, axis=0)], axis=1)
            self.around_m = float(np.hypot(*a.T).max())

    def first_touch(self, points: Points, way: Way) -> Touch | None:
        """Which of (n, 2) points the outline first holds on its way."""
        command = way.command
        far = self.around_m + abs(command.v) * way.longer * way.react_s
        points = points[np.hypot(points[:, 0], points[:, 1]) <= far]
        if not len(points):
            return None
        times = np.linspace(0.0, way.all_s, 1 + math.ceil(way.speed(self.around_m) * way.all_s / FINEST_M))
        for when, pose in zip(times, way.at(times), strict=True):
            inside = self._holds(_from(pose, points))
            if inside.any():
                x, y = points[int(inside.argmax())]
                return Touch(float(when), float(x), float(y))
        return None

    def first_met(self, people: People, way: Way) -> Touch | None:
        """Whom the robot touches now, or first comes too near to by its own moving, or who walks into it while it
        moves. Who would be nearer if it stood is not met."""
        people = self._reachable(people, way)
        if not len(people):
            return None
        moving = way.command != Command(0.0, 0.0)
        quick = way.speed(self.around_m) + people.speeds.max()
        looks = 1 + (math.ceil(quick * way.all_s / STEPS_M) if moving else 0)
        times = np.linspace(0.0, way.all_s, looks)
        there = people.places + people.walking * times[:, None, None]  # (looks, n, 2)
        spare = self._spare(_from(way.at(times)[:, None], there), people.unsure)
        met = spare < SHY_M
        if close := np.flatnonzero(met.any(axis=0)).tolist():
            if_it_stood = self._spare(there[:, close], people.unsure[close])
            met[:, close] &= spare[:, close] < if_it_stood + np.where(people.speeds[close] > 0, NEARER_M, -NEARER_M)
        met[0] = self.distances(people.places) < PERSON_M
        if not met.any():
            return None
        look, who = np.unravel_index(int(met.argmax()), met.shape)
        x, y = people.places[who]
        return Touch(float(times[look]), float(x), float(y), float(people.speeds[who]))

    def _reachable(self, people: People, way: Way) -> People:
        """Who may be met at all, at most MOST_NEAR."""
        reach = self.around_m + PERSON_M + APART_M + SHY_M + people.unsure
        reach = np.maximum(reach, (self.keep_out_m or 0.0) + SHY_M + people.unsure)
        away = np.hypot(*people.places.T) - reach - people.speeds * way.all_s
        near = np.flatnonzero(away <= abs(way.command.v) * way.longer * way.react_s)
        if len(near) > MOST_NEAR:
            near = near[np.argpartition(away[near], MOST_NEAR)[:MOST_NEAR]]
        return people.pick(near)

    def nearest(self, people: People, way: Way) -> tuple[float, float, float] | None:
        """(in how many seconds, how far away, m, and how far is kept, m, between centres) of somebody within the
        keep-out distance, now or, where they walk, before the robot stands."""
        people = self._reachable(people, way)
        if not len(people) or self.keep_out_m == 0:
            return None
        times = np.linspace(0.0, way.all_s, FORESEEN if way.all_s else 1)
        there = people.places + people.walking * times[:, None, None]
        there = _from(way.at(times)[:, None] * (people.speeds > 0)[None, :, None], there)
        spare = self._kept(there, people.unsure)
        look, who = np.unravel_index(int(spare.argmin()), spare.shape)
        if spare[look, who] >= 0:
            return None
        away = float(np.hypot(*there[look, who]))
        return float(times[look]), away, away - float(spare[look, who])

    def _kept(self, places: NDArray[np.float64], unsure: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...) metres by which somebody at (..., 2) is farther than the keep-out distance."""
        if self.keep_out_m is None:
            return self.distances(places) - (PERSON_M + APART_M) - unsure
        return np.asarray(np.hypot(places[..., 0], places[..., 1]) - self.keep_out_m - unsure)

    def _spare(self, places: NDArray[np.float64], unsure: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same, and farther than what a collision is."""
        if self.keep_out_m is None:
            return self._kept(places, unsure)
        return np.minimum(self._kept(places, unsure), self.distances(places) - PERSON_M - unsure)

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...) metres from the outline to points (..., 2) in the robot's frame; 0 or less within."""
        if self._sides is None:
            return np.asarray(np.hypot(points[..., 0], points[..., 1]) - self.robot.radius_m)
        (ax, ay), (bx, by) = self._sides.transpose(1, 2, 0)
        along_x, along_y = bx - ax, by - ay
        px, py = points[..., :1] - ax, points[..., 1:] - ay
        part = np.clip((px * along_x + py * along_y) / np.maximum(along_x**2 + along_y**2, 1e-12), 0, 1)
        apart = np.hypot(px - part * along_x, py - part * along_y).min(axis=-1)
        return np.where(self._holds(points), 0.0, apart)

    def _holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(...) whether points (..., 2) in the robot's frame are within its outline."""
        if self._sides is None:
            return np.asarray(np.hypot(points[..., 0], points[..., 1]) < self.robot.radius_m)
        (ax, ay), (bx, by) = self._sides.transpose(1, 2, 0)
        px, py = points[..., :1], points[..., 1:]
        across = (ay > py) != (by > py)
        crossing = px < (bx - ax) * (py - ay) / np.where(by == ay, 1.0, by - ay) + ax
        return np.asarray(np.logical_xor.reduce(across & crossing, axis=-1))


def _from(poses: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (..., 2) as seen from poses (..., 3)."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    dx, dy = places[..., 0] - poses[..., 0], places[..., 1] - poses[..., 1]
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=-1)
