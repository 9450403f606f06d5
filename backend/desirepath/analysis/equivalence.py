"""What speaks for no difference: two one-sided tests within a declared margin, and Bayes factors.

That a test found nothing shows neither; both are done only where a plan declares them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import integrate, special, stats

from desirepath.analysis.tested import Tested, has_spread

PRIOR_SCALE = math.sqrt(2) / 2  # of the Cauchy prior on effect sizes, the default of R's BayesFactor


def equivalence(differences: ArrayLike, margin: float, *, about: str) -> Tested:
    """Two one-sided t-tests (Schuirmann 1987) that the mean of differences (n,) lies within +- margin; p: the larger.

    statsmodels' `ttost_mean` says the same, without an interval, and takes a second to load.
    Effect: the mean difference, with the 90 % interval that lies within the margin exactly where p is at most 0.05.
    Raises ValueError for fewer than two or numbers that are not finite.
    Everybody's difference the same is no evidence about others: not testable, without an interval.
    """
    data = np.asarray(differences, dtype=float)
    if data.ndim != 1 or len(data) < 2 or not np.isfinite(data).all() or margin <= 0:
        raise ValueError(f"differences: shape {data.shape}, margin = {margin}; needs at least 2 numbers and a margin")
    n, mean, se = len(data), float(data.mean()), float(data.std(ddof=1) / math.sqrt(len(data)))
    df = n - 1
    t, p, half, spread = math.nan, 1.0, math.nan, has_spread(data)
    if spread:
        t = (abs(mean) - margin) / se
        p = float(stats.t.cdf(t, df))
        half = float(stats.t.ppf(0.95, df)) * se
    return Tested(
        test="Equivalence (TOST)", about=f"{about}, within ±{margin:g}", symbol="t", statistic=t, df=df, p=p,
        p_corrected=p, correction="uncorrected", effect_name="mean difference", effect=mean, n=n, used=n,
        direction=f"the difference is smaller than {margin:g}", effect_low=mean - half, effect_high=mean + half,
        least_p=0.0 if spread else 1.0, no_spread=not spread,
    )  # fmt: skip


def bayes_factor(differences: ArrayLike) -> float:
    """How much likelier the differences (n,) are if their mean is not 0 than if it is: Jeffreys, Zellner and Siow's
    Bayes factor of a t-test (Rouder et al. 2009, equation 1, with its Cauchy prior). NaN without spread."""
    data = np.asarray(differences, dtype=float)
    if not has_spread(data):
        return math.nan
    n, deviation = len(data), float(data.std(ddof=1))
    df, square = n - 1, (data.mean() / deviation) ** 2 * n

    def likelihood(g: float) -> float:
        inner = 1 + n * g * PRIOR_SCALE**2
        prior = (2 * math.pi) ** -0.5 * g**-1.5 * math.exp(-1 / (2 * g))
        return float(inner**-0.5 * (1 + square / (inner * df)) ** (-(df + 1) / 2) * prior)

    alternative = integrate.quad(likelihood, 0, math.inf)[0]
    return float(alternative / (1 + square / df) ** (-(df + 1) / 2))


def bayes_factor_of_choices(first: int, second: int) -> float:
    """How much likelier so many choices of two are if their chance may be anything than if it is one half."""
    return float(math.exp(special.betaln(first + 1, second + 1) + (first + second) * math.log(2)))
