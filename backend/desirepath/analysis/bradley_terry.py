"""Worths of what was compared in pairs, by the model of Bradley and Terry (1952), with intervals over people.

statsmodels' clustered logistic model says the same where nobody always wins; it knows no shared wins and losses.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

from desirepath.analysis.tested import has_spread

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Worth:
    """log_worth: against the mean of all. share: worth over the sum of worths, the chance of being the best of all by
    the model. low, high: 95 % interval of log_worth, from how people differ; NaN where they do not, as one
    person does not."""

    name: str
    log_worth: float
    share: float
    low: float
    high: float


def count_wins(choices: Iterable[tuple[str, str, str]], names: Sequence[str]) -> Array:
    """(people, k, k) how often each person, by the alphabet, chose i over j; choices: (person, chosen, rejected)."""
    rows = list(choices)
    people = sorted({person for person, _, _ in rows})
    wins = np.zeros((len(people), len(names), len(names)))
    for person, chosen, rejected in rows:
        wins[people.index(person), names.index(chosen), names.index(rejected)] += 1
    return wins


def bradley_terry(wins: ArrayLike, names: Sequence[str], *, shared: float = 0.5) -> list[Worth]:
    """Worths by maximum likelihood. wins (people, k, k): how often each person chose i over j.

    P(i over j) = w_i / (w_i + w_j). Answers of one person depend on each other, so the intervals are from the sandwich
    estimator clustered by people, with Student's t. `shared` wins and as many losses are shared among all pairs that
    were compared, so that who always wins has a worth, too. Raises ValueError for tables of another shape or nobody.
    """
    table = np.asarray(wins, dtype=float)
    k = len(names)
    if table.ndim != 3 or table.shape[1:] != (k, k) or k < 2 or not table.sum() > 0:
        raise ValueError(f"wins: shape {table.shape}; needs (people, {k}, {k}) with at least one win")
    total = table.sum(axis=0)
    compared = (total + total.T) > 0
    prior = np.where(compared, shared / max(1, compared.sum() // 2), 0.0)
    counts = total + prior

    def loss(free: Array) -> tuple[float, Array]:
        beta = np.append(free, -free.sum())
        chance = _probabilities(beta)
        slope = (counts - (counts + counts.T) * chance).sum(axis=1)
        return -float((counts * np.log(chance)).sum()), -(slope[:-1] - slope[-1])

    fit = optimize.minimize(loss, np.zeros(k - 1), jac=True, method="BFGS")
    beta = np.append(fit.x, -fit.x.sum())
    chance = _probabilities(beta)
    weight = (counts + counts.T) * chance * (1 - chance)
    information = np.diag(weight.sum(axis=1)) - weight
    inverse = np.linalg.pinv(information)
    scores = (table - (table + table.transpose(0, 2, 1)) * chance).sum(axis=2)
    n = len(table)
    half = np.full(k, math.nan)
    if n > 1:
        spread = inverse @ (scores.T @ scores) @ inverse * n / (n - 1)
        half = float(stats.t.ppf(0.975, n - 1)) * np.sqrt(np.maximum(np.diag(spread), 0.0))
        half[[not has_spread(of) for of in (scores @ inverse).T]] = math.nan
    shares = np.exp(beta) / np.exp(beta).sum()
    return [
        Worth(name, float(b), float(share), float(b - h), float(b + h))
        for name, b, share, h in zip(names, beta, shares, half, strict=True)
    ]


def _probabilities(beta: Array) -> Array:
    return np.asarray(1 / (1 + np.exp(beta[None, :] - beta[:, None])))
