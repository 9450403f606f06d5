"""How the two trajectories of a pair differ, by everything that may be preferred: the objectives' measures, the named
ones, the embedding. In typical differences of the setup's reference pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.embedding import embed
from desirepath.learning.measures.named import named_measures
from desirepath.learning.measures.steps import reference
from desirepath.learning.policies.mirroring import mirror_of
from desirepath.learning.preferences.spans import seen_measures
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
MOST_PREDICTED = 100  # pairs that stand for all that are to be predicted; own choice
LARGEST = 4.0  # typical differences: a larger one says no more


@dataclass(frozen=True)
class Measured:
    """Of n trajectories: seen (n, spans, 7), named measures (n, measures), embedding (n, features)."""

    seen: Doubles
    named: Doubles
    embedding: Doubles

    def __getitem__(self, rows: NDArray[np.int64] | slice) -> Measured:
        return Measured(self.seen[rows], self.named[rows], self.embedding[rows])


@dataclass(frozen=True)
class PairDifferences:
    """First minus second of n pairs. seen (n, spans, 7): as the posterior over the objectives takes it. named (n,
    measures), embedding (n, features): in typical differences, divided so that a typical pair has length 1."""

    setup: str
    seen: Doubles
    named: Doubles
    embedding: Doubles

    @classmethod
    def of(
        cls, setup: str, pairs: Sequence[tuple[Trajectory, Trajectory]], *, left_right_symmetry: bool = False
    ) -> PairDifferences:
        """left_right_symmetry: of what a pair and its mirror image have in common, for people who would answer both
        alike. Raises SetupError for trajectories of several setups, ValueError for none."""
        trajectories = [trajectory for pair in pairs for trajectory in pair]
        in_turn = measured(setup, trajectories, left_right_symmetry=left_right_symmetry)
        return cls.between(setup, in_turn[0::2], in_turn[1::2])

    @classmethod
    def between(cls, setup: str, first: Measured, second: Measured) -> PairDifferences:
        """As `of`, where what all firsts and all seconds measure is known already."""
        named, embedding = _units(setup)
        return cls(
            setup,
            first.seen - second.seen,
            named.scaled(first.named - second.named),
            embedding.scaled(first.embedding - second.embedding),
        )

    def __len__(self) -> int:
        return len(self.seen)

    def __getitem__(self, rows: NDArray[np.int64] | Sequence[int] | slice) -> PairDifferences:
        return PairDifferences(self.setup, self.seen[rows], self.named[rows], self.embedding[rows])

    def thinned(self, most: int = MOST_PREDICTED) -> PairDifferences:
        """Evenly spread ones of these pairs, at most so many."""
        return self[np.linspace(0, len(self) - 1, min(len(self), most)).astype(np.int64)]

    def joined(self, other: PairDifferences) -> PairDifferences:
        """These pairs, then the other ones."""
        return PairDifferences(
            self.setup,
            np.concatenate([self.seen, other.seen]),
            np.concatenate([self.named, other.named]),
            np.concatenate([self.embedding, other.embedding]),
        )


@dataclass(frozen=True)
class _Unit:
    """typical: of every column; length: of a typical pair in these."""

    typical: Doubles
    length: float

    def scaled(self, differences: Doubles) -> Doubles:
        """(pairs, columns) of first minus second."""
        return np.clip(differences / self.typical, -LARGEST, LARGEST) / self.length


def measured(setup: str, trajectories: Sequence[Trajectory], *, left_right_symmetry: bool = False) -> Measured:
    """Of each; with symmetry what a trajectory and its mirror image have in common."""
    named, features = _both(trajectories)
    if left_right_symmetry:
        mirror = mirror_of(get_setup(setup))
        mirrored = _both([mirror.seen_in(trajectory) for trajectory in trajectories])
        named, features = (named + mirrored[0]) / 2, (features + mirrored[1]) / 2
    return Measured(seen_measures(trajectories), named, features)


def _both(trajectories: Sequence[Trajectory]) -> tuple[Doubles, Doubles]:
    return named_measures(trajectories), embed(trajectories)


@lru_cache(maxsize=4)
def _units(setup: str) -> tuple[_Unit, _Unit]:
    units = []
    for values in _both(reference(setup).trajectories):
        differences = values[0::2] - values[1::2]
        typical = np.maximum(differences.std(0), 1e-6)
        lengths = np.square(_Unit(typical, 1.0).scaled(differences)).sum(1)
        units.append(_Unit(typical, float(np.sqrt(lengths.mean()))))
    return units[0], units[1]


@lru_cache(maxsize=4)
def reference_differences(setup: str, left_right_symmetry: bool = False) -> PairDifferences:
    """The setup's reference pairs: what is typical is typical of these."""
    in_turn = reference(setup).trajectories
    pairs = list(zip(in_turn[0::2], in_turn[1::2], strict=True))
    return PairDifferences.of(setup, pairs, left_right_symmetry=left_right_symmetry)
