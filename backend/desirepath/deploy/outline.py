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


class Braking(NamedTuple):
    """How a speed comes to 0: in takes_s; by then it went as far as in worth_s at the commanded speed."""

    takes_s: float = 0.0
    worth_s: float = 0.0

    @property
    def quickest(self) -> float:
        """Times the commanded speed, at most."""
        return max(1.0, 2 * self.worth_s / self.takes_s) if self.takes_s else 1.0

    def gone(self, after_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k,) of worth_s, so many seconds after it began."""
        left = 1 - np.clip(after_s / self.takes_s, 0, 1) if self.takes_s else np.ones(len(after_s))
        return np.asarray(self.worth_s * (1 - left**2))


AT_ONCE = Braking()


@dataclass(frozen=True)
class Way:
    """How a robot goes on from where it was since_s ago: by its command for react_s, then driving and turning brake,
    each in its time; rolls: its driving brakes at once."""

    command: Command
    react_s: float
    driving: Braking = AT_ONCE
    turning: Braking = AT_ONCE
    since_s: float = 0.0
    rolls: bool = False

    @property
    def drives_s(self) -> float:
        """How long it drives as commanded."""
        return 0.0 if self.rolls else self.react_s

    @property
    def all_s(self) -> float:
        return max(self.drives_s + self.driving.takes_s, self.react_s + self.turning.takes_s)

    @property
    def far_m(self) -> float:
        """How far the robot's centre goes, at most."""
        return abs(self.command.v) * (self.drives_s + self.driving.worth_s)

    def speed(self, turns_m: float) -> float:
        """m/s, at most, of the fastest point of an outline that turning moves, so far from the centre."""
        return abs(self.command.v) * self.driving.quickest + abs(self.command.w) * self.turning.quickest * turns_m

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, 3) x, y, yaw in the robot's frame of then, after (k,) seconds from 0 on, of which each two are joined by
        an arc."""
        went, yaw = (
            speed * (np.minimum(times, react_s) + braking.gone(times - react_s))
            for speed, react_s, braking in (
                (self.command.v, self.drives_s, self.driving),
                (self.command.w, self.react_s, self.turning),
            )
        )
        turned = np.diff(yaw) / 2
        chords = np.diff(went) * np.sinc(turned / np.pi)
        steps = chords * np.stack([np.cos(yaw[:-1] + turned), np.sin(yaw[:-1] + turned)])
        return np.column_stack([np.pad(steps.cumsum(axis=1), ((0, 0), (1, 0))).T, yaw])


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

    def seen_from(self, where: Odometry, age_s: float, least_s: float) -> People:
        """In the robot's frame, so many seconds after they were seen, or least_s after, or between; who walks away from
        it also as if they stood where they were, since a pace that is not kept makes no room."""
        c, s = math.cos(where.yaw), math.sin(where.yaw)
        turn = np.array([[c, -s], [s, c]])
        gone, between = self.walking * age_s, self.walking * (age_s - least_s) / 2
        away, at_first = self.places + gone - between - (where.x, where.y), self.places - (where.x, where.y)
        leaving = (at_first * self.walking).sum(1) > 0
        return People(
            np.concatenate([away, at_first[leaving]]) @ turn,
            np.concatenate([self.walking, HARDLY * self.walking[leaving]]) @ turn,
            np.concatenate([UNSURE * np.hypot(*gone.T) + np.hypot(*between.T), np.zeros(leaving.sum())]),
        )

    def pick(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> People:
        return People(self.places[which], self.walking[which], self.unsure[which])

    def after(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, n, 2) where they are after (k,) seconds; before now they were where they are."""
        return np.asarray(self.places + self.walking * np.maximum(times, 0)[:, None, None])

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
    turns_m: float = field(init=False, default=0.0)  # how far from the centre turning moves it: a disc not at all
    _sides: NDArray[np.float64] | None = field(init=False, default=None)  # (corners, 2, 2)

    def __post_init__(self) -> None:
        corners = self.robot.footprint
        self.around_m = self.robot.radius_m
        if corners is not None:
            a = np.asarray(corners, dtype=np.float64)
            self._sides = np.stack([a, np.roll(a, -1, axis=0)], axis=1)
            self.around_m = self.turns_m = float(np.hypot(*a.T).max())

    def first_touch(self, points: Points, way: Way) -> Touch | None:
        """Which of (n, 2) points the outline first holds on its way."""
        points = points[np.hypot(points[:, 0], points[:, 1]) <= self.around_m + way.far_m]
        if not len(points):
            return None
        times = np.linspace(0.0, way.all_s, 1 + math.ceil(way.speed(self.turns_m) * way.all_s / FINEST_M))
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
        quick = way.speed(self.turns_m) + people.speeds.max()
        looks = 1 + (math.ceil(quick * way.all_s / STEPS_M) if moving else 0)
        times = np.linspace(0.0, way.all_s, looks)
        there = people.after(times - way.since_s)
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
        near = np.flatnonzero(away <= way.far_m)
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
        there = people.after(times - way.since_s)
        there = _from(way.at(times)[:, None] * (people.speeds > 0)[None, :, None], there)
        spare = self._kept(there, people.unsure)
        look, who = np.unravel_index(int(spare.argmin()), spare.shape)
        if spare[look, who] >= 0:
            return None
        away = float(np.hypot(*there[look, who]))
        return max(0.0, float(times[look]) - way.since_s), away, away - float(spare[look, who])

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
