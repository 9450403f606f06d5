"""What a policy observes, made of what a robot hears: the same numbers in the same order as in every engine."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.inputs import FULL_TURN, InputError, Odometry, Person, Scan
from desirepath.deploy.manifest import BundleError, Lidar, Manifest

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
NOBODY, NOBODY_AMONG_MANY = (6.0, math.pi), (20.0, 0.0)
"""Distance (m) and bearing (rad) at which a person is observed whom nobody told of. One person: straight behind, by
which policies that were never without one drive best (ours, `docs/your-policies.md`). Of several: as the engine of
crowds has it."""
Mount = tuple[float, float, float]
"""Where a lidar is in the robot's frame: x, y (m), yaw (rad)."""


def wrap(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = angle - FULL_TURN * math.floor((angle + math.pi) / FULL_TURN)
    return wrapped if wrapped > -math.pi else wrapped + FULL_TURN


class Observer:
    """Makes a policy's observations. It remembers nothing but how the last scan's ranges belong to sectors."""

    def __init__(self, manifest: Manifest, laser: Mount | None = None) -> None:
        """laser: where the robot's own lidar is, if elsewhere than the one that the policy learned with: what it sees
        is turned and moved there. Raises BundleError for a policy that observes what nothing on a robot tells."""
        lidar = manifest.lidar
        polar = manifest.inputs[: -lidar.sectors]
        self._inputs: list[tuple[_Tell, int, float]] = []
        for one in polar:
            found = _teller(one.name)
            if found is None:
                raise BundleError(
                    f"the policy observes {one.name!r}, which nothing on a robot tells; what can be driven with: goal, "
                    "people and their motion, velocities, a lidar"
                )
            self._inputs.append((*found, one.divided_by))
        self._scales = np.array([one.divided_by for one in manifest.inputs[-lidar.sectors :]])
        self._people = 1 + max((rank for _, rank, _ in self._inputs), default=0)
        among_many = any(one.name.startswith("pedestrian_") for one in polar)
        self._nobody = NOBODY_AMONG_MANY if among_many else NOBODY
        self._pool = _Pool(lidar, laser)

    def __call__(
        self, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Sequence[Person] = ()
    ) -> Floats:
        """(obs,) float32. Of more people than the policy observes, the nearest. Raises InputError for a scan that
        cannot serve; it says which angles are missing."""
        heard = _Heard(odometry, goal, people, self._people, self._nobody)
        told = [tell(heard, rank) / scale for tell, rank, scale in self._inputs]
        return np.concatenate([told, self._pool(scan) / self._scales]).astype(np.float32)

    def sectors(self, scan: Scan) -> Doubles:
        """(sectors,) metres, in the order of the observation. Raises InputError."""
        return self._pool(scan)


class _Heard:
    """Where goal and people are, seen from the robot."""

    def __init__(
        self,
        odometry: Odometry,
        goal: tuple[float, float],
        people: Sequence[Person],
        most_people: int,
        nobody: tuple[float, float],
    ) -> None:
        self.odometry = odometry
        self.goal = self._polar(goal[0] - odometry.x, goal[1] - odometry.y)
        near = sorted(people, key=lambda one: math.hypot(one.x - odometry.x, one.y - odometry.y))[:most_people]
        self.people = [self._polar(one.x - odometry.x, one.y - odometry.y) for one in near]
        c, s = math.cos(odometry.yaw), math.sin(odometry.yaw)
        self.motion = [(one.v_x * c + one.v_y * s, one.v_y * c - one.v_x * s) for one in near]
        lacking = most_people - len(near)
        self.people += [nobody] * lacking
        self.motion += [(0.0, 0.0)] * lacking

    def _polar(self, dx: float, dy: float) -> tuple[float, float]:
        return math.sqrt(dx * dx + dy * dy), wrap(math.atan2(dy, dx) - self.odometry.yaw)


_Tell = Callable[[_Heard, int], float]
_TOLD: Mapping[str, _Tell] = {
    "goal_distance": lambda heard, _: heard.goal[0],
    "goal_bearing": lambda heard, _: heard.goal[1],
    "person_distance": lambda heard, rank: heard.people[rank][0],
    "person_bearing": lambda heard, rank: heard.people[rank][1],
    "person_along": lambda heard, rank: heard.motion[rank][0],
    "person_across": lambda heard, rank: heard.motion[rank][1],
    "linear_velocity": lambda heard, _: heard.odometry.v,
    "angular_velocity": lambda heard, _: heard.odometry.w,
}


def _teller(name: str) -> tuple[_Tell, int] | None:
    """How an input of that name is told, and of which person, the nearest being 0."""
    part, rank = name, 0
    if name.startswith("pedestrian_"):
        number, _, what = name.removeprefix("pedestrian_").partition("_")
        if not number.isdecimal() or len(number) > 2:
            return None
        part, rank = f"person_{what}", int(number)
    return (_TOLD[part], rank) if part in _TOLD else None


class _Pool:
    """The smallest range of each sector. Every range belongs to the beam, of those that the policy learned with, whose
    direction is nearest to its own."""

    def __init__(self, lidar: Lidar, laser: Mount | None) -> None:
        self._lidar = lidar
        mount = (lidar.x, lidar.y, lidar.yaw)
        x, y, yaw = laser or mount
        c, s = math.cos(lidar.yaw), math.sin(lidar.yaw)
        self._turned = yaw - lidar.yaw
        self._moved = ((x - lidar.x) * c + (y - lidar.y) * s, (y - lidar.y) * c - (x - lidar.x) * s)
        self._of: tuple[float, float, int] | None = None
        self._angles = np.zeros(0)
        self._places = np.zeros(0, dtype=np.int64)

    def __call__(self, scan: Scan) -> Doubles:
        lidar, key = self._lidar, (scan.angle_min, scan.angle_increment, len(scan.ranges))
        if key != self._of:
            angles = scan.angles + self._turned
            places = self._sectors(angles)
            self._require(np.bincount(places, minlength=lidar.sectors + 1)[:-1] > 0, "the scan has no range")
            self._of, self._angles, self._places = key, angles, places
        measured, places = scan.ranges.astype(np.float64), self._places
        invalid = np.isnan(measured)
        if invalid.any():
            valid = np.bincount(places[~invalid], minlength=lidar.sectors + 1)[:-1] > 0
            self._require(valid, "the scan's ranges are all invalid (NaN)")
        measured[measured == -np.inf] = scan.range_min
        measured[invalid | ~((measured >= scan.range_min) & (measured <= scan.range_max))] = np.inf
        if self._moved != (0.0, 0.0):
            measured, places = self._from_mount(measured)
        nearest = np.full(lidar.sectors + 1, lidar.range_m)
        np.minimum.at(nearest, places, measured)
        return nearest[:-1]

    def _sectors(self, angles: Doubles) -> NDArray[np.int64]:
        """(n,) the sector of each direction in the learned lidar's frame; `sectors` where that does not look."""
        lidar = self._lidar
        whole, seen = lidar.sectors_of_a_turn, lidar.sectors
        beams = np.rint(angles * (lidar.beams_of_a_turn / FULL_TURN)).astype(np.int64) % lidar.beams_of_a_turn
        of_turn = beams // (lidar.beams // seen)
        left = (seen + 1) // 2
        right = of_turn - (whole - seen)
        places: NDArray[np.int64] = np.where(of_turn < left, of_turn, np.where(right >= left, right, seen))
        return places

    def _from_mount(self, measured: Doubles) -> tuple[Doubles, NDArray[np.int64]]:
        """What was measured, as from where the policy's lidar is; nothing seen stays so."""
        seen = np.isfinite(measured)
        x = measured[seen] * np.cos(self._angles[seen]) + self._moved[0]
        y = measured[seen] * np.sin(self._angles[seen]) + self._moved[1]
        return np.hypot(x, y), self._sectors(np.arctan2(y, x))

    def _require(self, there: NDArray[np.bool_], what: str) -> None:
        if there.all():
            return
        lidar = self._lidar
        width, blind = FULL_TURN / lidar.sectors_of_a_turn, lidar.sectors_of_a_turn - lidar.sectors
        left = (lidar.sectors + 1) // 2
        missing = [int(k) for k in np.flatnonzero(~there)]
        middles = [math.degrees(wrap(((k if k < left else k + blind) + 0.5) * width)) for k in missing]
        spans = ", ".join(f"{one:.0f}" for one in middles[:6])
        more = f" and {len(middles) - 6} more" if len(middles) > 6 else ""
        raise InputError(
            f"{what} at {spans}{more} degrees (straight ahead is 0, to the left positive): the policy observes "
            f"{lidar.sectors} sectors of {math.degrees(width):g} degrees each"
        )
