"""Friedman's and Wilcoxon's tests against published examples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.intervals import correlation_like
from desirepath.analysis.repeated_measures import friedman, pairs_of, wilcoxon
from desirepath.analysis.tested import correct_tests

# Hollander & Wolfe (1973), p. 140: seconds of 22 baseball players rounding first base in three ways; the example of R's
# friedman.test, which gives chi-squared = 11.143, df = 2, p-value = 0.003805.
ROUNDING_S = np.array(
    [
        *(5.40, 5.50, 5.55, 5.85, 5.70, 5.75, 5.20, 5.60, 5.50, 5.55, 5.50, 5.40, 5.90, 5.85, 5.70, 5.45, 5.55, 5.60),
        *(5.40, 5.40, 5.35, 5.45, 5.50, 5.35, 5.25, 5.15, 5.00, 5.85, 5.80, 5.70, 5.25, 5.20, 5.10, 5.65, 5.55, 5.45),
        *(5.60, 5.35, 5.45, 5.05, 5.00, 4.95, 5.50, 5.50, 5.40, 5.45, 5.55, 5.50, 5.55, 5.55, 5.35, 5.45, 5.50, 5.55),
        *(5.50, 5.45, 5.25, 5.65, 5.60, 5.40, 5.70, 5.65, 5.55, 6.30, 6.30, 6.25),
    ]
).reshape(22, 3)
# Hollander & Wolfe (1973), p. 29: depression scale of nine patients at two visits; the example of R's wilcox.test,
# which gives V = 40, p-value = 0.01953 one-sided, so 0.03906 two-sided. W = 45 - 40.
FIRST_VISIT = [1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30]
SECOND_VISIT = [0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29]


def test_friedman_of_the_baseball_players() -> None:
    test = friedman(ROUNDING_S, about="seconds")
    assert (test.statistic, test.df) == pytest.approx((11.143, 2), abs=5e-4)
    assert stats.chi2.sf(test.statistic, 2) == pytest.approx(0.003805, abs=5e-6)
    assert (test.method, test.p) == ("exact", pytest.approx(0.00315, abs=5e-6))
    assert test.effect == pytest.approx(11.1429 / 44, abs=1e-4)
    assert test.sentence() == (
        "Seconds: the conditions differ, χ²(2, N = 22) = 11.14, p = 0.003 (exact), Kendall's W = 0.25 [0.03, 0.61]."
    )


def test_wilcoxon_of_the_patients() -> None:
    test = wilcoxon(FIRST_VISIT, SECOND_VISIT, about="depression", names=("visit 1", "visit 2"))
    assert (test.statistic, test.p) == pytest.approx((5, 0.0390625))
    assert test.effect == pytest.approx((40 - 5) / 45)
    assert test.sentence().startswith(
        "Depression: higher for visit 1 than for visit 2, W(N = 9) = 5.00, z = -2.07, p = 0.039"
    )


@pytest.mark.parametrize(
    ("differences", "z"),
    [
        (np.subtract(FIRST_VISIT, SECOND_VISIT), -2.0732),  # R's coin: wilcoxsign_test of these patients, Z = 2.0732
        (np.arange(1.0, 25.0), -4.29),  # thesis table 2.2, closeness, ours - SC: as far as 24 people can go
        ([3.0, 1.0, 1.0, -1.0, 2.0, 2.0, 0.0, 4.0], None),  # ties and one without a difference
    ],
)
def test_z_is_that_of_other_programs(differences: np.ndarray, z: float | None) -> None:
    test = wilcoxon(differences, np.zeros(len(differences)), about="fun", names=("a", "b"))
    theirs = stats.wilcoxon(differences, zero_method="wilcox", method="asymptotic").zstatistic
    assert test.z == pytest.approx(theirs)
    assert z is None or test.z == pytest.approx(z, abs=0.005)


def test_pairs_without_difference_are_left_out_and_said() -> None:
    first, second = [3, 4, 5, 6, 7, 1, 2, 3], [3, 3, 3, 3, 3, 3, 3, 3]
    test = wilcoxon(first, second, about="fun", names=("a", "b"))
    differences = np.subtract(first, second)
    assert (test.n, test.used) == (8, 6)
    assert test.p == stats.wilcoxon(differences[differences != 0]).pvalue
    assert "N = 8, 6 used" in test.sentence()


def test_everybody_alike_is_no_difference() -> None:
    assert friedman(np.full((5, 3), 4.0), about="fun").p == 1.0
    test = wilcoxon([1.0, 2.0], [1.0, 2.0], about="fun", names=("a", "b"))
    assert (test.p, test.used, test.effect) == (1.0, 0, 0.0)
    assert test.sentence() == "Fun: no spread, not testable (N = 2)."


def test_all_pairs_corrected_by_bonferroni() -> None:
    """R: pairwise.wilcox.test of these data and the raw p differ by the factor 3, at most 1."""
    raw = pairs_of(ROUNDING_S, ("out", "narrow", "wide"), about="seconds")
    told = correct_tests(raw, "bonferroni")
    assert [test.about for test in told] == [
        "seconds, out against narrow", "seconds, out against wide", "seconds, narrow against wide",
    ]  # fmt: skip
    assert [test.p_corrected for test in told] == pytest.approx([min(1.0, 3 * test.p) for test in raw])
    assert {test.correction for test in told} == {"Bonferroni"}
    assert [test.p for test in told] == [test.p for test in raw]


@pytest.mark.parametrize("bad", [[[1.0, 2.0]], [[1.0, 2.0], [3.0, 4.0]], [[1.0, np.nan, 1.0], [1.0, 2.0, 3.0]]])
def test_what_cannot_be_tested_is_refused(bad: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="ratings"):
        friedman(bad, about="fun")


@pytest.mark.parametrize(("people", "conditions"), [(2, 3), (9, 3), (12, 4), (60, 5)])
def test_friedman_s_statistic_and_effect_are_scipy_s_with_ties(people: int, conditions: int) -> None:
    ratings = np.random.default_rng(people).integers(1, 6, (people, conditions)) + np.arange(conditions) // 2
    test = friedman(ratings, about="fun")
    theirs = stats.friedmanchisquare(*ratings.T)
    assert (test.statistic, test.df) == (pytest.approx(theirs.statistic), conditions - 1)
    assert test.effect == pytest.approx(theirs.statistic / (people * (conditions - 1)))
    assert (test.n, test.used, test.p_corrected) == (people, people, test.p)
    quick = friedman(ratings, about="fun", intervals=False)
    assert (quick.p, quick.statistic) == (test.p, test.statistic)
    assert np.isnan(quick.effect_low)
    assert test.effect_low <= test.effect <= test.effect_high


def test_the_effect_s_interval_is_by_leaving_each_person_out() -> None:
    """Rank-biserial correlations without one of those who differ, by hand; who does not differ tells nothing."""
    differences = np.array([3.0, 1.0, -2.0, 5.0, 0.0, 4.0, 2.5])
    test = wilcoxon(differences, np.zeros(7), about="fun", names=("a", "b"))
    used = differences[differences != 0]

    def biserial(of: np.ndarray) -> float:
        ranks = stats.rankdata(np.abs(of))
        return float((ranks[of > 0].sum() - ranks[of < 0].sum()) / ranks.sum())

    left = np.array([biserial(np.delete(used, k)) for k in range(6)])
    se = np.sqrt(5 / 6 * ((left - left.mean()) ** 2).sum())
    assert (test.effect, test.used) == (pytest.approx(biserial(used)), 6)
    assert (test.effect_low, test.effect_high) == pytest.approx(correlation_like(biserial(used), se, 6))
    two = wilcoxon([2.0, -1.0, 0.0], [0.0, 0.0, 0.0], about="fun", names=("a", "b"))
    assert (two.used, np.isfinite(two.effect_low)) == (2, True)
    one = wilcoxon([2.0, 0.0, 0.0], [0.0, 0.0, 0.0], about="fun", names=("a", "b"))
    assert (one.used, one.p, np.isnan(one.effect_low)) == (1, 1.0, True)


def test_who_is_higher_is_named_and_shares_that_differ_alike_are_ties() -> None:
    higher = wilcoxon([1.0, 2.0, 3.0], [2.0, 4.0, 2.0], about="fun", names=("a", "b"))
    assert (higher.effect < 0, higher.direction) == (True, "higher for b than for a")
    even = wilcoxon([1.0, 2.0], [2.0, 1.0], about="fun", names=("a", "b"))
    assert (even.effect, even.direction, even.shift) == (0.0, "higher for a than for b", 0.0)
    thirds = wilcoxon([2 / 3, 1 / 3, 1.0], [1 / 3, 0.0, 2 / 3], about="fun", names=("a", "b"), intervals=False)
    assert (thirds.statistic, thirds.p, thirds.shift) == (0.0, 0.25, None)
    many = np.random.default_rng(1).integers(-3, 5, 80)
    theirs = stats.wilcoxon(many[many != 0], correction=False, method="asymptotic")
    found = wilcoxon(many, np.zeros(80), about="fun", names=("a", "b"))
    assert (found.method, found.p, found.statistic) == ("approximate", pytest.approx(theirs.pvalue), theirs.statistic)
