"""Student's t-tests as a paper needs them: statistic, degrees of freedom, p, corrected p, effect size, n, a sentence.

scipy computes the tests; what is compared with what is decided by the reports.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from desirepath.analysis.tested import NO_SPREAD, has_spread, p_in_words, stars


@dataclass(frozen=True)
class TTest:
    """Two-sided. difference: mean of the first sample minus mean of the second, or minus the fixed value.

    n: sizes of the samples, 1 for a fixed value. effect_size: Cohen's d, of the pooled standard deviation.
    p_corrected: p itself until `holm` has corrected a family of tests. no_spread: nothing varies, so nothing can be
    tested; p is 1, statistic and effect size are NaN.
    """

    statistic: float
    df: float
    p: float
    p_corrected: float
    effect_size: float
    difference: float
    n: tuple[int, int]
    no_spread: bool = False

    @property
    def stars(self) -> str:
        """The thesis's marks (table 6.2) of the corrected p: * up to 0.05, ** up to 0.01, *** up to 0.001."""
        return stars(self.p_corrected)

    def sentence(self, first: str, second: str, unit: str) -> str:
        """The result in words: who differs from whom by how much, t, p and d."""
        direction = "higher than" if self.difference > 0 else "lower than"
        sentence = f"{first} is {abs(self.difference):.2f} {unit} {direction} {second}"
        if self.no_spread:
            return f"{sentence}; {NO_SPREAD}."
        return (
            f"{sentence}, t({self.df:g}) = {self.statistic:.2f}, {p_in_words(self.p_corrected)} (Holm), d = "
            f"{self.effect_size:.2f}."
        )


def student_t(first: ArrayLike, second: ArrayLike) -> TTest:
    """Student's t-test of two independent samples (n,) and (m,), equal variances assumed, as in the thesis's table 6.2;
    or of one sample against a fixed value.

    Raises ValueError for fewer than two numbers in a sample or numbers that are not finite.
    """
    samples = [np.asarray(values, dtype=float) for values in (first, second)]
    fixed = samples[1].ndim == 0
    for name, data in zip(("first", "second"), samples[: 1 if fixed else 2], strict=False):
        if data.ndim != 1 or len(data) < 2 or not np.isfinite(data).all():
            raise ValueError(f"{name}: shape {data.shape}; a t-test needs at least 2 finite numbers in one row")
    difference = float(samples[0].mean() - samples[1].mean())
    n = len(samples[0]), samples[1].size
    df = n[0] - 1 if fixed else sum(n) - 2
    if not any(has_spread(data) for data in samples):
        return TTest(math.nan, df, 1.0, 1.0, math.nan, difference, n, no_spread=True)
    result = stats.ttest_1samp(samples[0], samples[1]) if fixed else stats.ttest_ind(*samples, equal_var=True)
    deviation = math.sqrt(sum(float(np.square(data - data.mean()).sum()) for data in samples) / df)
    p = float(result.pvalue)
    return TTest(float(result.statistic), df, p, p, difference / deviation, difference, n)
