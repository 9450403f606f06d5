"""Several factors against statsmodels, numbers of pingouin 0.7, and by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from scipy import stats
from statsmodels.stats.anova import AnovaRM, anova_lm

from desirepath.analysis.between_groups import mann_whitney
from desirepath.analysis.factorial import Factorial, aligned_ranks, f_test, factorial_tests
from desirepath.analysis.repeated_measures import wilcoxon

VIEWS, SPEEDS, ROBOTS = ("top", "first", "immersive"), ("slow", "fast"), ("small", "large")
PEOPLE = 14


@pytest.fixture
def ratings() -> np.ndarray:
    random = np.random.default_rng(3)
    return random.normal(size=(PEOPLE, 6)) + 0.3 * np.arange(6) + random.normal(size=(PEOPLE, 1))


def everybody(values: np.ndarray, **within: tuple[str, ...]) -> Factorial:
    return Factorial(values, np.zeros(len(values), dtype=int), within, {})


def test_two_factors_within_are_statsmodels(ratings: np.ndarray) -> None:
    long = pd.DataFrame(
        {"who": i, "view": VIEWS[c // 2], "speed": SPEEDS[c % 2], "y": ratings[i, c]}
        for i in range(PEOPLE)
        for c in range(6)
    )
    theirs = AnovaRM(long, "y", "who", ["view", "speed"]).fit().anova_table
    corrected = (4.434862219098145e-05, 0.4672969022413282, 0.9827611911446156)  # pingouin's rm_anova, p_GG_corr
    design = everybody(ratings, view=VIEWS, speed=SPEEDS)
    assert design.effects == [("view",), ("speed",), ("view", "speed")]
    for effect, (_, row), p in zip(design.effects, theirs.iterrows(), corrected, strict=True):
        found = f_test(design, effect)
        assert found[:3] == pytest.approx((row["F Value"], row["Num DF"], row["Den DF"]))
        assert found[3] == pytest.approx(p)


def test_one_factor_within_and_one_between_are_pingouin_s(ratings: np.ndarray) -> None:
    """pingouin.mixed_anova of the same ratings."""
    design = Factorial(ratings[:, :3], np.repeat([0, 1], PEOPLE // 2), {"view": VIEWS}, {"robot": ROBOTS})
    assert f_test(design, ("view",))[:3] == pytest.approx((1.3293572284047754, 2, 24))
    assert f_test(design, ("robot",))[:3] == pytest.approx((0.1316728175008157, 1, 12))
    assert f_test(design, ("view", "robot"))[:3] == pytest.approx((0.20495972908725174, 2, 24))


def test_groups_of_different_sizes_are_of_type_three(ratings: np.ndarray) -> None:
    groups = np.array([0, 1, 2, 3] * 3 + [0, 1])
    long = pd.DataFrame({"a": groups // 2, "b": groups % 2, "y": ratings[:, 0]})
    model = smf.ols("y ~ C(a, Sum) * C(b, Sum)", data=long).fit()
    theirs = anova_lm(model, typ=3).iloc[1:4]
    design = Factorial(ratings[:, :1], groups, {}, {"a": ("x", "y"), "b": ("u", "v")})
    for k, effect in enumerate((("a",), ("b",), ("a", "b"))):
        assert f_test(design, effect) == pytest.approx((theirs["F"].iloc[k], 1, 10, theirs["PR(>F)"].iloc[k]))


def test_two_by_two_within_is_one_contrast_per_person(ratings: np.ndarray) -> None:
    design = everybody(ratings[:, :4], view=VIEWS[:2], speed=SPEEDS)
    view, speed, both = factorial_tests(design, about="fun")
    a, b, c, d = ratings[:, :4].T
    for found, own in ((view, (a + b - c - d) / 2), (speed, (a - b + c - d) / 2), (both, (a - b - c + d) / 2)):
        theirs = wilcoxon(own, np.zeros(PEOPLE), about="", names=("", ""))
        assert (found.statistic, found.p, found.effect) == (theirs.statistic, theirs.p, pytest.approx(theirs.effect))
        assert found.p == pytest.approx(stats.wilcoxon(own).pvalue)
        assert found.shift == pytest.approx(theirs.shift)
    assert (view.about, both.about) == ("fun, view", "fun, view × speed")
    assert view.direction == "higher for first than for top"
    assert both.direction == "the effect of view depends on speed"


def test_two_groups_and_two_conditions(ratings: np.ndarray) -> None:
    """Robot: people's means; view by robot: people's differences; view itself over unweighted groups: aligned ranks."""
    groups = np.array([0] * 6 + [1] * 8)
    design = Factorial(ratings[:, :2], groups, {"view": VIEWS[:2]}, {"robot": ROBOTS})
    view, robot, both = factorial_tests(design, about="fun")
    assert [one.test for one in (view, robot, both)] == ["Aligned ranks", "Mann-Whitney", "Mann-Whitney"]
    for found, own in ((robot, ratings[:, :2].mean(axis=1)), (both, ratings[:, 0] - ratings[:, 1])):
        theirs = mann_whitney(own[:6], own[6:], about="", names=ROBOTS)
        assert (found.statistic, found.p) == (theirs.statistic, theirs.p)
    assert (
        robot.direction == mann_whitney(*np.split(ratings[:, :2].mean(axis=1), [6]), about="", names=ROBOTS).direction
    )
    assert both.direction == "the effect of view depends on robot"


def test_ranks_are_aligned_for_one_effect_alone(ratings: np.ndarray) -> None:
    """Wobbrock et al. (2011): residual plus the effect's own estimate, ranked over all; statsmodels' F of that."""
    design = everybody(ratings, view=VIEWS, speed=SPEEDS)
    cells = ratings.mean(axis=0).reshape(3, 2)
    grand, views, speeds = cells.mean(), cells.mean(axis=1, keepdims=True), cells.mean(axis=0, keepdims=True)
    effects = {
        ("view",): (views - grand + 0 * cells),
        ("speed",): (speeds - grand + 0 * cells),
        ("view", "speed"): cells - views - speeds + grand,
    }
    for effect, estimate in effects.items():
        ranks = stats.rankdata(ratings - ratings.mean(axis=0) + estimate.ravel()).reshape(ratings.shape)
        long = pd.DataFrame(
            {"who": i, "view": c // 2, "speed": c % 2, "y": ranks[i, c]} for i in range(PEOPLE) for c in range(6)
        )
        theirs = AnovaRM(long, "y", "who", ["view", "speed"]).fit().anova_table["F Value"][":".join(effect)]
        found = aligned_ranks(design, effect, about="fun")
        assert found.statistic == pytest.approx(theirs)
        assert found.effect == pytest.approx(theirs * found.df / (theirs * found.df + found.df_error))
        assert found.effect_low <= found.effect <= found.effect_high


def test_an_effect_is_found_where_it_is_and_nowhere_else() -> None:
    random = np.random.default_rng(8)
    values = random.normal(size=(30, 6)) + np.repeat([0.0, 0.0, 1.5], 2)
    view, speed, both = factorial_tests(everybody(values, view=VIEWS, speed=SPEEDS), about="fun")
    assert view.significant(0.001)
    assert not speed.significant()
    assert not both.significant()
    assert "the levels of view differ, F(2, 58, N = 30)" in view.sentence()


def test_what_cannot_be_tested_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(3, 5\); needs \(3, 6\)"):
        everybody(np.zeros((3, 5)), view=VIEWS, speed=SPEEDS)
    with pytest.raises(ValueError, match="each of 2 needs at least 2"):
        Factorial(np.zeros((3, 1)), np.array([0, 0, 1]), {}, {"robot": ROBOTS})
    same = f_test(everybody(np.full((3, 6), 4.0), view=VIEWS, speed=SPEEDS), ("view",))
    assert np.isnan(same[0])
    assert same[3] == 1.0
