"""Tests of the same people's ratings under several conditions: Friedman over all, Wilcoxon's signed ranks of two.

Effect sizes, intervals and what a result says are here; p for few people is `exact.py`'s, since scipy counts exactly
only where nobody ties. Statistics are a line each, where scipy's functions take milliseconds for a p that is not used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from desirepath.analysis.exact import rank_totals, signed_ranks
from desirepath.analysis.intervals import (
    UNKNOWN,
    correlation_like,
    jackknife_se,
    share_of_chi_square,
    signed_rank_shift,
)
from desirepath.analysis.tested import Tested, name_pairs

Array = NDArray[np.float64]


def friedman(ratings: ArrayLike, *, about: str, intervals: bool = True) -> Tested:
    """Friedman's test of ratings (people, conditions), ties corrected; effect: Kendall's W, 0 to 1.

    p is exact, or by permutations, for up to 50 people, ties or not (`exact.rank_totals`); beyond, chi-square.
    Everybody rating all conditions alike is no spread, not testable. intervals: of the effect, which take time. Raises
    ValueError for fewer than 2 people or 3 conditions, or numbers that are not finite.
    """
    data = _table("ratings", ratings, conditions=3)
    n, k = data.shape
    ranks = stats.rankdata(data, axis=1)
    spread = ((ranks - (k + 1) / 2) ** 2).sum()
    if spread == 0:
        statistic, p, least, method = 0.0, 1.0, 1.0, "exact"
    else:
        statistic = float((k - 1) * ((ranks.sum(axis=0) - n * (k + 1) / 2) ** 2).sum() / spread)
        p, least, method = rank_totals(ranks)
    low, high = share_of_chi_square(statistic, k - 1, n * (k - 1)) if intervals and spread else UNKNOWN
    return Tested(
        test="Friedman", about=about, symbol="χ²", statistic=statistic, df=k - 1, p=p, p_corrected=p,
        correction="uncorrected", effect_name="Kendall's W", effect=statistic / (n * (k - 1)), n=n, used=n,
        direction="the conditions differ", method=method, least_p=least, least_p_corrected=least, effect_low=low,
        effect_high=high, no_spread=bool(spread == 0),
    )  # fmt: skip


def wilcoxon(
    first: ArrayLike, second: ArrayLike, *, about: str, names: tuple[str, str], intervals: bool = True
) -> Tested:
    """Wilcoxon's signed-rank test of pairs first (n,), second (n,), two-sided; statistic W: the smaller rank sum.

    Pairs without a difference are left out (Wilcoxon's own way). p is exact for up to 50 pairs, ties or not, else the
    normal approximation with the ties' correction. Effect: the matched-pairs rank-biserial correlation (R+ - R-) /
    (R+ + R-), positive where `first` is higher; shift: Hodges and Lehmann's median difference with the test's interval.
    z: W's normal approximation with the ties' correction and none for continuity, never above 0, as in the thesis's
    table 2.2. Nobody with a difference is no spread, not testable. Raises ValueError as `friedman` does.
    """
    data = _table("pairs", np.stack([np.asarray(first, float), np.asarray(second, float)], axis=1), conditions=2)
    differences = np.round(data[:, 0] - data[:, 1], 12)  # shares such as 2/3 - 1/3 and 1/3 - 0 are ties
    used = differences[differences != 0]
    statistic, z, effect = 0.0, 0.0, _rank_biserial(used)
    p, least, method = 1.0, 1.0, "exact"
    if len(used):
        ranks = stats.rankdata(np.abs(used))
        positive = float(ranks[used > 0].sum())
        statistic = min(positive, float(ranks.sum()) - positive)
        p, least, method = signed_ranks(ranks, positive)
        z = float((statistic - ranks.sum() / 2) / np.sqrt((ranks**2).sum() / 4))
    low, high = _biserial_interval(used, effect) if intervals else UNKNOWN
    shift, (shift_low, shift_high) = signed_rank_shift(differences) if intervals else (None, UNKNOWN)
    higher, lower = names if effect >= 0 else names[::-1]
    return Tested(
        test="Wilcoxon signed-rank", about=about, symbol="W", statistic=statistic, df=None, p=p, p_corrected=p,
        correction="uncorrected", effect_name="rank-biserial r", effect=effect, n=len(data), used=len(used),
        direction=f"higher for {higher} than for {lower}", z=z, method=method, least_p=least, least_p_corrected=least,
        effect_low=low, effect_high=high, shift=shift, shift_low=shift_low, shift_high=shift_high,
        no_spread=len(used) == 0,
    )  # fmt: skip


def _rank_biserial(differences: Array) -> float:
    if not len(differences):
        return 0.0
    ranks = stats.rankdata(np.abs(differences))
    return float((np.sign(differences) * ranks).sum() / ranks.sum())


def _biserial_interval(differences: Array, effect: float) -> tuple[float, float]:
    """By the estimates without each person in turn; of fewer than two with a difference it is not known."""
    n = len(differences)
    if n < 2:
        return float("nan"), float("nan")
    se = jackknife_se([_rank_biserial(np.delete(differences, k)) for k in range(n)])
    return correlation_like(effect, se, n)


def pairs_of(ratings: ArrayLike, names: Sequence[str], *, about: str, intervals: bool = True) -> list[Tested]:
    """Wilcoxon's test of every pair of conditions of ratings (people, conditions), uncorrected."""
    data = np.asarray(ratings, dtype=float)
    return [
        wilcoxon(data[:, i], data[:, j], about=words, names=pair, intervals=intervals)
        for i, j, words, pair in name_pairs(names, about)
    ]


def _table(name: str, values: ArrayLike, *, conditions: int) -> Array:
    data = np.asarray(values, dtype=float)
    if data.ndim != 2 or len(data) < 2 or data.shape[1] < conditions or not np.isfinite(data).all():
        raise ValueError(
            f"{name}: shape {data.shape}; needs at least 2 people, at least {conditions} conditions and finite numbers"
        )
    return data
