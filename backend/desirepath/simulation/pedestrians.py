"""The pedestrians of a scene beside its person: who walks which way, how fast, and whom they avoid. Plain data.

Drawing them lives in `crowds.crowd_scenes`, moving them in `crowds.crowd_engine`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from desirepath.simulation.walks import Walk

Behaviour = Literal["path", "orca", "social_force"]
BEHAVIOURS: tuple[Behaviour, ...] = ("path", "orca", "social_force")
MOST_PEDESTRIANS = 20
MOST_KNOTS = 32  # of a route
FASTEST_M_S = 2.0


class PedestrianError(ValueError):
    """Pedestrians that cannot be; says what is wrong."""


@dataclass(frozen=True)
class CrowdConditions:
    """Who is drawn into a scene. moving, standing: numbers, from-to; speeds: m/s, from-to; area_m2: of floor that a
    robot can get to, for each who moves, instead of `moving`. Defaults: the first of training, section 4.4.6.1.
    """

    moving: tuple[int, int] = (1, 2)
    standing: tuple[int, int] = (1, 2)
    speeds: tuple[float, float] = (0.5, 1.0)
    behaviour: Behaviour = "path"
    area_m2: float | None = None

    __pydantic_config__ = ConfigDict(extra="forbid")

    def __post_init__(self) -> None:
        for name, (low, high) in (("moving", self.moving), ("standing", self.standing), ("speeds", self.speeds)):
            if not 0 <= low <= high:
                raise PedestrianError(f"{name} = {low}, {high}: must be from-to, from 0 on")
        if self.standing[0] < 1:
            raise PedestrianError(f"standing = {self.standing}: one person at least stands, the scene's own")
        if self.moving[1] + self.standing[1] > MOST_PEDESTRIANS + 1:
            raise PedestrianError(f"moving and standing: more than {MOST_PEDESTRIANS + 1} people in all")
        if self.speeds[1] > FASTEST_M_S:
            raise PedestrianError(f"speeds = {self.speeds}: at most {FASTEST_M_S:g} m/s")


@dataclass(frozen=True)
class Pedestrian:
    """One cuboid pedestrian, walking back and forth on a polyline, or standing (a route of one place).

    route: places (x, y) m, in order. speed: m/s, 0 for who stands. yaw: where who stands faces, rad. walk: where they
    really were, kept with a rollout; engines and the stage replay it.
    """

    route: tuple[tuple[float, float], ...]
    speed: float
    yaw: float = 0.0
    walk: Walk | None = None

    def __post_init__(self) -> None:
        if not 1 <= len(self.route) <= MOST_KNOTS:
            raise PedestrianError(f"route has {len(self.route)} places; 1 to {MOST_KNOTS}")
        if not all(math.isfinite(value) for place in self.route for value in place):
            raise PedestrianError("route has places that are not finite")
        if not 0.0 <= self.speed <= FASTEST_M_S:
            raise PedestrianError(f"speed = {self.speed}: 0 to {FASTEST_M_S:g} m/s")

    def places_at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) where they are at times (n,), m: as they were if that was kept, else back and forth on their route."""
        if self.walk is not None:
            return self.walk.poses_at(times_s)[:, :2]
        places = np.array(self.route)
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        total = float(lengths.sum())
        if total == 0 or self.speed == 0:
            return np.repeat(places[:1], len(times_s), axis=0)
        gone = self.speed * times_s % (2 * total)
        along, begun = np.where(gone > total, 2 * total - gone, gone), np.concatenate([[0.0], np.cumsum(lengths)])
        return np.stack([np.interp(along, begun, places[:, axis]) for axis in range(2)], axis=1)

    def later(self, seconds: float) -> Pedestrian:
        """The same one, so long after: the route begins where they are then, and is written out back and forth as far
        as a route may be."""
        loop = [*self.route, *self.route[-2::-1]]
        passed = np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1)) if len(loop) > 1 else np.zeros(1)
        if passed[-1] == 0 or self.speed == 0:
            return self
        x, y, _ = where_on_route(self, seconds)
        nearest = 1 + int(np.searchsorted(passed, self.speed * seconds % passed[-1], side="right"))
        ahead = [loop[1 + (nearest - 1 + k) % (len(loop) - 1)] for k in range(MOST_KNOTS - 1)]
        return replace(self, route=((x, y), *ahead))


def where_on_route(pedestrian: Pedestrian, seconds: float) -> tuple[float, float, float]:
    """x, y (m) and heading (rad) of one who walks a route back and forth, so long after the start."""
    places = np.array(pedestrian.route)
    if len(places) == 1 or pedestrian.speed == 0:
        return float(places[0, 0]), float(places[0, 1]), pedestrian.yaw
    steps = np.diff(places, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    total = float(lengths.sum())
    gone = pedestrian.speed * seconds % (2 * total)
    back = gone > total
    along = 2 * total - gone if back else gone
    begun = np.concatenate([[0.0], np.cumsum(lengths)])
    piece = min(int(np.searchsorted(begun, along, side="left" if back else "right")) - 1, len(steps) - 1)
    piece = max(piece, 0)
    x, y = places[piece] + steps[piece] * (along - begun[piece]) / lengths[piece]
    sign = -1.0 if back else 1.0
    return float(x), float(y), math.atan2(sign * steps[piece, 1], sign * steps[piece, 0])


@dataclass(frozen=True)
class Crowd:
    """behaviour: `path` avoids nobody (ch. 4); `orca` and `social_force` avoid each other and the robot."""

    behaviour: Behaviour
    pedestrians: tuple[Pedestrian, ...]

    def __post_init__(self) -> None:
        if self.behaviour not in BEHAVIOURS:
            raise PedestrianError(f"behaviour = {self.behaviour!r}; known: {', '.join(BEHAVIOURS)}")
        if len(self.pedestrians) > MOST_PEDESTRIANS:
            raise PedestrianError(f"{len(self.pedestrians)} pedestrians; at most {MOST_PEDESTRIANS}")

    def later(self, seconds: float) -> Crowd:
        """The same people, so long after. Of `path` only: who avoids others is not told by a route."""
        return replace(self, pedestrians=tuple(one.later(seconds) for one in self.pedestrians))

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Crowd:
        """Read what `dataclasses.asdict` wrote. Raises PedestrianError, WalkError, KeyError."""
        return cls(
            data["behaviour"],
            tuple(
                Pedestrian(
                    tuple((float(x), float(y)) for x, y in one["route"]),
                    one["speed"],
                    one["yaw"],
                    Walk(**{name: tuple(knots) for name, knots in one["walk"].items()}) if one.get("walk") else None,
                )
                for one in data["pedestrians"]
            ),
        )
