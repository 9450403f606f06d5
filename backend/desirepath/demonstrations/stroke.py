"""A stroke as it was drawn, why one cannot be driven, and the spline with speeds that is made of it (ch. 2, step 1).

How the robot drives the spline lives in `demonstration.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import extent_m
from desirepath.simulation.setups import Limits, get_setup

Doubles = NDArray[np.float64]

# All ours; the thesis says "interpolated and smoothed".
SPACING_M = 0.05  # of the points that the spline is fitted to
HAND_JITTER_M = 0.015  # standard deviation that a hand's tremble may have around the smooth path
SPEED_JITTER_M_S = 0.004
ENDS_WEIGHT = 20.0  # the first and the last point count that much more: a path begins and ends where it was drawn
TABLE_M = 0.005  # step of the arc-length table
FARTHEST_START_M = 0.5  # from the robot; nearer beginnings are drawn to it
FARTHEST_END_M = 0.8  # from the goal
SHORTEST_M = 0.5
FADE = 2.5  # a shifted beginning fades out over so many times its shift, and over 1 m at least
MOST_POINTS = 20_000
SLOWEST_M_S = 0.1  # ours: where a robot may stand still, a path is driven no slower than this, as in ch. 2
CUBIC = 3


def drawn_limits(setup: str) -> Limits:
    """What a drawn path's speeds are cut to in that setup."""
    limits = get_setup(setup).robot.limits
    return replace(limits, v_min=max(limits.v_min, SLOWEST_M_S))


class StrokeProblem(ValueError):
    """A stroke that cannot become a demonstration: nothing is wrong with the person, so say it kindly.

    code: unreadable, starts_away, ends_away, leaves_room, too_short, too_tight, collides or too_slow.
    at: (x, y) metres where the trouble lies, None if nowhere in particular.
    numbers: what a sentence may name, SI units in the names. thing: what is touched (`person`, `wall`, or the
    obstacle's kind), for `collides` only.
    """

    def __init__(
        self,
        code: str,
        words: str,
        at: Sequence[float] | Doubles | None = None,
        *,
        thing: str | None = None,
        **numbers: float,
    ) -> None:
        super().__init__(words)
        self.code, self.thing, self.numbers = code, thing, numbers
        self.at = (float(at[0]), float(at[1])) if at is not None else None


@dataclass(frozen=True)
class Stroke:
    """What a hand drew: points (n, 2) m on the floor, speeds (n,) m/s wanted there, times_s (n,) of the hand."""

    points: Doubles
    speeds: Doubles
    times_s: Doubles

    @classmethod
    def of(cls, points: object, speeds: object, times_s: object) -> Stroke:
        """A stroke from any nested numbers. Raises StrokeProblem `unreadable` for what is no stroke."""
        try:
            stroke = cls(*(np.array(part, dtype=np.float64) for part in (points, speeds, times_s)))
        except (TypeError, ValueError, OverflowError):
            raise StrokeProblem("unreadable", "the stroke's points, speeds or times are no numbers") from None
        n = len(stroke.points) if stroke.points.ndim else 0
        shapes = (stroke.points.shape, stroke.speeds.shape, stroke.times_s.shape)
        if shapes != ((n, 2), (n,), (n,)) or not 2 <= n <= MOST_POINTS:
            raise StrokeProblem(
                "unreadable",
                f"points, speeds, times_s have shapes {shapes}; must be (n, 2), (n,), (n,), 2 <= n <= {MOST_POINTS}",
            )
        if not all(np.isfinite(part).all() for part in (stroke.points, stroke.speeds, stroke.times_s)):
            raise StrokeProblem("unreadable", "points, speeds and times_s must be finite numbers")
        return stroke

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready; `Stroke.of(**data)` reads it back."""
        return {name: getattr(self, name).tolist() for name in ("points", "speeds", "times_s")}

    def as_sent(self) -> dict[str, Any]:
        """`as_dict` to a tenth of a millimetre and a millisecond, as the page's pen sends it."""
        return {name: np.round(value, 3 if name == "times_s" else 4).tolist() for name, value in self.as_dict().items()}


@dataclass(frozen=True)
class PathSpline:
    """A smooth path p(k) and speed v(k), k in [0, 1], both cubic B-splines; asked by arc length s in metres.

    knots (m,), coefficients (m - 4, 2): of the path. speed_knots, speed_coefficients: of the speed over k = s / length.
    limits: the speeds are cut to.
    """

    knots: Doubles
    coefficients: Doubles
    speed_knots: Doubles
    speed_coefficients: Doubles
    limits: Limits

    @cached_property
    def _path(self) -> Any:
        from scipy import interpolate  # 0.4 s: a server starts without it

        return interpolate.BSpline(self.knots, self.coefficients, CUBIC)

    @cached_property
    def _speed(self) -> Any:
        from scipy import interpolate

        return interpolate.BSpline(self.speed_knots, self.speed_coefficients, CUBIC)

    @cached_property
    def _table(self) -> tuple[Doubles, Doubles, Doubles]:
        """Parameter, arc length (m) and unwrapped heading (rad) at many places."""
        legs = np.linalg.norm(np.diff(self.coefficients, axis=0), axis=1).sum()  # bounds the length from above
        u = np.linspace(0.0, 1.0, max(50, math.ceil(legs / TABLE_M)))
        lengths = np.linalg.norm(np.diff(self._path(u), axis=0), axis=1)
        tangents = self._path.derivative()(u)
        headings = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
        return u, np.concatenate([[0.0], np.cumsum(lengths)]), headings

    @property
    def length_m(self) -> float:
        return float(self._table[1][-1])

    def points(self, s: Doubles) -> Doubles:
        """(n, 2) metres at arc lengths (n,)."""
        u, lengths, _ = self._table
        return np.asarray(self._path(np.interp(s, lengths, u)))

    def headings(self, s: Doubles) -> Doubles:
        """(n,) rad at arc lengths (n,), without jumps along the path."""
        _, lengths, headings = self._table
        return np.asarray(np.interp(s, lengths, headings))

    def speeds(self, s: Doubles) -> Doubles:
        """(n,) m/s at arc lengths (n,), within the limits."""
        wanted = self._speed(np.asarray(s) / self.length_m)
        return np.asarray(np.clip(wanted, self.limits.v_min, self.limits.v_max))


def _distinct(stroke: Stroke) -> tuple[Doubles, Doubles, Doubles]:
    """Points, speeds and arc lengths without points that lie on the one before."""
    steps = np.linalg.norm(np.diff(stroke.points, axis=0), axis=1)
    moved = np.concatenate([[True], steps > 1e-6])
    return stroke.points[moved], stroke.speeds[moved], np.concatenate([[0.0], np.cumsum(steps[steps > 1e-6])])


def _shift_to(points: Doubles, lengths: Doubles, start: Pose) -> Doubles:
    """The points with the beginning shifted onto the robot, the shift fading out along the path."""
    shift = np.array([start.x, start.y]) - points[0]
    over = max(1.0, FADE * float(np.linalg.norm(shift)))
    share: Doubles = np.clip(1.0 - lengths / over, 0.0, 1.0)
    moved: Doubles = points + shift * (share * share * (3 - 2 * share))[:, None]
    return moved


def check_stroke(stroke: Stroke, scene: Scene) -> None:
    """Raise StrokeProblem for a stroke that is too short, begins or ends elsewhere, or leaves the room."""
    points, _, lengths = _distinct(stroke)
    if lengths[-1] < SHORTEST_M:
        raise StrokeProblem(
            "too_short",
            f"the path is {lengths[-1]:.2f} m long, at least {SHORTEST_M} m are needed",
            points[-1],
            length_m=float(lengths[-1]),
            limit_m=SHORTEST_M,
        )
    for code, what, point, place, limit in (
        ("starts_away", "robot", points[0], scene.start, FARTHEST_START_M),
        ("ends_away", "goal", points[-1], scene.goal, FARTHEST_END_M),
    ):
        away = math.dist(point, (place.x, place.y))
        if away > limit:
            verb = code.split("_")[0]
            words = f"the path {verb} {away:.2f} m from the {what}, at most {limit} m are fine"
            raise StrokeProblem(code, words, point, distance_m=away, limit_m=limit)
    extent = extent_m(scene)
    if extent is not None:
        outside = ((points < extent[0]) | (points > extent[1])).any(axis=1)
        if outside.any():
            where = points[int(np.argmax(outside))]
            raise StrokeProblem("leaves_room", f"the path leaves the room at {where[0]:.2f}, {where[1]:.2f} m", where)


def fit_spline(stroke: Stroke, scene: Scene) -> PathSpline:
    """The smooth path with its speeds (ch. 2, step 1). Raises StrokeProblem, also those of `check_stroke`."""
    check_stroke(stroke, scene)
    points, speeds, lengths = _distinct(stroke)
    places = np.linspace(0.0, lengths[-1], max(8, math.ceil(lengths[-1] / SPACING_M) + 1))
    from scipy import interpolate

    even = np.stack([np.interp(places, lengths, points[:, axis]) for axis in range(2)], axis=1)
    even = _shift_to(even, places, scene.start)
    weights = np.full(len(places), 1 / HAND_JITTER_M)
    weights[[0, -1]] *= ENDS_WEIGHT
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(even, axis=0), axis=1))])
    try:
        (knots, coefficients, _), _ = interpolate.splprep(
            even.T, w=weights, u=along / along[-1], s=len(places), quiet=2
        )
    except ValueError as problem:  # points that fold back onto one place
        raise StrokeProblem("unreadable", f"no smooth path leads through the stroke: {problem}", even[0]) from None
    limits = drawn_limits(scene.setup)
    wanted = np.clip(np.interp(places, lengths, speeds), limits.v_min, limits.v_max)
    even_weights = np.full(len(places), 1 / SPEED_JITTER_M_S)
    speed_knots, speed_coefficients, _ = interpolate.splrep(
        places / places[-1], wanted, w=even_weights, s=len(places), quiet=2
    )
    n = len(speed_knots) - CUBIC - 1
    return PathSpline(knots, np.stack(coefficients, axis=1), speed_knots, speed_coefficients[:n], limits)
