"""Tests of the same people's ratings under several conditions: Friedman, then Wilcoxon's signed ranks, pair by pair.

scipy computes the statistics and p; here are effect sizes and what a result says.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from backend.analysis.tested import Tested

Array = NDArray[np.float64]


def friedman(ratings: ArrayLike, *, about: str) -> Tested:
    """Friedman's test of ratings (people, conditions), ties corrected; effect: Kendall's W, 0 to 1.

    p is the chi-square approximation, which is conservative for few people. Everybody rating all conditions alike is
    no difference: p = 1. Raises ValueError for fewer than 2 people or 3 conditions, or numbers that are not finite.
    """
    data = _table("ratings", ratings, conditions=3)
    n, k = data.shape
    if (data == data[:, :1]).all():
        statistic, p = 0.0, 1.0
    else:
        result = stats.friedmanchisquare(*data.T)
        statistic, p = float(result.statistic), float(result.pvalue)
    return Tested(
        test="Friedman", about=about, symbol="χ²", statistic=statistic, df=k - 1, p=p, p_corrected=p,
        correction="uncorrected", effect_name="Kendall's W", effect=statistic / (n * (k - 1)), n=n, used=n,
        direction="the conditions differ",
    )  # fmt: skip


def wilcoxon(first: ArrayLike, second: ArrayLike, *, about: str, names: tuple[str, str]) -> Tested:
    """Wilcoxon's signed-rank test of pairs first (n,), second (n,), two-sided; statistic W: the smaller rank sum.

    Pairs without a difference are left out (Wilcoxon's own way, `zero_method="wilcox"`). p is exact up to 50 pairs
    without ties, else by scipy's choice (permutations of few pairs, otherwise the normal approximation with the ties'
    correction). Effect: the matched-pairs rank-biserial correlation (R+ - R-) / (R+ + R-), positive where `first` is
    higher. z: W's normal approximation with the ties' correction and none for continuity, never above 0, as in the
    thesis's table 2.2. Raises ValueError as `friedman` does.
    """
    data = _table("pairs", np.stack([np.asarray(first, float), np.asarray(second, float)], axis=1), conditions=2)
    differences = data[:, 0] - data[:, 1]
    differences = np.round(differences[differences != 0], 12)  # shares such as 2/3 - 1/3 and 1/3 - 0 are ties
    statistic, p, effect, z = 0.0, 1.0, 0.0, 0.0
    if len(differences):
        ranks = stats.rankdata(np.abs(differences))
        effect = float((np.sign(differences) * ranks).sum() / ranks.sum())
        result = stats.wilcoxon(differences, zero_method="wilcox", alternative="two-sided", method="auto")
        statistic, p = float(result.statistic), float(result.pvalue)
        z = float((statistic - ranks.sum() / 2) / np.sqrt((ranks**2).sum() / 4))
    higher, lower = names if effect >= 0 else names[::-1]
    return Tested(
        test="Wilcoxon signed-rank", about=about, symbol="W", statistic=statistic, df=None, p=p, p_corrected=p,
        correction="uncorrected", effect_name="rank-biserial r", effect=effect, n=len(data), used=len(differences),
        direction=f"higher for {higher} than for {lower}", z=z,
    )  # fmt: skip


def pairs_of(ratings: ArrayLike, names: Sequence[str], *, about: str) -> list[Tested]:
    """Wilcoxon's test of every pair of conditions of ratings (people, conditions), uncorrected."""
    data = np.asarray(ratings, dtype=float)
    return [
        wilcoxon(data[:, i], data[:, j], about=f"{about}, {names[i]} against {names[j]}", names=(names[i], names[j]))
        for i, j in combinations(range(len(names)), 2)
    ]


def _table(name: str, values: ArrayLike, *, conditions: int) -> Array:
    data = np.asarray(values, dtype=float)
    if data.ndim != 2 or len(data) < 2 or data.shape[1] < conditions or not np.isfinite(data).all():
        raise ValueError(
            f"{name}: shape {data.shape}; needs at least 2 people, at least {conditions} conditions and finite numbers"
        )
    return data
