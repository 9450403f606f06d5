"""Family `look`: what a path looks like from above, whatever is beside it: how curved, how evenly, how symmetric.
Nothing is tuned on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from desirepath.learning.measures.steps import reference
from desirepath.learning.people.families.base import Doubles, Family, FamilyMember
from desirepath.simulation.trajectory import Trajectory

POINTS = 41  # of equal way between them
LOOKS = 4


@dataclass(frozen=True)
class LookMember(FamilyMember):
    """weights (LOOKS,): of `looks`, in standard deviations of the reference."""

    weights: tuple[float, ...]

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        mean, spread = _typical(trajectories[0].scene.setup)
        scores: Doubles = (looks(trajectories) - mean) / spread @ np.array(self.weights)
        return scores


class LookFamily(Family):
    """least: of each of the weights, whose squares sum to 1 before; a smaller one is not noticed and counts as 0."""

    least: float

    def draw(self, setup: str, random: np.random.Generator) -> LookMember:
        del setup
        weights = random.normal(0, 1, LOOKS)
        weights /= np.linalg.norm(weights)
        return LookMember(tuple(float(one) if abs(one) >= self.least else 0.0 for one in weights))


def looks(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, LOOKS): all turning (rad), how unevenly it is spread (rad), how far it bows from the straight line, and how
    unlike its halves are (both in lengths of that line)."""
    return np.stack([_looks(trajectory.poses[:, :2].astype(np.float64)) for trajectory in trajectories])


def _looks(path: Doubles) -> Doubles:
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    across = path[-1] - path[0]
    length = math.hypot(*across)
    if length < 1e-3:
        return np.zeros(LOOKS)
    places = np.linspace(0, way[-1], POINTS)
    points = np.stack([np.interp(places, way, path[:, k]) for k in range(2)], axis=1)
    steps = np.diff(points, axis=0)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    beside = ((points - path[0]) @ np.array([-across[1], across[0]])) / length**2
    return np.array([np.abs(turns).sum(), turns.std(), np.abs(beside).max(), np.abs(beside - beside[::-1]).mean()])


@lru_cache(maxsize=4)
def _typical(setup: str) -> tuple[Doubles, Doubles]:
    known = looks(reference(setup).trajectories)
    return known.mean(0), np.maximum(known.std(0), 1e-6)
