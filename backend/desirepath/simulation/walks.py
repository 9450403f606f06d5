"""How a person walks while the robot drives: poses over time, kept as knots of a smooth curve.

Recorded from a participant or planned; either way plain data of a scene (`Scene.walk`). Engines replay it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Doubles = NDArray[np.float64]
KNOTS_EVERY_S = 0.2
TREMBLE_M = 0.01  # standard deviation that a recording may have around the smooth walk, ours
TREMBLE_RAD = 0.1
FARTHEST_TREMBLES = 5.0  # that the smooth walk may be from the recording anywhere
SMOOTHINGS = (1.0, 0.1, 0.01, 0.0)  # of the tremble: long standing would else pay for a start that is cut off
FASTEST_M_S = 2.0  # nobody walks faster beside a robot; at 5 Hz two bodies cannot pass through each other below 2.4
MOST_KNOTS = 2_000


class WalkError(ValueError):
    """A walk that nobody can have walked; says what is wrong."""


@dataclass(frozen=True)
class Walk:
    """Knots (n >= 2): times_s rising from 0, x and y (m), yaw (rad, without jumps). Between them monotone cubics.

    Before the first and after the last knot the person stands there. Raises WalkError.
    """

    times_s: tuple[float, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    yaw: tuple[float, ...]

    def __post_init__(self) -> None:
        n = len(self.times_s)
        if not 2 <= n <= MOST_KNOTS or not n == len(self.x) == len(self.y) == len(self.yaw):
            raise WalkError(
                f"walk has {n} times, {len(self.x)}, {len(self.y)}, {len(self.yaw)} x, y, yaw: 2 or more each"
            )
        knots = np.array([self.times_s, self.x, self.y, self.yaw], dtype=np.float64)
        if not np.isfinite(knots).all() or knots[0, 0] != 0 or (np.diff(knots[0]) <= 0).any():
            raise WalkError("walk times_s must rise from 0, and all numbers must be finite")
        fastest = float((np.hypot(*np.diff(knots[1:3], axis=1)) / np.diff(knots[0])).max())
        if fastest > FASTEST_M_S:
            raise WalkError(f"walk reaches {fastest:.1f} m/s; at most {FASTEST_M_S} m/s")

    @classmethod
    def recorded(cls, times_s: ArrayLike, poses: ArrayLike) -> Walk:
        """The smooth walk through recorded poses (n, 3) x, y, yaw at times (n,), which need not begin at 0.

        Raises WalkError for fewer than two different times, numbers that are not finite, or a person who flies.
        """
        times, where = np.asarray(times_s, dtype=np.float64), np.asarray(poses, dtype=np.float64)
        if times.ndim != 1 or where.shape != (len(times), 3) or not np.isfinite(times).all():
            raise WalkError(f"walk recorded with times {times.shape}, poses {where.shape}: must be (n,), (n, 3)")
        if not np.isfinite(where).all():
            raise WalkError("walk recorded with poses that are not finite")
        times, first = np.unique(times, return_index=True)
        where = where[first]
        if len(times) < 2:
            raise WalkError("walk recorded at fewer than two times")
        where[:, 2] = np.unwrap(where[:, 2])
        knots = np.linspace(0.0, times[-1] - times[0], max(2, math.ceil((times[-1] - times[0]) / KNOTS_EVERY_S) + 1))
        columns = []
        for axis, tremble in enumerate((TREMBLE_M, TREMBLE_M, TREMBLE_RAD)):
            smooth = _smooth(times - times[0], where[:, axis], tremble)
            columns.append(tuple(float(v) for v in smooth(knots)))
        return cls(tuple(float(t) for t in knots), *columns)

    @property
    def duration_s(self) -> float:
        return self.times_s[-1]

    @cached_property
    def _curve(self) -> Any:
        from scipy import interpolate  # 0.4 s: a server that walks nobody starts without it

        return interpolate.PchipInterpolator(self.times_s, np.array([self.x, self.y, self.yaw]).T)

    def poses_at(self, times_s: ArrayLike) -> Doubles:
        """(n, 3) x, y (m), yaw (rad, in (-pi, pi]) at times (n,)."""
        poses = np.asarray(self._curve(np.clip(times_s, 0.0, self.duration_s)))
        poses[:, 2] = -((math.pi - poses[:, 2]) % (2 * math.pi) - math.pi)
        return poses


def _smooth(times: Doubles, values: Doubles, tremble: float) -> Any:
    """The smoothest spline through values (n,) at times (n,) that stays as near to them as a tremble allows."""
    from scipy import interpolate

    weights = np.full(len(times), 1 / tremble)
    for smoothing in SMOOTHINGS:
        smooth = interpolate.UnivariateSpline(
            times, values, w=weights, k=min(3, len(times) - 1), s=smoothing * len(times)
        )
        if np.abs(smooth(times) - values).max() <= FARTHEST_TREMBLES * tremble:
            break
    return smooth
