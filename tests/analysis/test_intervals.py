"""Intervals against published examples; none leaves its range, none is of width 0."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.proportion import proportion_confint

from desirepath.analysis.estimates import wilson_interval
from desirepath.analysis.intervals import (
    bound_share,
    clustered_share,
    correlation_like,
    end_at_scale,
    jackknife_se,
    partial_eta_squared,
    rank_sum_shift,
    share_of_chi_square,
    signed_rank_shift,
)
from desirepath.analysis.repeated_measures import wilcoxon
from desirepath.analysis.tested import mean_of

FIRST_VISIT = [1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30]
SECOND_VISIT = [0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29]


@pytest.mark.parametrize(("share", "n"), [(0.0, 9), (1.0, 9), (0.3, 10), (0.81, 263)])
def test_wilson_is_statsmodels(share: float, n: int) -> None:
    """81 of 263 in Newcombe (1998), table I: 0.2553 to 0.3662."""
    theirs = proportion_confint(share * n, n, method="wilson")
    assert wilson_interval(share, n, stats.norm.ppf(0.975)) == pytest.approx(theirs)
    assert wilson_interval(81 / 263, 263, stats.norm.ppf(0.975)) == pytest.approx((0.2553, 0.3662), abs=5e-5)


def test_nine_people_who_all_agree_are_not_certain() -> None:
    everybody = clustered_share([1.0] * 9, [5] * 9)
    assert (everybody.mean, everybody.high) == (1.0, 1.0)
    assert everybody.low == pytest.approx(wilson_interval(1.0, 9, stats.t.ppf(0.975, 8))[0])
    assert 0.6 < everybody.low < 0.7
    half = clustered_share([0.5] * 9, [4] * 9)  # no spread between people: as sure as 36 answers
    assert (half.low, half.high) == pytest.approx(wilson_interval(0.5, 36, stats.t.ppf(0.975, 8)))
    unknown = clustered_share([0.5] * 9)
    assert math.isnan(unknown.low)
    alone = clustered_share([0.4, math.nan])
    assert (alone.n, alone.mean) == (1, 0.4)
    assert math.isnan(alone.high)


@pytest.mark.parametrize(("n", "a", "b"), [(6, 2.0, 1.0), (12, 4.0, 1.0), (31, 8.0, 3.0)])
def test_the_interval_of_a_share_covers_over_people(n: int, a: float, b: float) -> None:
    """People's own chances are drawn from a beta distribution, ten answers each: 95 % of intervals hold its mean."""
    random = np.random.default_rng(n)
    held = 0
    for _ in range(800):
        shares = random.binomial(10, random.beta(a, b, n)) / 10
        found = clustered_share(shares, [10] * n)
        held += found.low <= a / (a + b) <= found.high
    assert held / 800 > 0.92


def test_more_answers_of_the_same_people_do_not_make_it_narrower() -> None:
    few = clustered_share([0.2, 0.9, 0.6, 0.7], [10] * 4)
    many = clustered_share([0.2, 0.9, 0.6, 0.7], [10_000] * 4)
    assert (few.low, few.high) == (many.low, many.high)


def test_shifts_are_those_of_the_published_examples() -> None:
    """R: wilcox.test(first, second, paired = TRUE, conf.int = TRUE) gives 0.46 and 0.010 to 0.786."""
    shift, ends = signed_rank_shift(np.subtract(FIRST_VISIT, SECOND_VISIT))
    assert (shift, *ends) == pytest.approx((0.46, 0.010, 0.786))
    assert signed_rank_shift([1.0, 2.0, 3.0])[1] == (-math.inf, math.inf)
    assert rank_sum_shift([5.0, 6.0], [1.0, 2.0])[1] == (-math.inf, math.inf)


def test_an_interval_of_a_shift_leaves_out_0_where_the_test_says_so() -> None:
    random = np.random.default_rng(4)
    for n in (8, 20, 60):
        for shift in (0.0, 0.5, 1.0):
            differences = random.normal(shift, 1, n)
            _, (low, high) = signed_rank_shift(differences)
            p = wilcoxon(differences, np.zeros(n), about="", names=("a", "b")).p
            assert (low > 0 or high < 0) == (p <= 0.05)
            other = random.normal(0, 1, n)
            _, (low, high) = rank_sum_shift(differences, other)
            p = stats.mannwhitneyu(differences, other, method="exact" if n < 25 else "asymptotic").pvalue
            assert (low > 0 or high < 0) == (p <= 0.05)


def test_effects_of_chi_square_and_f_are_smithson_s() -> None:
    """Smithson (2001): the ends are the noncentral distributions under which this would be 2.5 % likely."""
    low, high = share_of_chi_square(12.0, 2, 40)
    assert stats.ncx2.sf(12.0, 2, low * 40) == pytest.approx(0.025)
    assert stats.ncx2.cdf(12.0, 2, high * 40) == pytest.approx(0.025)
    assert share_of_chi_square(0.5, 2, 40)[0] == 0.0
    assert share_of_chi_square(60.0, 2, 40)[1] == 1.0
    low, high = partial_eta_squared(8.0, 2, 30)
    assert stats.ncf.sf(8.0, 2, 30, low / (1 - low) * 33) == pytest.approx(0.025)
    assert stats.ncf.cdf(8.0, 2, 30, high / (1 - high) * 33) == pytest.approx(0.025)
    assert all(math.isnan(end) for end in partial_eta_squared(math.inf, 2, 30))


def test_nothing_leaves_its_range() -> None:
    low, _ = wilson_interval(1.0, 9, stats.t.ppf(0.975, 8))
    assert correlation_like(1.0, 0.0, 9) == pytest.approx(
        (2 * wilson_interval(1.0, 9, stats.t.ppf(0.975, 8))[0] - 1, 1.0)
    )
    low, high = correlation_like(-0.9, 0.4, 5)
    assert -1 <= low < -0.9 < high <= 1
    assert bound_share(0.0, 0.0, 4)[1] > 0.3
    ratings = end_at_scale(mean_of([7, 7, 7, 6]), 1, 7)
    assert (ratings.mean, ratings.high) == (6.75, 7)
    assert math.isnan(end_at_scale(mean_of([7, 7, 7]), 1, 7).low)
    assert end_at_scale(mean_of([1, 1, 2, 1]), 1, 7).low == 1


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.array([1.0, 4.0, 2.0, 8.0])
    left = [np.delete(values, k).mean() for k in range(4)]
    assert jackknife_se(left) == pytest.approx(stats.sem(values))
    assert math.isnan(jackknife_se([1.0]))


def test_shifts_of_many_people_have_the_ends_of_the_published_tables() -> None:
    """Critical values at 5 %, two-sided: W = 648 for 60 pairs, U = 317 for 30 and 30."""
    random = np.random.default_rng(8)
    values = random.normal(0.2, 1, 60)
    i, j = np.triu_indices(60)
    walsh = np.sort((values[i] + values[j]) / 2)
    assert signed_rank_shift(values)[1] == pytest.approx((walsh[647], walsh[-648]))
    differences = np.sort(np.subtract.outer(values[:30], values[30:]).ravel())
    assert rank_sum_shift(values[:30], values[30:])[1] == pytest.approx((differences[316], differences[-317]))
    assert jackknife_se([1.0, 3.0]) == pytest.approx(1.0)
    assert math.isnan(jackknife_se([1.0]))


def test_shifts_of_many_people_leave_out_0_where_the_approximate_test_says_so() -> None:
    random = np.random.default_rng(5)
    decided = 0
    for shift in (0.0, 0.4, 0.6, 1.0) * 5:
        first, second = random.normal(shift, 1, 35), random.normal(0, 1, 28)
        p = stats.mannwhitneyu(first, second, method="asymptotic", use_continuity=False).pvalue
        low, high = rank_sum_shift(first, second)[1]
        if abs(p - 0.05) > 0.003:
            assert (low > 0 or high < 0) == (p < 0.05), (shift, p, low, high)
            decided += p < 0.05
    assert 5 < decided < 18
