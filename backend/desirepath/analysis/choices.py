"""Tests and measures of choices: first places of forced rankings, agreement of a person's choices or of rankings, own
or other.

Here are the pairs, effect sizes, intervals and what a result says; p for few people is `exact.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from desirepath.analysis.estimates import wilson_interval
from desirepath.analysis.exact import equal_shares
from desirepath.analysis.intervals import UNKNOWN, clustered_share, share_of_chi_square
from desirepath.analysis.tested import Mean, Tested, name_pairs

Answer = TypeVar("Answer")


def equal_first_choices(counts: ArrayLike, *, about: str, intervals: bool = True) -> Tested:
    """Chi-square test of first choices (conditions,) against equal shares; effect: Cramer's V, sqrt(chi2 / (n (k-1))).

    p is exact (multinomial) for up to 50 people, beyond chi-square. intervals: of the effect, which take time.

    Raises ValueError for fewer than two conditions or nobody.
    """
    observed = _counts(counts)
    n, k = int(observed.sum()), len(observed)
    statistic = float(stats.chisquare(observed).statistic)
    p, least, method = equal_shares(observed)
    low, high = share_of_chi_square(statistic, k - 1, n * (k - 1)) if intervals else UNKNOWN
    return Tested(
        test="Chi-square", about=about, symbol="χ²", statistic=statistic, df=k - 1, p=p, p_corrected=p,
        correction="uncorrected", effect_name="Cramér's V", effect=math.sqrt(statistic / (n * (k - 1))), n=n, used=n,
        direction="first choices are not shared equally", method=method, least_p=least, least_p_corrected=least,
        effect_low=math.sqrt(low), effect_high=math.sqrt(high),
    )  # fmt: skip


def first_choice_pairs(counts: ArrayLike, names: Sequence[str], *, about: str) -> list[Tested]:
    """Test of every two conditions' first choices, two-sided, uncorrected: z, with the exact binomial p.

    The choices exclude each other, so under equal popularity a - b of the a + b people who chose one of the two has
    variance a + b: z = (a - b) / sqrt(a + b). (A z-test of two independent proportions would take the same people for
    two samples.) Effect: Cohen's g with its sign, a / (a + b) - 0.5, with Wilson's interval.
    """
    observed = _counts(counts)
    tests = []
    for i, j, words, (first, second) in name_pairs(names, about):
        a, b = int(observed[i]), int(observed[j])
        z = (a - b) / math.sqrt(a + b) if a + b else 0.0
        more, fewer = (first, second) if a >= b else (second, first)
        direction = f"{more} is more often the first choice than {fewer}"
        of_all = int(observed.sum())
        tests.append(_cohens_g("z of first choices", "z", z, a, b, about=words, n=of_all, direction=direction))
    return tests


def _cohens_g(
    test: str, symbol: str, statistic: float, first: int, second: int, *, about: str, n: int, direction: str
) -> Tested:
    """The exact binomial test of so many choices of two, two-sided; effect: Cohen's g, with Wilson's interval."""
    used = first + second
    p, least, effect, (low, high) = 1.0, 1.0, 0.0, UNKNOWN
    if used:
        p, least = float(stats.binomtest(first, used).pvalue), min(1.0, 2.0 ** (1 - used))
        effect = first / used - 0.5
        low, high = (end - 0.5 for end in wilson_interval(first / used, used))
    return Tested(
        test=test, about=about, symbol=symbol, statistic=statistic, df=None, p=p, p_corrected=p,
        correction="uncorrected", effect_name="Cohen's g", effect=effect, n=n, used=used, direction=direction,
        method="exact", least_p=least, least_p_corrected=least, effect_low=low, effect_high=high,
    )  # fmt: skip


def _counts(counts: ArrayLike) -> NDArray[np.float64]:
    observed = np.asarray(counts, dtype=float)
    if observed.ndim != 1 or len(observed) < 2 or (observed < 0).any() or not observed.sum() > 0:
        raise ValueError(f"counts = {observed.tolist()}: needs at least two conditions and one choice")
    return observed


def agreement(first: ArrayLike, second: ArrayLike) -> float:
    """Share of equal answers of one person, first (n,) and second (n,) to the same n questions. NaN for none."""
    a, b = np.asarray(first), np.asarray(second)
    if a.shape != b.shape:
        raise ValueError(f"answers: {a.shape} and {b.shape}; must be answers to the same questions")
    return float((a == b).mean()) if a.size else math.nan


def cohens_kappa(first: ArrayLike, second: ArrayLike) -> float:
    """Cohen's kappa (1960) of two lists of labels (n,): agreement beyond what the labels' shares alone would give.

    NaN where chance alone would give full agreement (both always say the same one label), or for none. Not
    statsmodels', which computes standard errors too: a power analysis asks for everybody's in thousands of studies.
    """
    a, b = np.asarray(first), np.asarray(second)
    observed = agreement(a, b)
    labels = np.union1d(a, b)
    expected = float(sum((a == label).mean() * (b == label).mean() for label in labels)) if a.size else math.nan
    return (observed - expected) / (1 - expected) if expected < 1 else math.nan


def sign_test(wins: Sequence[int], losses: Sequence[int], *, about: str, names: tuple[str, str]) -> Tested:
    """Sign test over people: who chose the first of two more often than the second. Each person counts once.

    wins, losses (n,): a person's choices of either. Answers of one person depend on each other, so people are the
    units; who chose both equally often is left out. Effect: share of people who mostly chose the first, minus 0.5.
    """
    differences = np.asarray(wins) - np.asarray(losses)
    more, fewer = int((differences > 0).sum()), int((differences < 0).sum())
    first, second = names if more >= fewer else names[::-1]
    direction = f"{first} is mostly chosen over {second}"
    return _cohens_g("Sign test", "S", more, more, fewer, about=about, n=len(differences), direction=direction)


def binomial_test(right: int, people: int, *, about: str) -> Tested:
    """Exact binomial test of how many of so many people were right, against one half, two-sided; effect: Cohen's g."""
    direction = f"{'more' if 2 * right > people else 'fewer'} are right than by chance"
    return _cohens_g("Binomial", "S", right, right, people - right, about=about, n=people, direction=direction)


def share_over_people(wins: Sequence[int], losses: Sequence[int]) -> Mean:
    """Mean over people of the share of a person's choices that went to the first of two, interval over people."""
    counts = [(won, won + lost) for won, lost in zip(wins, losses, strict=True) if won + lost]
    return clustered_share([won / n for won, n in counts], [n for _, n in counts])
