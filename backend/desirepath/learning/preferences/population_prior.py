"""What people weigh, before anybody is asked: a normal prior over the weights of named measures and embedding, fitted
to a population. One prior for each family of simulated people that may be tuned on; one of earlier participants.

What answers make of it is `free_posterior.py`'s; which people the shipped priors are of, `experiments/shipping`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.advantage_process import AdvantageProcess
from desirepath.npz import from_npz, to_npz

Doubles = NDArray[np.float64]
FOLDER = Path(__file__).parent / "priors"
FORMAT = "desirepath-population-prior-1"
RANK = 40  # directions that are kept: 97 % of what members of a family differ by
RIDGE = 1e-4


@dataclass(frozen=True)
class WeightPrior:
    """weights = sqrt(strength) (mean + factor z), z standard normal. mean (columns,), factor (columns, rank): of
    `columns_of`; scaled so that a typical pair's advantage has variance strength."""

    name: str
    mean: Doubles
    factor: Doubles

    def seen(self, differences: PairDifferences) -> tuple[Doubles, Doubles]:
        """(n,) expected advantage of each pair's first, and (n, rank) how it may differ, at strength 1."""
        columns = columns_of(differences)
        return columns @ self.mean, columns @ self.factor


def columns_of(differences: PairDifferences) -> Doubles:
    """(n, columns) named measures, then the embedding."""
    return np.concatenate([differences.named, differences.embedding], axis=1)


def fit_prior(name: str, columns: Doubles, scores: Doubles, *, rank: int = RANK) -> WeightPrior:
    """columns: (pairs, columns); scores: (people, pairs) first minus second by each person's own score. Everybody's
    weights by ridge regression, each scaled to a typical advantage of 1; then their mean and what they differ by."""
    n = len(columns)
    weights = np.linalg.solve(columns.T @ columns + RIDGE * n * np.eye(columns.shape[1]), columns.T @ scores.T)
    weights /= np.sqrt(np.square(columns @ weights).mean(0)) + 1e-12
    mean: Doubles = weights.mean(1)
    left, sizes, _ = np.linalg.svd((weights - mean[:, None]) / np.sqrt(len(scores)), full_matrices=False)
    return WeightPrior(name, mean, (left * sizes)[:, :rank])


def to_bytes(setup: str, priors: tuple[WeightPrior, ...], made_from: dict[str, object]) -> bytes:
    """Half precision: the fourth digit of a prior changes no answer."""
    arrays = {
        f"{prior.name}.{part}": values.astype(np.float16)
        for prior in priors
        for part, values in (("mean", prior.mean), ("factor", prior.factor))
    }
    header = {"format": FORMAT, "setup": setup, "names": [prior.name for prior in priors], "made_from": made_from}
    return to_npz(header, arrays)


@lru_cache(maxsize=4)
def shipped_priors(setup: str) -> tuple[WeightPrior, ...]:
    """Of a setup; none where none were fitted."""
    path = FOLDER / f"{setup}.npz"
    if not path.is_file():
        return ()
    header, arrays = from_npz(path.read_bytes())
    if header.get("format") != FORMAT:
        raise ValueError(f"{path.name}: format {header.get('format')!r}; this version reads {FORMAT!r}")
    return tuple(
        WeightPrior(name, arrays[f"{name}.mean"].astype(np.float64), arrays[f"{name}.factor"].astype(np.float64))
        for name in header["names"]
    )


@dataclass(frozen=True)
class EarlierPerson:
    """Somebody who answered before and consented to training. chosen: of each pair, whether the first was."""

    differences: PairDifferences
    chosen: NDArray[np.bool_]


EARLIER, IN_GENERAL = "earlier_participants", "people_in_general"
TYPICAL_STRENGTH = 64.0
DIRECTIONS = 60
ROUNDS = 3
LIKE_EVERYBODY = 4.0  # so many people's worth that nobody weighs anything in particular
AS_SPREAD = 10.0  # so many people's worth that they differ as simulated people do


def prior_of_earlier(setup: str, people: Sequence[EarlierPerson]) -> WeightPrior | None:
    """What earlier participants weigh and how they differ, for the next one; None of nobody.

    A hierarchy of normal distributions, fitted by expectation and maximisation: everybody's weights given what all
    weigh (Laplace's approximation), then the mean and covariance of all given everybody's. It begins with what
    simulated people of the shipped priors weigh; few people hardly move it. Computed anew whenever it is used, so that
    somebody who was erased is not in it.
    """
    if not people:
        return None
    basis = _directions(setup, people[0].differences)
    mean, factor = fit_people([(columns_of(person.differences) @ basis, person.chosen) for person in people])
    return WeightPrior(EARLIER, basis @ mean, basis @ factor)


def fit_people(people: Sequence[tuple[Doubles, NDArray[np.bool_]]]) -> tuple[Doubles, Doubles]:
    """Mean (rank,) and factor (rank, rank) of what these people weigh, of columns of which weights are about standard
    normal. Of each person: (n, rank) how the first of each pair differs, and whether it was chosen."""
    seen = [rows for rows, _ in people]
    signs = [np.where(chosen, 1.0, -1.0) for _, chosen in people]
    rank = seen[0].shape[1]
    mean: Doubles = np.zeros(rank)
    spread: Doubles = np.eye(rank)
    for _ in range(ROUNDS):
        root: Doubles = np.linalg.cholesky(spread).astype(np.float64)
        of_people = [_weights(rows, of_one, mean, root) for rows, of_one in zip(seen, signs, strict=True)]
        means = np.stack([weights for weights, _ in of_people])
        mean = means.sum(0) / (len(people) + LIKE_EVERYBODY)
        apart = means - mean
        total = AS_SPREAD * np.eye(rank) + apart.T @ apart + np.sum([unsure for _, unsure in of_people], axis=0)
        spread = np.asarray(total / (AS_SPREAD + len(people)), dtype=np.float64)
    return mean, np.linalg.cholesky(spread).astype(np.float64)


def _weights(rows: Doubles, signs: Doubles, mean: Doubles, root: Doubles) -> tuple[Doubles, Doubles]:
    """Mean (rank,) and covariance (rank, rank) of one person's weights after their answers."""
    features = rows @ root
    process = AdvantageProcess.after(TYPICAL_STRENGTH, (rows @ mean, features), signs)
    if not len(signs):
        return mean, root @ root.T
    scale = np.sqrt(TYPICAL_STRENGTH)
    known = np.linalg.solve(process.triangle, process.root[:, None] * features * scale)
    return mean + root @ (process.weights() / scale), root @ (np.eye(len(mean)) - known.T @ known) @ root.T


def _directions(setup: str, some: PairDifferences) -> Doubles:
    """(columns, rank) such that weights of simulated people are about standard normal in it."""
    priors = shipped_priors(setup)
    if not priors:
        width = columns_of(some).shape[1]
        return np.eye(width)[:, : len(some.named[0])]
    both = np.concatenate([np.column_stack([prior.factor, prior.mean]) for prior in priors], axis=1) / np.sqrt(
        len(priors)
    )
    left, sizes, _ = np.linalg.svd(both, full_matrices=False)
    directions: Doubles = (left * sizes)[:, :DIRECTIONS]
    return directions
