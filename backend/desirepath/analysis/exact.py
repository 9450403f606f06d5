"""Null distributions of rank statistics for few people, ties included: exact where all cases can be counted, else drawn
by lot; scipy's tests are exact without ties only. Every function returns p, the smallest p that such data could give,
and which way was taken. Which data are tested, and what p means, is its callers'.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import permutations
from math import comb, factorial, prod
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Doubles = NDArray[np.float64]
Method = Literal["exact", "permutations", "approximate"]

FEW = 50  # people up to whom no approximation is taken; ours
MOST_STATES = 200_000  # of an exact distribution; bounds time and memory
DRAWS = 9_999  # permutations by lot: p is a multiple of 1/10,000
NEAR = 1e-9  # statistics as near as this are the same one
NOISE = 1e-13  # of a Fourier transform


class NullP(NamedTuple):
    """least: the smallest p that these numbers of people, with these ties, can have; 0 where it is not known."""

    p: float
    least: float
    method: Method


def signed_ranks(ranks: ArrayLike, positive: float) -> NullP:
    """Two-sided p of a sum of signed ranks: every rank of ranks (n,) has either sign with chance one half.

    positive: the sum of the ranks with a positive sign. Exact with ties; normal beyond `FEW` people.
    """
    doubled = np.rint(2 * np.asarray(ranks, dtype=float)).astype(int)
    n, total = len(doubled), int(doubled.sum())
    away = abs(2 * positive - total / 2)
    if n > FEW:
        z = away / np.sqrt((doubled.astype(float) ** 2).sum() / 4)
        return NullP(float(2 * stats.norm.sf(z)), 0.0, "approximate")
    chance = np.zeros(total + 1)
    chance[0] = 1.0
    for rank in doubled:
        chance[rank:] = (chance[rank:] + chance[: total + 1 - rank]) / 2
        chance[:rank] /= 2
    as_far = np.abs(np.arange(total + 1) - total / 2) >= away - NEAR
    return NullP(min(1.0, float(chance[as_far].sum())), min(1.0, 2.0 ** (1 - n)), "exact")


def rank_sum(ranks: ArrayLike, size: int, observed: float) -> NullP:
    """Two-sided p of the sum of the ranks of one of two groups, of `size`, of all ranks (n,): every choice of so many
    is as likely. Exact with ties; normal with the ties' correction beyond `FEW` people."""
    values = np.asarray(ranks, dtype=float)
    n, mean = len(values), size * values.mean()
    if n > FEW:
        variance = size * (n - size) / (n - 1) * values.var()
        z = abs(observed - mean) / np.sqrt(variance)
        return NullP(float(2 * stats.norm.sf(z)), 0.0, "approximate")
    doubled = np.rint(2 * values).astype(int)
    ways = np.zeros((size + 1, int(doubled.sum()) + 1))
    ways[0, 0] = 1.0
    for rank in doubled:
        ways[1:, rank:] += ways[:-1, : ways.shape[1] - rank].copy()
    away = np.abs(np.arange(ways.shape[1]) / 2 - mean)
    chance = ways[size] / comb(n, size)
    farthest = away[chance > 0].max()
    return NullP(
        min(1.0, float(chance[away >= abs(observed - mean) - NEAR].sum())),
        min(1.0, float(chance[away >= farthest - NEAR].sum())),
        "exact",
    )


def rank_totals(ranks: ArrayLike, *, seed: int = 0) -> NullP:
    """p of Friedman's statistic of ranks (people, conditions), tied ones averaged: every order of a person's own ranks
    is as likely. Exact where `MOST_STATES` allows (three conditions always); else by lot; chi-square beyond `FEW`."""
    table = np.asarray(ranks, dtype=float)
    n, k = table.shape
    observed = _spread(table.sum(axis=0))
    if n > FEW:
        around = table - (k + 1) / 2
        statistic = (k - 1) * _spread(table.sum(axis=0)) / (around**2).sum()
        return NullP(float(stats.chi2.sf(statistic, k - 1)), 0.0, "approximate")
    doubled = np.sort(np.rint(2 * table).astype(int) - 2, axis=1)
    if (2 * n * (k - 1) + 1) ** (k - 1) <= MOST_STATES:
        away, at_least = spread_distribution(tuple(sorted(map(tuple, doubled.tolist()))))
        p = at_least[min(len(away) - 1, int(np.searchsorted(away, observed - NEAR)))]
        return NullP(float(p), float(at_least[-1]), "exact")
    random = np.random.default_rng([seed, 5])
    drawn = random.permuted(np.broadcast_to(table, (DRAWS, n, k)), axis=2).sum(axis=1)
    as_far = int((_spread(drawn) >= observed - NEAR).sum())
    return NullP((as_far + 1) / (DRAWS + 1), max(1 / (DRAWS + 1), factorial(k) ** (1.0 - n)), "permutations")


def _spread(totals: Doubles) -> Doubles:
    """Sum of squares of totals (..., conditions) about their mean, which Friedman's statistic grows with."""
    return np.asarray(((totals - totals.mean(axis=-1, keepdims=True)) ** 2).sum(axis=-1))


@lru_cache(maxsize=4096)
def spread_distribution(doubled: tuple[tuple[int, ...], ...]) -> tuple[Doubles, Doubles]:
    """How far totals of ranks can lie from equal ones (sums of squares, ascending), and the chance of at least that.

    doubled: each person's ranks in ascending order, times two and less two, so that tied ones are whole numbers and
    begin at 0. The totals of all conditions but the last are distributed as a sum of independent vectors: the
    product of their Fourier transforms.
    """
    n, k = len(doubled), len(doubled[0])
    shape = (2 * n * (k - 1) + 1,) * (k - 1)
    transformed = np.ones((*shape[:-1], shape[-1] // 2 + 1), dtype=complex)
    for own in set(doubled):
        ranks = np.zeros(shape)
        for order in permutations(own):
            ranks[order[:-1]] += 1 / factorial(k)
        transformed *= np.fft.rfftn(ranks) ** doubled.count(own)
    chance = np.maximum(np.fft.irfftn(transformed, s=shape, axes=range(k - 1)), 0.0)
    totals = np.stack(np.meshgrid(*[np.arange(size) for size in shape], indexing="ij"), axis=-1).astype(float)
    last = sum(doubled[0]) * n - totals.sum(axis=-1, keepdims=True)  # a person's ranks have the same sum, tied or not
    away = _spread(np.concatenate([totals, last], axis=-1) / 2)
    real = chance > NOISE
    values, place = np.unique(np.round(away[real], 6), return_inverse=True)
    probabilities = np.bincount(place.ravel(), weights=chance[real])
    return values, np.minimum(1.0, np.cumsum(probabilities[::-1])[::-1])


def group_ranks(ranks: ArrayLike, sizes: tuple[int, ...]) -> NullP:
    """p of Kruskal and Wallis's statistic of ranks (n,), the groups of `sizes` one after the other: every division is
    as likely. By lot up to `FEW` people, chi-square beyond."""
    values = np.asarray(ranks, dtype=float)
    n, k = len(values), len(sizes)
    edges = np.cumsum((0, *sizes))[:-1]
    weights = np.asarray(sizes, dtype=float)

    def between(order: Doubles) -> Doubles:
        return np.asarray((np.add.reduceat(order, edges, axis=-1) ** 2 / weights).sum(axis=-1))

    observed = between(values)
    if n > FEW:
        statistic = (n - 1) * (observed - n * values.mean() ** 2) / ((values - values.mean()) ** 2).sum()
        return NullP(float(stats.chi2.sf(statistic, k - 1)), 0.0, "approximate")
    random = np.random.default_rng([0, 7])
    drawn = between(random.permuted(np.broadcast_to(values, (DRAWS, n)), axis=1))
    ways = factorial(n) / prod(factorial(size) for size in sizes)
    least = max(1 / (DRAWS + 1), prod(factorial(sizes.count(size)) for size in set(sizes)) / ways)
    return NullP((int((drawn >= observed - NEAR).sum()) + 1) / (DRAWS + 1), min(1.0, least), "permutations")


def equal_shares(counts: ArrayLike) -> NullP:
    """p of the chi-square statistic of counts (k,) under equal shares: exact multinomial where `MOST_STATES` allows and
    for no more than `FEW` people, else chi-square."""
    observed = np.rint(np.asarray(counts, dtype=float)).astype(int)
    n, k = int(observed.sum()), len(observed)
    if n > FEW or comb(n + k - 1, k - 1) * k > MOST_STATES:
        return NullP(float(stats.chisquare(observed).pvalue), 0.0, "approximate")
    chance, squares = _shares(n, k)
    least = float(chance[squares >= squares.max() - NEAR].sum())
    return NullP(min(1.0, float(chance[squares >= (observed**2).sum() - NEAR].sum())), least, "exact")


@lru_cache(maxsize=128)
def _shares(n: int, k: int) -> tuple[Doubles, Doubles]:
    """Every way in which n people can choose among k: its chance, and the sum of squares that chi-square grows with."""
    counts = np.zeros((1, 0), dtype=int)
    for _ in range(k - 1):
        left = n - counts.sum(axis=1)
        counts = np.concatenate(
            [np.column_stack([counts[left >= low], np.full((left >= low).sum(), low)]) for low in range(n + 1)]
        )
    counts = np.column_stack([counts, n - counts.sum(axis=1)])
    return stats.multinomial.pmf(counts, n, np.full(k, 1 / k)), (counts**2).sum(axis=1).astype(float)
