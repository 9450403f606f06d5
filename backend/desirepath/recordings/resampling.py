"""Recorded poses at whatever times, as poses at control steps: arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.setups import CONTROL_DT_S

Doubles = NDArray[np.float64]
METHOD = (
    "poses at control steps of 0.2 s by linear interpolation, yaw along the shorter turn; what is left of a step at "
    "the end is left out"
)
TRAVEL = "its yaw is the direction of travel, which was not recorded"
STANDS_BELOW_M_S = 0.1  # nearly standing has no direction of travel


def step_times(first_s: float, last_s: float) -> Doubles:
    """(n,) control steps from `first_s` on, the last one not after `last_s`."""
    steps = int(np.floor((last_s - first_s) / CONTROL_DT_S + 1e-6))
    return np.asarray(first_s + np.arange(steps + 1) * CONTROL_DT_S)


def resample(times_s: Doubles, poses: Doubles, at_s: Doubles) -> Doubles:
    """(m, 3) poses at times (m,), of poses (n, 3) at rising times (n,); before and after these the first and the last.

    Where no yaw was recorded (NaN), it is the direction of travel.
    """
    columns = [np.interp(at_s, times_s, poses[:, 0]), np.interp(at_s, times_s, poses[:, 1])]
    yaw = np.interp(at_s, times_s, np.unwrap(poses[:, 2])) if np.isfinite(poses[:, 2]).all() else None
    if yaw is None:
        yaw = travel_yaw(columns[0], columns[1], at_s)
    return np.stack([*columns, wrap(yaw)], axis=1)


def travel_yaw(x: Doubles, y: Doubles, times_s: Doubles) -> Doubles:
    """(n,) rad, the direction of travel at places x, y (n,) m; while nearly standing that of before, at first that of
    the first step that goes anywhere; 0 where none does."""
    if len(x) < 2:
        return np.zeros(len(x))
    dx, dy = np.diff(x), np.diff(y)
    goes = np.hypot(dx, dy) > STANDS_BELOW_M_S * np.maximum(np.diff(times_s), 1e-9)
    if not goes.any():
        return np.zeros(len(x))
    steps = np.where(goes, np.arange(len(dx)), -1)
    latest = np.maximum.accumulate(steps)
    latest[latest < 0] = int(np.flatnonzero(goes)[0])
    found: Doubles = np.arctan2(dy, dx)[np.append(latest, latest[-1])]
    return found


def wrap(angles: Doubles) -> Doubles:
    """The same angles (n,) in (-pi, pi]."""
    found: Doubles = -((np.pi - angles) % (2 * np.pi) - np.pi)
    return found


def body_speeds(poses: Doubles, dt: float) -> Doubles:
    """(n, 3) ahead, to the left (m/s) and turning (rad/s) from each of poses (n, 3), dt seconds apart, to the next;
    0 at the last."""
    moved = np.diff(poses, axis=0, append=poses[-1:])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead, left = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]
    return np.asarray(np.stack([ahead, left, wrap(moved[:, 2])], axis=1) / dt)
