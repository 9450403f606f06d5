"""Tests of designs with several factors, met by everybody or by groups: main effects and interactions one by one.

An effect with one degree of freedom within people is one contrast per person, tested by ranks; every other effect by an
analysis of variance of aligned ranks. What is compared, and with what names, is the reports' business.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, stats

from desirepath.analysis.between_groups import mann_whitney
from desirepath.analysis.intervals import UNKNOWN, partial_eta_squared
from desirepath.analysis.repeated_measures import wilcoxon
from desirepath.analysis.tested import Tested

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Factorial:
    """Values (people, cells of the factors within) with the cell of the factors between of each person (people,).

    within, between: factor -> levels; cells are all combinations of levels, the last factor fastest. A design without
    factors within has one cell, one without factors between one group, 0.
    """

    values: Array
    groups: NDArray[np.int64]
    within: Mapping[str, Sequence[str]]
    between: Mapping[str, Sequence[str]]

    def __post_init__(self) -> None:
        cells = int(np.prod([len(levels) for levels in self.within.values()], dtype=int))
        count = int(np.prod([len(levels) for levels in self.between.values()], dtype=int))
        values, sizes = np.asarray(self.values), np.bincount(self.groups, minlength=count)
        if values.shape != (len(self.groups), cells) or not np.isfinite(values).all():
            raise ValueError(f"values: shape {values.shape}; needs ({len(self.groups)}, {cells}) finite numbers")
        if len(sizes) != count or sizes.min() < 2:
            raise ValueError(f"groups: {sizes.tolist()} people; each of {count} needs at least 2")

    @property
    def effects(self) -> list[tuple[str, ...]]:
        return effects_of(self.within, self.between)


def effects_of(within: Iterable[str], between: Iterable[str]) -> list[tuple[str, ...]]:
    """Every main effect, then every interaction, factors within first."""
    names = [*within, *between]
    return [effect for size in range(1, len(names) + 1) for effect in combinations(names, size)]


def factorial_tests(design: Factorial, *, about: str, intervals: bool = True) -> list[Tested]:
    """The test of every effect, uncorrected, in the order of `Factorial.effects`.

    One degree of freedom, all of it within: Wilcoxon's signed ranks of the people's contrasts (half the differences of
    differences for 2 x 2), if there are no groups, or with groups their unweighted mean by aligned ranks. Two groups
    and one degree of freedom within: Mann and Whitney's test of the contrasts. Otherwise `aligned_ranks`.
    """
    return [_one(design, effect, about=about, intervals=intervals) for effect in design.effects]


def _one(design: Factorial, effect: tuple[str, ...], *, about: str, intervals: bool) -> Tested:
    words = f"{about}, {' × '.join(effect)}"
    inner, outer = [f for f in effect if f in design.within], [f for f in effect if f in design.between]
    contrast = _contrast(design.within, inner)
    two_groups = len(outer) == len(design.between) == 1 and len(design.between[outer[0]]) == 2
    if contrast.shape[1] == 1 and (not design.between or two_groups):
        own = design.values @ contrast[:, 0] / np.abs(contrast[:, 0]).sum() * 2 if inner else design.values.mean(axis=1)
        own = np.round(own, 10)  # what is the same must be tied
        names = _ends(design, inner)
        if not outer:
            test = wilcoxon(own, np.zeros(len(own)), about=words, names=names, intervals=intervals)
            return test if len(inner) == 1 else replace(test, direction=_depends(inner))
        of = design.between[outer[0]]
        sides = own[design.groups == 0], own[design.groups == 1]
        test = mann_whitney(*sides, about=words, names=(of[0], of[1]), intervals=intervals)
        return test if not inner else replace(test, direction=_depends(effect))
    return aligned_ranks(design, effect, about=about, intervals=intervals)


def _ends(design: Factorial, inner: Sequence[str]) -> tuple[str, str]:
    levels = design.within[inner[0]] if inner else ("", "")
    return levels[0], levels[1]


def _depends(effect: Sequence[str]) -> str:
    return f"the effect of {effect[0]} depends on {' and '.join(effect[1:])}"


def aligned_ranks(design: Factorial, effect: tuple[str, ...], *, about: str, intervals: bool = True) -> Tested:
    """The aligned rank transform (Wobbrock et al. 2011) of one effect, then F of the ranks with the effect's own error.

    Values are aligned by leaving of the cell means only the effect, ranked all together, and analysed as `f_test` does.
    F is approximate; scales of few points, and strong other effects, make it too small p's (Luepsen 2017): the null
    cohorts of `desirepath benchmark null-cohorts` tell how often.
    """
    cells = np.stack([design.values[design.groups == g].mean(axis=0) for g in range(_groups(design))])
    aligned = design.values - cells[design.groups] + _effect_means(design, cells, effect)[design.groups]
    ranks = stats.rankdata(np.round(aligned, 10)).reshape(aligned.shape)
    statistic, df, df_error, p = f_test(replace(design, values=ranks), effect)
    low, high = partial_eta_squared(statistic, df, df_error) if intervals else UNKNOWN
    n, untestable = len(design.values), bool(np.isnan(statistic))
    direction = f"the levels of {effect[0]} differ" if len(effect) == 1 else _depends(effect)
    return Tested(
        test="Aligned ranks", about=f"{about}, {' × '.join(effect)}", symbol="F", statistic=statistic, df=df,
        df_error=df_error, p=p, p_corrected=p, correction="uncorrected", effect_name="partial η²",
        effect=statistic * df / (statistic * df + df_error), n=n, used=n, direction=direction, effect_low=low,
        effect_high=high, least_p=1.0 if untestable else 0.0, no_spread=untestable,
    )  # fmt: skip


def f_test(design: Factorial, effect: tuple[str, ...]) -> tuple[float, float, float, float]:
    """F, its degrees of freedom and p of one effect: repeated measures with groups, unweighted means (type III), the
    error of the effect's own contrasts; Greenhouse and Geisser's correction where they are several. Where nobody's
    contrasts differ from the others' F is NaN and p is 1: not testable."""
    outer = [f for f in effect if f in design.between]
    scores = contrast_scores(design, effect)
    groups, d = _groups(design), scores.shape[1]
    means = np.stack([scores[design.groups == g].mean(axis=0) for g in range(groups)])
    left = scores - means[design.groups]
    between = _contrast(design.between, outer).T
    spread = np.diag(1 / np.bincount(design.groups, minlength=groups))
    contrast_means = between @ means
    hypothesis = float(np.trace(contrast_means.T @ np.linalg.solve(between @ spread @ between.T, contrast_means)))
    df, df_error = len(between) * d, (len(design.values) - groups) * d
    error = float((left**2).sum())
    if error <= 1e-12:
        return float("nan"), df, df_error, 1.0
    statistic = hypothesis / df / (error / df_error)
    covariance = left.T @ left
    epsilon = float(np.trace(covariance) ** 2 / (d * (covariance**2).sum())) if d > 1 else 1.0
    return statistic, df, df_error, float(stats.f.sf(statistic, epsilon * df, epsilon * df_error))


def contrast_scores(design: Factorial, effect: Sequence[str]) -> Array:
    """(people, df) what each person's values say of the effect's factors within: orthonormal contrasts of cells."""
    return np.asarray(design.values @ _contrast(design.within, [f for f in effect if f in design.within]))


def _contrast(factors: Mapping[str, Sequence[str]], effect: Sequence[str]) -> Array:
    """Orthonormal contrasts (cells, df) of an effect: differences along its factors, means along the others."""
    contrasts = np.ones((1, 1))
    for name, levels in factors.items():
        k = len(levels)
        part = linalg.helmert(k).T if name in effect else np.full((k, 1), 1 / np.sqrt(k))
        contrasts = np.kron(contrasts, part)
    return contrasts


def _groups(design: Factorial) -> int:
    return int(np.prod([len(levels) for levels in design.between.values()], dtype=int))


def _effect_means(design: Factorial, cells: ArrayLike, effect: tuple[str, ...]) -> Array:
    """What of the cell means (groups, cells) the effect alone makes: sums over smaller sets of factors, signs
    alternating."""
    factors = [*design.between, *design.within]
    sizes = [len(levels) for levels in (*design.between.values(), *design.within.values())]
    table = np.asarray(cells, dtype=float).reshape(sizes)
    means = np.zeros_like(table)
    for marks in product((False, True), repeat=len(effect)):
        names = {name for name, keep in zip(effect, marks, strict=True) if keep}
        away = tuple(k for k, name in enumerate(factors) if name not in names)
        means += (-1) ** (len(effect) - len(names)) * table.mean(axis=away, keepdims=True)
    return means.reshape(np.asarray(cells).shape)
