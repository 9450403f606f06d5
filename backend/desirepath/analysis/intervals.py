"""95 % intervals: of shares and rank correlations over few people, of effects of chi-square and F, of shifts in the
unit of the scale. None leaves the range of what it is about, and none has the width 0 unless all is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, stats

from desirepath.analysis.estimates import Interval, wilson_interval
from desirepath.analysis.exact import FEW, rank_sum, signed_ranks
from desirepath.analysis.tested import Mean, has_spread

UNKNOWN: Interval = (math.nan, math.nan)
CONFIDENCE = 0.95


def clustered_share(shares: ArrayLike, sizes: ArrayLike | None = None) -> Mean:
    """Mean over people of their shares (n,), with an interval that takes people, not answers, for what was sampled.

    sizes (n,): answers behind each share. Wilson's interval of as many independent answers as would vary as much as
    these means do (the effective sample size of Kish 1965 and of Korn and Graubard 1998), no fewer than people and no
    more than answers, with Student's t. Shares that are not finite are left out; one person alone has no interval.
    """
    values = np.asarray(shares, dtype=float)
    known = np.isfinite(values)
    most = float(np.asarray(sizes, dtype=float)[known].sum()) if sizes is not None else math.inf
    values = values[known]
    n = len(values)
    if n < 2:
        return Mean(n, float(values[0]) if n else math.nan, *[math.nan] * 4)
    mean, sd = float(values.mean()), float(values.std(ddof=1))
    low, high = bound_share(mean, sd / math.sqrt(n), n, most=most)
    return Mean(n, mean, sd, sd / math.sqrt(n), low, high)


def bound_share(share: float, se: float, n: int, *, most: float = math.inf) -> Interval:
    """Wilson's interval of a share in [0, 1] with standard error se over n people. most: answers behind it."""
    spread = share * (1 - share)
    answers = min(most, max(float(n), spread / se**2 if se > 0 else (math.inf if spread > 0 else float(n))))
    if math.isinf(answers):
        return UNKNOWN  # everybody the same, of unknown precision
    return wilson_interval(share, answers, float(stats.t.ppf((1 + CONFIDENCE) / 2, n - 1)))


def correlation_like(estimate: float, se: float, n: int) -> Interval:
    """Interval of an effect in [-1, 1] that is twice a share less one, as the rank-biserial correlation is."""
    low, high = bound_share((estimate + 1) / 2, se / 2, n)
    return 2 * low - 1, 2 * high - 1


def jackknife_se(values: Sequence[float]) -> float:
    """Standard error from the estimates without each of n units in turn (Tukey 1958)."""
    left = np.asarray(values, dtype=float)
    n = len(left)
    return float(math.sqrt((n - 1) / n * ((left - left.mean()) ** 2).sum())) if n > 1 else math.nan


def share_of_chi_square(statistic: float, df: float, most: float) -> Interval:
    """Interval of an effect that is a chi-square statistic over its largest value `most` (Kendall's W, epsilon squared;
    Cramer's V is its root): by the noncentral chi-square distributions under which it would be just as surprising."""
    return _noncentral(lambda ncp: float(stats.ncx2.cdf(statistic, df, ncp)), statistic, most)


def partial_eta_squared(statistic: float, df: float, df_error: float) -> Interval:
    """Interval of partial eta squared of an F statistic (Smithson 2001), by noncentral F distributions."""
    if not math.isfinite(statistic):
        return UNKNOWN

    def below(ncp: float) -> float:
        return float(stats.ncf.cdf(statistic, df, df_error, ncp))

    low, high = _noncentral(below, statistic * df, math.inf)
    return low / (low + df + df_error + 1), high / (high + df + df_error + 1)


def _noncentral(below: Callable[[float], float], start: float, most: float) -> Interval:
    """Ends by search: scipy's inverses (`ncfdtrinc`, `chndtrinc`) are right to three digits, and not a number at 0."""
    ends = []
    for chance in ((1 + CONFIDENCE) / 2, (1 - CONFIDENCE) / 2):
        top = 10 * (start + 10)
        if below(1e-9) <= chance:
            ends.append(0.0)
            continue
        ends.append(float(optimize.brentq(lambda ncp, at=chance: below(ncp) - at, 1e-9, top)))
    scale = most if math.isfinite(most) else 1.0
    low, high = (min(1.0, end / scale) if math.isfinite(most) else end for end in ends)
    return low, high


def signed_rank_shift(differences: ArrayLike) -> tuple[float, Interval]:
    """Hodges and Lehmann's median shift of differences (n,), with the interval of shifts that Wilcoxon's signed-rank
    test would not reject; an end is infinite where no shift is rejected. Pairs without a difference stay in."""
    values = np.sort(np.asarray(differences, dtype=float))
    n = len(values)
    i, j = np.triu_indices(n)
    walsh = np.sort((values[i] + values[j]) / 2)
    return float(np.median(walsh)), _invert_test(walsh, _least_signed(n))


def rank_sum_shift(first: ArrayLike, second: ArrayLike) -> tuple[float, Interval]:
    """Hodges and Lehmann's shift between two groups (n,) and (m,), first minus second, with the interval of shifts that
    the rank-sum test would not reject."""
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    differences = np.sort(np.subtract.outer(a, b).ravel())
    return float(np.median(differences)), _invert_test(differences, _least_sum(len(a), len(b)))


def _invert_test(sorted_values: np.ndarray, out: int) -> Interval:
    """The interval that leaves out `out` of the sorted values at each end; unknown where that leaves a single value."""
    if out < 1:
        return -math.inf, math.inf
    low, high = float(sorted_values[out - 1]), float(sorted_values[-out])
    return (low, high) if has_spread([low, high]) else UNKNOWN


@lru_cache(maxsize=128)
def _least_signed(n: int) -> int:
    """How many of the n (n + 1) / 2 means of pairs lie outside a 95 % interval at each end: the quantile of W."""
    if n > FEW:
        return int(stats.norm.ppf((1 - CONFIDENCE) / 2, n * (n + 1) / 4, math.sqrt(n * (n + 1) * (2 * n + 1) / 24)))
    ranks = np.arange(1, n + 1)
    w = 0
    while signed_ranks(ranks, w).p <= 1 - CONFIDENCE:
        w += 1
    return w


@lru_cache(maxsize=512)
def _least_sum(n: int, m: int) -> int:
    if n + m > FEW:
        return int(stats.norm.ppf((1 - CONFIDENCE) / 2, n * m / 2, math.sqrt(n * m * (n + m + 1) / 12)))
    ranks = np.arange(1, n + m + 1)
    u = 0
    while rank_sum(ranks, n, u + n * (n + 1) / 2).p <= 1 - CONFIDENCE:
        u += 1
    return u


def end_at_scale(mean: Mean, lowest: float, highest: float) -> Mean:
    """A mean of ratings with its interval, where it has one, ended at the ends of the scale."""
    if math.isnan(mean.low):
        return mean
    return Mean(mean.n, mean.mean, mean.sd, mean.se, max(lowest, mean.low), min(highest, mean.high))
