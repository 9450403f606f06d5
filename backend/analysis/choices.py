"""Tests and measures of choices: first places of forced rankings, agreement of the same person's choices, own or other.

scipy computes chi-square and binomial tests; here are the pairs, effect sizes and what a result says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from backend.analysis.tested import Mean, Tested, mean_of

Answer = TypeVar("Answer")


def equal_first_choices(counts: ArrayLike, *, about: str) -> Tested:
    """Chi-square test of first choices (conditions,) against equal shares; effect: Cramer's V, sqrt(chi2 / (n (k-1))).

    Raises ValueError for fewer than two conditions or nobody.
    """
    observed = _counts(counts)
    n, k = int(observed.sum()), len(observed)
    result = stats.chisquare(observed)
    statistic, p = float(result.statistic), float(result.pvalue)
    return Tested(
        test="Chi-square", about=about, symbol="χ²", statistic=statistic, df=k - 1, p=p, p_corrected=p,
        correction="uncorrected", effect_name="Cramér's V", effect=math.sqrt(statistic / (n * (k - 1))), n=n, used=n,
        direction="first choices are not shared equally",
    )  # fmt: skip


def first_choice_pairs(counts: ArrayLike, names: Sequence[str], *, about: str) -> list[Tested]:
    """z-test of every two conditions' first choices, two-sided, uncorrected.

    The choices exclude each other, so under equal popularity a - b of the a + b people who chose one of the two has
    variance a + b: z = (a - b) / sqrt(a + b). (A z-test of two independent proportions would take the same people for
    two samples.) Effect: Cohen's g with its sign, a / (a + b) - 0.5.
    """
    observed = _counts(counts)
    tests = []
    for i, j in combinations(range(len(observed)), 2):
        a, b = float(observed[i]), float(observed[j])
        z = (a - b) / math.sqrt(a + b) if a + b else 0.0
        more, fewer = (names[i], names[j]) if a >= b else (names[j], names[i])
        p = float(2 * stats.norm.sf(abs(z)))
        tests.append(
            Tested(
                test="z of first choices",
                about=f"{about}, {names[i]} against {names[j]}",
                symbol="z",
                statistic=z,
                df=None,
                p=p,
                p_corrected=p,
                correction="uncorrected",
                effect_name="Cohen's g",
                effect=a / (a + b) - 0.5 if a + b else 0.0,
                n=int(observed.sum()),
                used=int(a + b),
                direction=f"{more} is more often the first choice than {fewer}",
            )
        )
    return tests


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

    NaN where chance alone would give full agreement (both always say the same one label), or for none.
    """
    a, b = np.asarray(first), np.asarray(second)
    observed = agreement(a, b)
    labels = np.union1d(a, b)
    expected = float(sum((a == label).mean() * (b == label).mean() for label in labels)) if a.size else math.nan
    return (observed - expected) / (1 - expected) if expected < 1 else math.nan


CHANCE_CIRCULAR = 0.25  # of three choices by three coins: two of the eight outcomes go round


def whole_triads(answers: Mapping[frozenset[str], Answer]) -> list[list[Answer]]:
    """The triads that were answered whole: the three answers about all pairs of three. answers: by the pair they are
    about, one person's under one condition."""
    found: dict[frozenset[str], list[Answer]] = {}
    for one, other in combinations(answers, 2):
        three = one | other
        if len(three) == 3 and one ^ other in answers:
            found.setdefault(three, [answers[pair] for pair in answers if pair <= three])
    return list(found.values())


def is_circular(choices: Sequence[tuple[str, str]]) -> bool:
    """Whether three choices (chosen, rejected) among three go round: each was chosen once (Kendall and Babington Smith
    1940). Raises ValueError unless they are the three pairs of three."""
    pairs = {frozenset(pair) for pair in choices}
    if len(choices) != 3 or len(pairs) != 3 or len(set().union(*pairs)) != 3:
        raise ValueError(f"choices = {list(choices)}: needs the three pairs of three")
    return len({chosen for chosen, _ in choices}) == 3


def mostly(wins: Sequence[int], losses: Sequence[int], *, about: str, names: tuple[str, str]) -> Tested:
    """Sign test over people: who chose the first of two more often than the second. Each person counts once.

    wins, losses (n,): a person's choices of either. Answers of one person depend on each other, so people are the
    units; who chose both equally often is left out. Effect: share of people who mostly chose the first, minus 0.5.
    """
    differences = np.asarray(wins) - np.asarray(losses)
    more, fewer = int((differences > 0).sum()), int((differences < 0).sum())
    p = float(stats.binomtest(more, more + fewer).pvalue) if more + fewer else 1.0
    first, second = names if more >= fewer else names[::-1]
    return Tested(
        test="Sign test", about=about, symbol="S", statistic=more, df=None, p=p, p_corrected=p,
        correction="uncorrected", effect_name="Cohen's g", effect=more / (more + fewer) - 0.5 if more + fewer else 0.0,
        n=len(differences), used=more + fewer, direction=f"{first} is mostly chosen over {second}",
    )  # fmt: skip


def share_over_people(wins: Sequence[int], losses: Sequence[int]) -> Mean:
    """Mean over people of the share of a person's choices that went to the first of two; interval over people, ended
    at 0 and 1."""
    mean = mean_of([won / (won + lost) for won, lost in zip(wins, losses, strict=True) if won + lost])
    return replace(mean, low=max(0.0, mean.low), high=min(1.0, mean.high)) if mean.n > 1 else mean
