"""What is added to a policy's own actions, in every engine and on a robot: getting unstuck, and driving slowly beside
the person. Functions of what is observed, of many robots side by side."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Rows = NDArray[np.int64]


class SteeringError(ValueError):
    """A rule that cannot be."""


@dataclass(frozen=True)
class Recovery:
    """When a robot counts as stuck, and as free again. A progress check with recovery behaviours, as navigation stacks
    for robots have them; the numbers are ours.

    patience_s: so long without coming `closer_m` nearer to its goal than ever before, and it is stuck. free_m: so much
    nearer than where it got stuck, and it is free.
    """

    patience_s: float = 6.0
    closer_m: float = 0.1
    free_m: float = 0.5

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not 0 < value <= 1_000:
                raise SteeringError(f"recovery {name} = {value!r}: must be above 0 and at most 1,000")


class Progress:
    """How near each robot has come to its goal, and who drives it: its usual policy (0), or since it got stuck one
    recovery policy after the other (1, ...) until it is free; the last one stands.

    A function of what is observed cannot leave a loop: what it did here it does again. Standing ends by the time limit,
    so a robot that nothing frees counts as what it is, a timeout.
    """

    def __init__(self, robots: int, last: int, period_s: float, recovery: Recovery) -> None:
        """last: the number of who stands. period_s: from step to step."""
        self._recovery, self._last = recovery, last
        self._patience = round(recovery.patience_s / period_s)
        self._active = np.zeros(robots, dtype=np.int64)
        self._nearest = np.full(robots, np.inf)
        self._waited = np.zeros(robots, dtype=np.int64)
        self._freed_at = np.full(robots, -np.inf)

    def begin_anew(self, rows: Rows) -> None:
        """Another one drives these robots from now on: what held the one before up is nothing to it."""
        self._active[rows], self._waited[rows] = 0, 0
        self._nearest[rows], self._freed_at[rows] = np.inf, -np.inf

    def drivers(self, distance_m: Doubles, rows: Rows) -> Rows:
        """(n,) who drives in this step, of the robots `rows` (n,) which are so far (n,) from their goals."""
        active, nearest, waited, freed_at = self._active, self._nearest, self._waited, self._freed_at
        nearer = distance_m < nearest[rows] - self._recovery.closer_m
        nearest[rows] = np.where(nearer, distance_m, nearest[rows])
        waited[rows] = np.where(nearer, 0, waited[rows] + 1)
        free = rows[(active[rows] > 0) & (distance_m < freed_at[rows])]
        active[free], waited[free] = 0, 0
        stuck = rows[waited[rows] >= self._patience]
        beginning = stuck[active[stuck] == 0]
        freed_at[beginning] = nearest[beginning] - self._recovery.free_m
        active[stuck], waited[stuck] = np.minimum(active[stuck] + 1, self._last), 0
        drivers: Rows = active[rows]
        return drivers


def stand(observations: Floats) -> Floats:
    """(n, 2) actions: no forward velocity, no turning, of robots whose slowest speed is standing."""
    return np.tile(np.array([-1.0, 0.0], dtype=np.float32), (len(observations), 1))


@dataclass(frozen=True)
class Slowing:
    """At most the share `most` of full speed within `near_m` of the person, all of it from `free_m` on, linear between.

    Turning is scaled as forward speed is, so that the robot drives about the same way, only later. Lengths in metres
    between the centres. Ours.
    """

    near_m: float = 2.0
    free_m: float = 3.0
    most: float = 0.3

    def __post_init__(self) -> None:
        if not 0 < self.near_m <= self.free_m < 1_000:
            raise SteeringError(
                f"slowing near_m = {self.near_m:g}, free_m = {self.free_m:g}: 0 < near_m <= free_m < 1,000 is needed"
            )
        if not 0 < self.most <= 1:
            raise SteeringError(f"slowing most = {self.most:g}: a share of full speed above 0, at most 1, is needed")

    def weighted(self, weight: float) -> Slowing | None:
        """The rule for who gives slowness this weight in [0, 1]; None at 0: nothing is slowed."""
        if weight <= 0:
            return None
        return Slowing(self.near_m, self.free_m, weight * self.most + (1 - weight))

    def limited(self, actions: Floats, person_m: Floats) -> Floats:
        """(n, 2) actions in [-1, 1], whose slowest speed is standing, and (n,) how far the person is where they are
        taken -> the actions with this limit."""
        far = (person_m - self.near_m) / max(self.free_m - self.near_m, 1e-6)
        limit = self.most + (1 - self.most) * np.clip(far, 0, 1)
        forward = (actions[:, 0] + 1) / 2  # of full speed
        fast = forward > limit
        limited = actions.copy()
        limited[fast, 0] = (2 * limit - 1)[fast]
        limited[fast, 1] *= (limit / np.maximum(forward, 1e-6))[fast]
        return limited

    def as_dict(self) -> dict[str, Any]:
        """For files, manifests and cards."""
        return asdict(self)
