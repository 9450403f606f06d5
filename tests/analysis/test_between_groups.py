"""Mann and Whitney's and Kruskal and Wallis's tests against published examples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.between_groups import group_pairs, kruskal_wallis, mann_whitney
from desirepath.analysis.intervals import correlation_like

# Hollander & Wolfe (1973), p. 69: permeability of the human chorioamnion at term and between 12 and 26 weeks; R's
# example of wilcox.test gives W = 35, p = 0.1272 one-sided, so 0.2544 two-sided; with conf.int 0.305, -0.15 to 0.76.
AT_TERM = [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46]
BEFORE = [1.15, 0.88, 0.90, 0.74, 1.21]
# Hollander & Wolfe (1973), p. 116: mucociliary efficiency of three groups; R's example of kruskal.test gives
# chi-squared = 0.77143, df = 2, p-value = 0.68.
NORMAL, OBSTRUCTED, ASBESTOSIS = [2.9, 3.0, 2.5, 2.6, 3.2], [3.8, 2.7, 4.0, 2.4], [2.8, 3.4, 3.7, 2.2, 2.0]


def test_mann_whitney_of_the_chorioamnion() -> None:
    test = mann_whitney(AT_TERM, BEFORE, about="permeability", names=("at term", "before"))
    assert (test.statistic, test.p, test.method) == (35, pytest.approx(0.2544, abs=5e-5), "exact")
    assert test.effect == pytest.approx(2 * 35 / 50 - 1)
    assert (test.shift, test.shift_low, test.shift_high) == pytest.approx((0.305, -0.15, 0.76))
    assert (test.n, test.direction) == (15, "higher for at term than for before")
    assert -1 < test.effect_low < test.effect < test.effect_high < 1
    other = mann_whitney(BEFORE, AT_TERM, about="permeability", names=("before", "at term"))
    assert (other.statistic, other.effect, other.direction) == (15, pytest.approx(-test.effect), test.direction)
    assert (other.effect_low, other.effect_high) == pytest.approx((-test.effect_high, -test.effect_low))


def test_kruskal_wallis_of_the_mucociliary_efficiency() -> None:
    test = kruskal_wallis([NORMAL, OBSTRUCTED, ASBESTOSIS], about="efficiency")
    assert (test.statistic, test.df) == (pytest.approx(0.77143, abs=5e-6), 2)
    assert stats.chi2.sf(test.statistic, 2) == pytest.approx(0.68, abs=0.001)
    assert (test.method, test.p) == ("permutations", pytest.approx(0.71, abs=0.02))
    assert test.effect == pytest.approx(test.statistic / 13)
    assert test.effect_low == 0.0


def test_ties_are_corrected_as_scipy_does() -> None:
    groups = np.random.default_rng(5).integers(1, 8, (3, 20))
    test = kruskal_wallis(groups, about="fun")
    assert (test.statistic, test.p) == pytest.approx(tuple(stats.kruskal(*groups)))
    assert test.method == "approximate"
    pairs = group_pairs(groups, ("a", "b", "c"), about="fun")
    assert [pair.about for pair in pairs] == ["fun, a against b", "fun, a against c", "fun, b against c"]
    assert [pair.statistic for pair in pairs] == [
        stats.mannwhitneyu(groups[i], groups[j]).statistic for i, j in ((0, 1), (0, 2), (1, 2))
    ]


def test_groups_that_are_all_alike_or_too_few() -> None:
    same = mann_whitney([4, 4], [4, 4], about="fun", names=("a", "b"))
    assert (same.p, same.effect, same.shift) == (1.0, 0.0, 0.0)
    assert kruskal_wallis([[4, 4], [4], [4]], about="fun").p == 1.0
    assert mann_whitney([4] * 30, [4] * 30, about="fun", names=("a", "b")).p == 1.0
    assert math.isnan(mann_whitney([1.0], [2.0, 3.0], about="fun", names=("a", "b")).effect_low)
    apart = mann_whitney([5, 6, 7], [1, 2, 3], about="fun", names=("a", "b"))
    assert (apart.p, apart.least_p, apart.possible()) == (pytest.approx(0.1), pytest.approx(0.1), False)
    with pytest.raises(ValueError, match="b: shape"):
        mann_whitney([1.0], [], about="fun", names=("a", "b"))
    with pytest.raises(ValueError, match="needs at least 3"):
        kruskal_wallis([[1.0], [2.0]], about="fun")


def test_two_people_in_each_group_have_an_interval_by_delong_s_variance() -> None:
    """Each person's share of the other group that they are above, twice and less one; its variance over people."""
    first, second = [3.0, 8.0, 5.0, 9.0], [4.0, 2.0]
    test = mann_whitney(first, second, about="fun", names=("a", "b"))
    above = [2 * np.mean([(x > y) + (x == y) / 2 for y in second]) - 1 for x in first]
    below = [2 * np.mean([(x > y) + (x == y) / 2 for x in first]) - 1 for y in second]
    se = math.sqrt(np.var(above, ddof=1) / 4 + np.var(below, ddof=1) / 2)
    assert test.effect == pytest.approx(np.mean(above))
    assert (test.effect_low, test.effect_high) == pytest.approx(correlation_like(test.effect, se, 2))
    assert math.isfinite(mann_whitney([1.0, 3.0], [2.0, 4.0], about="fun", names=("a", "b")).effect_low)
    assert math.isnan(mann_whitney([1.0, 3.0], [2.0], about="fun", names=("a", "b")).effect_high)


def test_without_intervals_the_test_is_the_same() -> None:
    whole, quick = (kruskal_wallis([NORMAL, OBSTRUCTED, ASBESTOSIS], about="x", intervals=one) for one in (True, False))
    assert math.isnan(quick.effect_low)
    assert (quick.statistic, quick.p, quick.effect, quick.n) == (whole.statistic, whole.p, whole.effect, 14)
    pairs = group_pairs([NORMAL, OBSTRUCTED, ASBESTOSIS], ("a", "b", "c"), about="x", intervals=False)
    assert all(math.isnan(one.shift_low) for one in pairs)
