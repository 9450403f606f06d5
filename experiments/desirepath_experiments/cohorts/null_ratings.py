"""How often ten Friedman tests find something where nothing differs, from more cohorts than the whole analysis bears.

Only ratings, made and tested all at once; people are those of `simulated_cohorts.py`. Everything else that null cohorts
are asked is `null_cohorts.py`'s, which goes through the real analysis.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from desirepath.analysis.exact import FEW, NEAR, spread_distribution
from desirepath.report.simulated_cohorts import CONDITIONS, ITEMS, PERSONAL_SHARE, rate_opinions
from desirepath.report.simulated_power import Rate, rate

Doubles = NDArray[np.float64]
TIES = {(1, 3): (0, 2, 4), (1.5, 3): (1, 1, 4), (1, 2.5): (0, 3, 3), (2, 2): (2, 2, 2)}
"""Lowest and highest of a person's three ranks -> the ranks as `spread_distribution` wants them."""
AT_ONCE = 500  # cohorts; bounds memory


def null_family(cohorts: int, participants: int, *, seed: int = 0, alpha: float = 0.05, points: int = 7) -> Rate:
    """In how many cohorts any of the ten items is found to differ after Holm's or Bonferroni's correction, which agree
    on whether anything is."""
    random = np.random.default_rng([seed, 33])
    found = 0
    for first in range(0, cohorts, AT_ONCE):
        size = (min(AT_ONCE, cohorts - first), len(ITEMS), participants, len(CONDITIONS))
        own = random.normal(0, math.sqrt(PERSONAL_SHARE), (*size[:3], 1))
        ratings = rate_opinions(own + random.normal(0, math.sqrt(1 - PERSONAL_SHARE), size), points)
        found += int((friedman_p(ratings).min(axis=1) * len(ITEMS) <= alpha).sum())
    return rate("Friedman, any item, corrected, ratings alone", found, cohorts)


def friedman_p(ratings: NDArray[np.int64]) -> Doubles:
    """p (...) of Friedman's tests of ratings (..., people, conditions), ties corrected, as `analysis` has them."""
    n, k = ratings.shape[-2:]
    one, other = ratings[..., :, None], ratings[..., None, :]
    equal = (one == other).sum(axis=-1)  # oneself included
    ranks = (one > other).sum(axis=-1) + (equal + 1) / 2
    ties = (equal**2 - 1).sum(axis=(-1, -2))  # sum of t^3 - t over groups of t alike: each of the t brings t^2 - 1
    spread = np.square(ranks.sum(axis=-2)).sum(axis=-1)
    statistic = (12 / (n * k * (k + 1)) * spread - 3 * n * (k + 1)) / (1 - ties / (n * k * (k**2 - 1)))
    if n > FEW or k != 3:
        return np.asarray(stats.chi2.sf(statistic, k - 1))
    return _exact_p(ranks)


def _exact_p(ranks: Doubles) -> Doubles:
    """p of ranks (..., people, 3) by the exact distributions, one for each mixture of ties."""
    n = ranks.shape[-2]
    away = ((ranks.sum(axis=-2) - 2 * n) ** 2).sum(axis=-1)
    low, high = (np.sort(ranks, axis=-1)[..., k] for k in (0, 2))
    mixture = np.stack([((low == a) & (high == b)).sum(axis=-1) for a, b in TIES], axis=-1)
    p = np.empty(away.shape)
    for some in np.unique(mixture.reshape(-1, len(TIES)), axis=0):
        people = [TIES[ends] for ends, count in zip(TIES, some, strict=True) for _ in range(count)]
        values, at_least = spread_distribution(tuple(sorted(people)))
        here = (mixture == some).all(axis=-1)
        p[here] = at_least[np.minimum(len(values) - 1, np.searchsorted(values, away[here] - NEAR))]
    return p
