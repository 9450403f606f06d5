"""Numbers with a 95 % interval (shares by Wilson's score interval, the rest by the percentile bootstrap), and tau.

NumPy alone, so that a page may use it. Intervals that stand on other distributions live in `intervals.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Doubles = NDArray[np.float64]
Interval = tuple[float, float]
RESAMPLES = 2_000
Z_95 = 1.959963984540054


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


NOTHING = Estimate(math.nan, math.nan, math.nan)


def wilson(hits: int, n: int) -> Estimate:
    """A share with its 95 % Wilson score interval; its ends are exact where nothing or everything hit."""
    return Estimate(hits / n, *wilson_interval(hits / n, n))


def wilson_interval(share: float, n: float, quantile: float = Z_95) -> Interval:
    """Wilson's score interval (1927) of a share of n; n need not be whole. quantile: of the normal or Student's t."""
    square = quantile**2 / n
    centre = (share + square / 2) / (1 + square)
    half = math.sqrt(max(0.0, share * (1 - share) * square + square**2 / 4)) / (1 + square)
    return max(0.0, min(share, centre - half)), min(1.0, max(share, centre + half))


def resample_rows(n: int) -> NDArray[np.int64]:
    """Bootstrap samples of n rows, by their numbers in ascending order: (RESAMPLES, n)."""
    return np.repeat(np.tile(np.arange(n), RESAMPLES), _counts(n, seed=0).ravel()).reshape(RESAMPLES, n)


def resample_means(columns: Doubles, *, seed: int = 0) -> Doubles:
    """Column means of bootstrap samples of the rows: columns (n, k) -> (RESAMPLES, k).

    All columns see the same samples, which pairs them; ask for many at once, since drawing costs more than averaging.
    """
    # Multinomial counts are the same resampling with replacement as drawing indices, in one matrix product.
    return _counts(len(columns), seed).astype(np.float64) @ columns / len(columns)


def _counts(n: int, seed: int) -> NDArray[np.int64]:
    """How often each of n rows is in each sample: (RESAMPLES, n)."""
    return np.random.default_rng([seed, 95]).multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES)


def interval(value: float, samples: Doubles) -> Estimate:
    """A value with the 95 % percentile interval of its bootstrap samples (resamples,)."""
    low, high = np.quantile(samples, [0.025, 0.975])
    return Estimate(value, float(low), float(high))


def mean_estimates(columns: dict[str, NDArray[Any]], *, seed: int = 0) -> dict[str, Estimate]:
    """Mean of each column (n,) with its 95 % bootstrap interval; NaN for no rows."""
    together = np.stack(list(columns.values()), axis=1).astype(np.float64)
    if len(together) == 0:
        return dict.fromkeys(columns, NOTHING)
    samples = resample_means(together, seed=seed)
    return {name: interval(float(together[:, k].mean()), samples[:, k]) for k, name in enumerate(columns)}


def mean_estimate(values: NDArray[Any] | Sequence[float]) -> Estimate:
    """`mean_estimates` of a single column (n,)."""
    return mean_estimates({"values": np.asarray(values)})["values"]


def kendall_tau_b(first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """(n,) Kendall's tau-b of n pairs of rows, first (n, k) and second (n, k), ties corrected (Kendall 1945).

    nan where one of the two rows says no order at all. Raises ValueError for shapes that differ or fewer than two
    columns. scipy's is of one pair, with a p: 1 ms each, where a power analysis ranks a hundred thousand times.
    """
    a, b = np.atleast_2d(np.asarray(first, dtype=float)), np.atleast_2d(np.asarray(second, dtype=float))
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] < 2:
        raise ValueError(f"first has shape {a.shape}, second {b.shape}; needs the same, at least two columns")
    i, j = np.triu_indices(a.shape[1], 1)
    first_order, second_order = np.sign(a[:, i] - a[:, j]), np.sign(b[:, i] - b[:, j])
    untied = (first_order != 0).sum(axis=1) * (second_order != 0).sum(axis=1)
    agreeing = (first_order * second_order).sum(axis=1)
    return np.asarray(np.where(untied > 0, agreeing / np.sqrt(np.maximum(untied, 1)), np.nan))
