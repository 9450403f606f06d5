"""What was computed of the same trajectories a moment ago, by identity: many simulated people look at the same ones."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import wraps
from typing import TypeVar

from desirepath.simulation.trajectory import Trajectory

Result = TypeVar("Result")
KEPT = 4


def remember_last(compute: Callable[[Sequence[Trajectory]], Result]) -> Callable[[Sequence[Trajectory]], Result]:
    """`compute` of a sequence of trajectories, not done again for the last KEPT sequences of the very same ones."""
    known: OrderedDict[tuple[int, ...], tuple[tuple[Trajectory, ...], Result]] = OrderedDict()

    @wraps(compute)
    def once(trajectories: Sequence[Trajectory]) -> Result:
        key = tuple(map(id, trajectories))
        if key in known:
            known.move_to_end(key)
            return known[key][1]
        result = compute(trajectories)
        known[key] = (tuple(trajectories), result)  # held, so that no other trajectory takes an identity
        while len(known) > KEPT:
            known.popitem(last=False)
        return result

    return once
