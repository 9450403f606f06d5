"""How well the items of a scale measure one thing: Cronbach's alpha and McDonald's omega. statsmodels has neither."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reliability:
    """Of n people's answers to `items` items. alpha with its 95 % interval; omega: of one common factor."""

    n: int
    items: int
    alpha: float
    low: float
    high: float
    omega: float


def reliability(answers: ArrayLike) -> Reliability:
    """Of answers (people, items), reversed items already turned round. Alpha's interval is Feldt's (1965); omega is
    that of the one-factor model, sum of loadings squared over the variance of the sum (McDonald 1999), fitted by least
    squares of the covariances. Raises ValueError for fewer than two items or numbers that are not finite."""
    data = np.asarray(answers, dtype=float)
    if data.ndim != 2 or data.shape[1] < 2 or not np.isfinite(data).all():
        raise ValueError(f"answers: shape {data.shape}; needs people in rows, at least 2 items and finite numbers")
    n, k = data.shape
    if n < 3:
        return Reliability(n, k, *[math.nan] * 4)
    covariance = np.cov(data, rowvar=False)
    total = float(covariance.sum())
    if not total > 0:
        return Reliability(n, k, *[math.nan] * 4)
    alpha = k / (k - 1) * (1 - float(np.trace(covariance)) / total)
    df = (n - 1, (n - 1) * (k - 1))
    low, high = (1 - (1 - alpha) * float(stats.f.ppf(q, *df)) for q in (0.975, 0.025))
    return Reliability(n, k, alpha, low, high, _omega(covariance))


def _omega(covariance: Array) -> float:
    """Of the one factor whose products of loadings come nearest to the covariances of different items."""
    k = len(covariance)
    if k < 3:
        return math.nan  # two items do not say how much is common
    upper = np.triu_indices(k, 1)
    values, vectors = np.linalg.eigh(covariance)
    start = vectors[:, -1] * math.sqrt(max(values[-1], 1e-12)) * 0.8
    fit = optimize.least_squares(lambda loading: (np.outer(loading, loading) - covariance)[upper], start)
    unique = np.maximum(np.diag(covariance) - fit.x**2, 0.0)
    common = float(fit.x.sum() ** 2)
    return common / (common + float(unique.sum()))
