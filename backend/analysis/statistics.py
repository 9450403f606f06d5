"""Student's t-tests as a paper needs them: statistic, degrees of freedom, p, corrected p, effect size, n, a sentence.

scipy computes the tests; what is compared with what is decided by the reports.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats


@dataclass(frozen=True)
class TTest:
    """Two-sided. difference: mean of the first sample minus mean of the second, or minus the fixed value.

    n: sizes of the samples, 1 for a fixed value. effect_size: Cohen's d, of the pooled standard deviation.
    p_corrected: p itself until `holm` has corrected a family of tests.
    """

    statistic: float
    df: float
    p: float
    p_corrected: float
    effect_size: float
    difference: float
    n: tuple[int, int]

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @property
    def stars(self) -> str:
        """The thesis's marks (table 6.2) of the corrected p: * up to 0.05, ** up to 0.01, *** up to 0.001."""
        return "".join("*" for bound in (0.05, 0.01, 0.001) if self.p_corrected <= bound)

    def sentence(self, first: str, second: str, unit: str) -> str:
        """The result in words: who differs from whom by how much, t, p and d."""
        direction = "higher than" if self.difference > 0 else "lower than"
        told = f"{first} is {abs(self.difference):.2f} {unit} {direction} {second}"
        return (
            f"{told}, t({self.df:g}) = {self.statistic:.2f}, {told_p(self.p_corrected)} (Holm), d = "
            f"{self.effect_size:.2f}."
        )


def told_p(p: float) -> str:
    """p as papers write it."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def _sample(name: str, values: ArrayLike) -> tuple[float, float, int]:
    data = np.asarray(values, dtype=float)
    if data.ndim != 1 or len(data) < 2 or not np.isfinite(data).all():
        raise ValueError(f"{name}: shape {data.shape}; a t-test needs at least 2 finite numbers in one row")
    return float(data.mean()), float(data.var(ddof=1)), len(data)


def student_t(first: ArrayLike, second: ArrayLike) -> TTest:
    """Student's t-test of two independent samples (n,) and (m,), equal variances assumed, as in the thesis's table 6.2.

    Raises ValueError for fewer than two numbers in a sample or numbers that are not finite.
    """
    (mean_a, var_a, n_a), (mean_b, var_b, n_b) = _sample("first", first), _sample("second", second)
    result = stats.ttest_ind(first, second, equal_var=True)
    pooled = math.sqrt(((n_a - 1) * var_a + (n_b - 1) * var_b) / (n_a + n_b - 2))
    difference = mean_a - mean_b
    p = float(result.pvalue)
    return TTest(float(result.statistic), float(result.df), p, p, _ratio(difference, pooled), difference, (n_a, n_b))


def student_t_against(values: ArrayLike, fixed: float) -> TTest:
    """Student's t-test of one sample (n,) against a fixed value. Raises ValueError as `student_t` does."""
    mean, variance, n = _sample("values", values)
    result = stats.ttest_1samp(values, fixed)
    p = float(result.pvalue)
    difference = mean - fixed
    return TTest(
        float(result.statistic), float(result.df), p, p, _ratio(difference, math.sqrt(variance)), difference, (n, 1)
    )


def _ratio(difference: float, deviation: float) -> float:
    return difference / deviation if deviation > 0 else math.copysign(math.inf, difference) if difference else 0.0


def holm(tests: Sequence[TTest]) -> list[TTest]:
    """The same tests with p corrected for their number by Holm's step-down method (1979), in the order given."""
    order = np.argsort([test.p for test in tests])
    corrected = list(tests)
    largest = 0.0
    for rank, k in enumerate(order):
        largest = max(largest, min(1.0, (len(tests) - rank) * tests[k].p))
        corrected[k] = replace(tests[k], p_corrected=largest)
    return corrected


def mean_interval(values: ArrayLike) -> tuple[float, float, float]:
    """Mean of (n,) with its 95 % interval by Student's t: (mean, low, high). A single value has no interval: NaN."""
    data = np.asarray(values, dtype=float)
    if len(data) < 2:
        return float(data.mean()), math.nan, math.nan
    half = float(stats.t.ppf(0.975, len(data) - 1) * data.std(ddof=1) / math.sqrt(len(data)))
    return float(data.mean()), float(data.mean()) - half, float(data.mean()) + half
