"""Tests of groups of different people: Mann and Whitney's of two, Kruskal and Wallis's of more.

Effect sizes, intervals and what a result says are here; p for few people is `exact.py`'s, since scipy counts exactly
only where nobody ties.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from desirepath.analysis.exact import group_ranks, rank_sum
from desirepath.analysis.intervals import UNKNOWN, correlation_like, rank_sum_shift, share_of_chi_square
from desirepath.analysis.tested import Tested, name_pairs

Array = NDArray[np.float64]


def mann_whitney(
    first: ArrayLike, second: ArrayLike, *, about: str, names: tuple[str, str], intervals: bool = True
) -> Tested:
    """Mann and Whitney's test of two groups first (n,), second (m,), two-sided; statistic U of the first.

    p is exact for up to 50 people, ties or not, else the normal approximation with the ties' correction. Effect: the
    rank-biserial correlation (Cliff's delta), the chance that one of the first is higher than one of the second minus
    the chance that they are lower; shift: Hodges and Lehmann's, with the test's interval. Raises ValueError for an
    empty group or numbers that are not finite.
    """
    a, b = _group(names[0], first), _group(names[1], second)
    ranks = stats.rankdata(np.concatenate([a, b]))
    total = float(ranks[: len(a)].sum())
    u = total - len(a) * (len(a) + 1) / 2
    tied = bool(np.ptp(ranks) == 0)
    p, least, method = (1.0, 1.0, "exact") if tied else rank_sum(ranks, len(a), total)
    effect = 2 * u / (len(a) * len(b)) - 1
    low, high = _interval(a, b, effect) if intervals and not tied else UNKNOWN
    shift, (shift_low, shift_high) = rank_sum_shift(a, b) if intervals else (None, UNKNOWN)
    higher, lower = names if effect >= 0 else names[::-1]
    n = len(a) + len(b)
    return Tested(
        test="Mann-Whitney", about=about, symbol="U", statistic=u, df=None, p=p, p_corrected=p,
        correction="uncorrected", effect_name="rank-biserial r", effect=effect, n=n, used=n,
        direction=f"higher for {higher} than for {lower}", method=method, least_p=least, least_p_corrected=least,
        effect_low=low, effect_high=high, shift=shift, shift_low=shift_low, shift_high=shift_high, no_spread=tied,
    )  # fmt: skip


def _interval(a: Array, b: Array, effect: float) -> tuple[float, float]:
    """By how much the estimate varies with who is in either group (DeLong's variance), over the smaller group."""
    if min(len(a), len(b)) < 2:
        return float("nan"), float("nan")
    dominance = np.sign(np.subtract.outer(a, b))
    variance = dominance.mean(axis=1).var(ddof=1) / len(a) + dominance.mean(axis=0).var(ddof=1) / len(b)
    return correlation_like(effect, float(np.sqrt(variance)), min(len(a), len(b)))


def kruskal_wallis(groups: Sequence[ArrayLike], *, about: str, intervals: bool = True) -> Tested:
    """Kruskal and Wallis's test of three or more groups, each (n,), ties corrected; effect: epsilon squared, 0 to 1.

    p is by permutations for up to 50 people, beyond chi-square. Raises ValueError as `mann_whitney` does.
    """
    samples = [_group(f"group {k + 1}", group) for k, group in enumerate(groups)]
    if len(samples) < 3:
        raise ValueError(f"groups: {len(samples)}; needs at least 3")
    ranks = stats.rankdata(np.concatenate(samples))
    n, sizes = len(ranks), tuple(map(len, samples))
    spread = float(((ranks - ranks.mean()) ** 2).sum())
    statistic, p, least, method = 0.0, 1.0, 1.0, "exact"
    if spread > 0:
        means = [part.mean() for part in np.split(ranks, np.cumsum(sizes)[:-1])]
        about_mean = sum(size * (mean - ranks.mean()) ** 2 for size, mean in zip(sizes, means, strict=True))
        statistic = float((n - 1) * about_mean / spread)
        p, least, method = group_ranks(ranks, sizes)
    df = len(samples) - 1
    low, high = share_of_chi_square(statistic, df, n - 1) if intervals and spread > 0 else UNKNOWN
    return Tested(
        test="Kruskal-Wallis", about=about, symbol="H", statistic=statistic, df=df, p=p, p_corrected=p,
        correction="uncorrected", effect_name="epsilon²", effect=statistic / (n - 1), n=n, used=n,
        direction="the groups differ", method=method, least_p=least, least_p_corrected=least, effect_low=low,
        effect_high=high, no_spread=spread == 0,
    )  # fmt: skip


def group_pairs(
    groups: Sequence[ArrayLike], names: Sequence[str], *, about: str, intervals: bool = True
) -> list[Tested]:
    """Mann and Whitney's test of every two groups, uncorrected."""
    return [
        mann_whitney(groups[i], groups[j], about=words, names=pair, intervals=intervals)
        for i, j, words, pair in name_pairs(names, about)
    ]


def _group(name: str, values: ArrayLike) -> Array:
    data = np.asarray(values, dtype=float)
    if data.ndim != 1 or not len(data) or not np.isfinite(data).all():
        raise ValueError(f"{name}: shape {data.shape}; needs at least one person and finite numbers")
    return data
