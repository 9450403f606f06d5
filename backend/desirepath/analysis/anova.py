"""Analysis of variance of repeated measures, effect by effect, with what it assumes and the ranks beside it.

Sums of squares and contrasts are `factorial.py`'s; what is compared, and with what names, the reports'. statsmodels'
`AnovaRM` says the same of factors within people, without groups and without Greenhouse and Geisser's correction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from desirepath.analysis.factorial import Factorial, aligned_ranks, contrast_scores, f_test
from desirepath.analysis.intervals import UNKNOWN, partial_eta_squared
from desirepath.analysis.tested import Tested


@dataclass(frozen=True)
class Assumptions:
    """What the F of an effect assumes. shapiro_p: of the people's contrasts (Shapiro and Wilk), nan where they are all
    alike. epsilon: Greenhouse and Geisser's, 1 with one degree of freedom within people, where sphericity cannot be
    violated. ranks: the aligned rank transform of the same effect.
    """

    shapiro_p: float
    epsilon: float
    ranks: Tested

    def normal(self, alpha: float = 0.05) -> bool:
        """Whether nothing speaks against normal contrasts."""
        return math.isnan(self.shapiro_p) or self.shapiro_p > alpha


def rm_anova(design: Factorial, *, about: str, intervals: bool = True) -> list[Tested]:
    """F of every effect of factors within people, and between them, uncorrected, in the order of `Factorial.effects`.

    Each effect has its own error (people x effect). Effect: partial eta squared, with Smithson's interval. Direction of
    two levels: which has the higher mean.
    """
    return [_one(design, effect, about=about, intervals=intervals) for effect in design.effects]


def _one(design: Factorial, effect: tuple[str, ...], *, about: str, intervals: bool) -> Tested:
    statistic, df, df_error, p = f_test(design, effect)
    low, high = partial_eta_squared(statistic, df, df_error) if intervals else UNKNOWN
    n, untestable = len(design.values), math.isnan(statistic)
    return Tested(
        test="Repeated-measures ANOVA" if design.within else "ANOVA", about=f"{about}, {' × '.join(effect)}",
        symbol="F", statistic=statistic, df=df, df_error=df_error, p=p, p_corrected=p, correction="uncorrected",
        effect_name="partial η²", effect=statistic * df / (statistic * df + df_error), n=n, used=n,
        direction=_direction(design, effect), effect_low=low, effect_high=high, least_p=1.0 if untestable else 0.0,
        no_spread=untestable,
    )  # fmt: skip


def _direction(design: Factorial, effect: Sequence[str]) -> str:
    if len(effect) > 1:
        return f"the effect of {effect[0]} depends on {' and '.join(effect[1:])}"
    levels = {**design.within, **design.between}[effect[0]]
    if len(levels) > 2 or effect[0] not in design.within:
        return f"the levels of {effect[0]} differ"
    first = float(contrast_scores(design, effect)[:, 0].mean())  # Helmert: first level less second
    higher, lower = levels if first > 0 else levels[::-1]
    return f"higher {higher} than {lower}"


def assumptions(design: Factorial, effect: tuple[str, ...], *, about: str, intervals: bool = True) -> Assumptions:
    """Whether the effect's people are as its F assumes, and what aligned ranks say instead."""
    scores = contrast_scores(design, effect)
    groups = design.groups
    left = scores - np.stack([scores[groups == g].mean(axis=0) for g in range(int(groups.max()) + 1)])[groups]
    spread = left.std(axis=0)
    used = left[:, spread > 1e-12] / spread[spread > 1e-12]
    p = float(stats.shapiro(used.ravel()).pvalue) if used.size >= 3 and used.size < 5_000 else math.nan
    covariance, d = left.T @ left, scores.shape[1]
    epsilon = float(np.trace(covariance) ** 2 / (d * (covariance**2).sum())) if d > 1 and used.size else 1.0
    ranks = aligned_ranks(design, effect, about=about, intervals=intervals)
    return Assumptions(p, epsilon, replace(ranks, correction="uncorrected"))
