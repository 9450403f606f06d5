"""Repeated-measures analysis of variance, as statsmodels and R compute it; rankings' agreement as scipy does."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.anova import AnovaRM

from desirepath.analysis.anova import assumptions, rm_anova
from desirepath.analysis.estimates import kendall_tau_b
from desirepath.analysis.factorial import Factorial

TWO = {"outline": ["without", "with"], "lidar": ["without", "with"]}


def factorial(values: np.ndarray, within: dict[str, list[str]] | None = None) -> Factorial:
    return Factorial(values, np.zeros(len(values), dtype=np.int64), within or TWO, {})


def people(n: int, seed: int = 0, cells: int = 4) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.normal(size=(n, 1)) + random.normal(size=(n, cells)) + np.arange(cells) * 0.3


@pytest.mark.parametrize("within", [TWO, {"outline": ["a", "b"], "lidar": ["x", "y", "z"]}], ids=["2 x 2", "2 x 3"])
def test_every_effect_is_that_of_statsmodels(within: dict[str, list[str]]) -> None:
    sizes = [len(levels) for levels in within.values()]
    values = people(13, cells=sizes[0] * sizes[1])
    rows = [
        {"person": person, "outline": cell // sizes[1], "lidar": cell % sizes[1], "value": value}
        for person, of in enumerate(values)
        for cell, value in enumerate(of)
    ]
    theirs = AnovaRM(pd.DataFrame(rows), "value", "person", within=["outline", "lidar"]).fit().anova_table
    for test, (_, row) in zip(rm_anova(factorial(values, within), about="tau"), theirs.iterrows(), strict=True):
        assert test.statistic == pytest.approx(row["F Value"], rel=1e-9)
        assert (test.df, test.df_error) == (row["Num DF"], row["Den DF"])
        if test.df == 1:  # otherwise ours is Greenhouse and Geisser's
            assert test.p == pytest.approx(row["Pr > F"], rel=1e-9)


def test_a_published_table_of_two_factors_is_that_of_r() -> None:
    """Eight people, 2 x 3: R's `ezANOVA`, as statsmodels' own tests have it."""
    values = np.array(
        [
            [7, 7, 8, 16, 16, 24], [3, 11, 14, 7, 10, 29], [6, 9, 10, 11, 13, 10], [6, 11, 11, 9, 10, 22],
            [5, 10, 12, 10, 10, 25], [8, 10, 10, 11, 14, 28], [6, 11, 11, 8, 11, 22], [7, 11, 12, 8, 12, 24],
        ]
    )  # fmt: skip
    found = rm_anova(factorial(values, {"A": ["a", "b"], "B": ["a", "b", "c"]}), about="DV")
    assert [(test.df, test.df_error) for test in found] == [(1, 7), (2, 14), (2, 14)]
    assert [test.statistic for test in found] == pytest.approx([40.14159, 29.21739, 17.10545], abs=1e-5)
    assert found[0].p == pytest.approx(3.905263e-04, rel=1e-6)


def test_an_effect_of_two_levels_is_the_paired_t_test_and_says_which_is_higher() -> None:
    values = people(24, seed=3)
    outline, lidar, both = rm_anova(factorial(values), about="tau")
    against = stats.ttest_rel(values[:, 2:].mean(axis=1), values[:, :2].mean(axis=1))
    assert (outline.statistic, outline.p) == (pytest.approx(against.statistic**2), pytest.approx(against.pvalue))
    assert outline.direction == "higher with than without"
    assert rm_anova(factorial(-values), about="tau")[0].direction == "higher without than with"
    assert both.direction == "the effect of outline depends on lidar"
    assert (outline.df, outline.df_error, lidar.n) == (1, 23, 24)


def test_partial_eta_squared_and_its_interval_are_those_of_the_published_study() -> None:
    """Table 8.1: F(1, 23) = 15.20 is 0.40; table 8.2: 5.39 is 0.19, 22.77 is 0.50. The interval's ends are those under
    which F would be the 2.5th or 97.5th percentile (R: `MBESS::ci.pvaf`, effectsize)."""
    random = np.random.default_rng(1)
    for f, share, p in ((15.20, 0.40, 0.001), (5.39, 0.19, 0.030), (4.43, 0.16, 0.046), (6.90, 0.23, 0.015)):
        contrast = random.normal(size=24)
        contrast = (contrast - contrast.mean()) / contrast.std(ddof=1) + np.sqrt(f / 24)
        values = np.stack([0 * contrast, 0 * contrast, contrast, contrast], axis=1) + random.normal(size=(24, 1))
        outline = rm_anova(factorial(values), about="tau")[0]
        assert outline.statistic == pytest.approx(f)
        assert outline.effect == pytest.approx(share, abs=0.005)
        assert (outline.p < 0.001) if p == 0.001 else (outline.p == pytest.approx(p, abs=0.0006))
        for end, at in ((outline.effect_low, 0.975), (outline.effect_high, 0.025)):
            assert end == 0 or stats.ncf.cdf(f, 1, 23, end / (1 - end) * 25) == pytest.approx(at, abs=1e-6)
        assert (outline.effect_low == 0) == (outline.p > 0.025)


def test_what_is_assumed_is_checked_and_the_ranks_stand_beside() -> None:
    normal, skewed = people(24), people(24)
    skewed[:, 2:] += np.random.default_rng(5).lognormal(0, 1.6, (24, 1))
    for values, holds in ((normal, True), (skewed, False)):
        found = assumptions(factorial(values), ("outline",), about="tau")
        contrasts = values[:, 2:].sum(axis=1) - values[:, :2].sum(axis=1)
        assert found.shapiro_p == pytest.approx(stats.shapiro(contrasts).pvalue, rel=1e-6)
        assert found.normal() is holds
        assert found.epsilon == 1.0  # one degree of freedom: sphericity cannot be violated
        assert found.ranks.test == "Aligned ranks"
    three = assumptions(factorial(people(13, cells=6), {"a": ["1", "2"], "b": ["1", "2", "3"]}), ("b",), about="tau")
    assert 0.5 <= three.epsilon <= 1


def test_nobody_differs_at_all() -> None:
    same = np.ones((6, 4))
    assert [test.p for test in rm_anova(factorial(same), about="tau")] == [1, 1, 1]
    assert assumptions(factorial(same), ("outline",), about="tau").normal()


def test_tau_b_is_scipy_s_with_and_without_ties() -> None:
    random = np.random.default_rng(2)
    ranks = np.stack([random.permutation(5) for _ in range(200)])
    scores = np.round(random.random((200, 5)), 1) * (random.random((200, 5)) > 0.3)
    theirs = [stats.kendalltau(a, b).statistic for a, b in zip(ranks, scores, strict=True)]
    np.testing.assert_allclose(kendall_tau_b(ranks, scores), theirs, atol=1e-12)
    assert np.isnan(kendall_tau_b([1, 2, 3], [0, 0, 0])).all()
    assert kendall_tau_b([1, 2, 3, 4, 5], [1, 2, 3, 4, 5]) == 1
    assert kendall_tau_b([1, 2, 3, 4, 5], [2, 1, 3, 5, 4]) == pytest.approx(0.6)
    assert kendall_tau_b([1, 2, 3, 4, 5], [1, 2, 3, 3, 3]) == pytest.approx(7 / np.sqrt(70))
    with pytest.raises(ValueError, match="needs the same"):
        kendall_tau_b([1, 2], [1, 2, 3])


def test_three_people_can_be_checked_and_two_cannot() -> None:
    for n in (3, 4):
        values = people(n, seed=2)
        found = assumptions(factorial(values), ("outline",), about="tau")
        contrasts = values[:, 2:].sum(axis=1) - values[:, :2].sum(axis=1)
        assert found.shapiro_p == pytest.approx(stats.shapiro(contrasts).pvalue)
    assert np.isnan(assumptions(factorial(people(2)), ("outline",), about="tau").shapiro_p)


def test_sphericity_of_three_levels_is_greenhouse_and_geisser_s_epsilon() -> None:
    """By the covariances of the conditions, doubly centred (Winer 1971), not by contrasts."""
    values = people(11, seed=4, cells=3)
    design = factorial(values, {"view": ["a", "b", "c"]})
    covariance = np.cov(values, rowvar=False)
    centred = covariance - covariance.mean(axis=0) - covariance.mean(axis=1, keepdims=True) + covariance.mean()
    epsilon = np.trace(centred) ** 2 / (2 * (centred**2).sum())
    (test,) = rm_anova(design, about="x")
    assert assumptions(design, ("view",), about="x").epsilon == pytest.approx(epsilon)
    assert test.p == pytest.approx(stats.f.sf(test.statistic, 2 * epsilon, 20 * epsilon))
    assert test.direction == "the levels of view differ"
