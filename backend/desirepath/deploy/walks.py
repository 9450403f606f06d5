"""How people walk of whom only places are told, from where they were just before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.inputs import Person
from desirepath.deploy.outline import FASTEST

MOST_FOLLOWED = 100
LEAST_S, MOST_S = 0.15, 0.5  # how long somebody is followed for a velocity (ours, as all of these)
STEADY_M = 0.05  # that a detector is off by
STANDING = 0.2  # m/s: who is slower stands, and was only seen a little beside


class Walks:
    """Follows people from message to message: whoever is nearest to where somebody was, and the other way round, is
    the same. In a dense crowd two may be taken for each other, for MOST_S."""

    def __init__(self) -> None:
        self._paths: list[list[tuple[float, float, float]]] = []  # of each of the last people: when, x, y

    def follow(self, people: Sequence[Person], at_s: float) -> list[Person]:
        """The same people, with velocities where they were followed for LEAST_S; at_s: when they were seen, s."""
        before, now = self._paths, [[(at_s, one.x, one.y)] for one in people[:MOST_FOLLOWED]]
        passed = at_s - before[0][-1][0] if before else 0.0
        if now and 0 < passed <= MOST_S:
            for i, j in _same(_last(before), _last(now), passed):
                now[j] = [one for one in before[i] if at_s - one[0] <= MOST_S] + now[j]
        self._paths = now
        return [_walking(person, path) for person, path in zip(people, now, strict=False)] + list(
            people[MOST_FOLLOWED:]
        )


def _last(paths: list[list[tuple[float, float, float]]]) -> NDArray[np.float64]:
    """(n, 2) where each ends."""
    return np.array([path[-1][1:] for path in paths])


def _same(before: NDArray[np.float64], now: NDArray[np.float64], passed_s: float) -> list[tuple[int, int]]:
    """Which of (m, 2) places is which of (n, 2), metres."""
    apart = np.linalg.norm(before[:, None] - now, axis=2)
    nearest, other = apart.argmin(axis=1), apart.argmin(axis=0)
    at_most = FASTEST * passed_s + STEADY_M
    return [(i, int(j)) for i, j in enumerate(nearest) if other[j] == i and apart[i, j] <= at_most]


def _walking(person: Person, path: list[tuple[float, float, float]]) -> Person:
    (since, *at), (until, *to) = path[0], path[-1]
    if until - since < LEAST_S:
        return person
    v_x, v_y = (np.array(to) - at) / (until - since)
    return replace(person, v_x=float(v_x), v_y=float(v_y)) if np.hypot(v_x, v_y) >= STANDING else person
