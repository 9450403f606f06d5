"""t-tests against textbook numbers."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.tested import holm, mean_of
from desirepath_experiments.reproduction.enquery.t_tests import student_t

# Student (1908), "The probable error of a mean": additional hours of sleep by two drugs, ten patients each; the values
# of R's data set `sleep`. R: t.test(extra ~ group, var.equal = TRUE) gives t = -1.8608, df = 18, p-value = 0.07919.
FIRST = [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0]
SECOND = [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]


def test_students_own_example() -> None:
    test = student_t(FIRST, SECOND)
    assert test.statistic == pytest.approx(-1.8608, abs=5e-5)
    assert test.df == 18
    assert test.p == pytest.approx(0.07919, abs=5e-6)
    assert test.difference == pytest.approx(0.75 - 2.33)
    assert test.effect_size == pytest.approx(-1.58 / math.sqrt((1.789010**2 + 2.002249**2) / 2), abs=1e-5)
    assert test.n == (10, 10)
    assert test.stars == ""


def test_against_a_fixed_value() -> None:
    """R: t.test(SECOND, mu = 0) gives t = 3.6799, df = 9, p-value = 0.005076."""
    test = student_t(SECOND, 0.0)
    assert (test.statistic, test.df, test.p) == pytest.approx((3.6799, 9, 0.005076), abs=5e-5)
    assert test.stars == "**"
    assert test.n == (10, 1)


def test_holm_corrects_in_order_of_p_and_never_decreases() -> None:
    """Worked by hand: 0.01 x 4, 0.02 x 3 (0.06), 0.03 x 2 = 0.06, 0.04 x 1 -> 0.06."""
    assert holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm([]) == []


def test_the_sentence_says_it_all() -> None:
    told = student_t(SECOND, FIRST).sentence("drug 2", "drug 1", "h")
    assert told == "drug 2 is 1.58 h higher than drug 1, t(18) = 1.86, p = 0.079 (Holm), d = 0.83."


def test_the_interval_is_students() -> None:
    """R: t.test(SECOND) gives the interval 0.8976775 to 3.7623225."""
    found = mean_of(SECOND)
    assert (found.mean, found.low, found.high) == pytest.approx((2.33, 0.8976775, 3.7623225))
    assert (found.sd, found.se) == pytest.approx((2.002249, 2.002249 / math.sqrt(10)), abs=1e-6)
    alone = mean_of([1.0, math.nan])
    assert (alone.n, alone.mean) == (1, 1.0)
    assert math.isnan(alone.low)


@pytest.mark.parametrize("bad", [[1.0], [1.0, np.nan], [[1.0, 2.0], [3.0, 4.0]]])
def test_what_cannot_be_tested_is_refused(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="first"):
        student_t(bad, SECOND)


def test_samples_of_different_sizes_are_pooled_by_their_degrees_of_freedom() -> None:
    test = student_t(FIRST[:4], SECOND)
    pooled = math.sqrt((3 * np.var(FIRST[:4], ddof=1) + 9 * np.var(SECOND, ddof=1)) / 12)
    assert test.effect_size == pytest.approx((np.mean(FIRST[:4]) - np.mean(SECOND)) / pooled)
    assert (test.df, test.n) == (12, (4, 10))
    assert (test.statistic, test.p) == pytest.approx(tuple(stats.ttest_ind(FIRST[:4], SECOND)))
    against = student_t(FIRST, 2.0)
    assert against.difference == pytest.approx(0.75 - 2.0)
    assert against.effect_size == pytest.approx(-1.25 / np.std(FIRST, ddof=1))
    assert "drug 1 is 1.58 h lower than drug 2" in student_t(FIRST, SECOND).sentence("drug 1", "drug 2", "h")


def test_numbers_without_spread_are_not_tested() -> None:
    for test in (
        student_t([2.0, 2.0], 1.0),
        student_t([2.0, 2.0], 2.0),
        student_t([0.3, 0.1 + 0.2], 1.0),  # the same but for rounding
        student_t([1.0, 1.0], [2.0, 2.0, 2.0]),
    ):
        assert (test.no_spread, test.p, test.stars) == (True, 1.0, "")
        assert math.isnan(test.effect_size)
        assert test.sentence("ours", "theirs", "m").endswith("theirs; no spread, not testable.")
    assert student_t([1.0, 1.0], [2.0, 2.5]).p < 1.0
    everybody_same = mean_of([3.0, 3.0, 3.0])
    assert (everybody_same.mean, everybody_same.sd) == (3.0, 0.0)
    assert math.isnan(everybody_same.low)


def test_of_two_numbers_there_is_an_interval_and_marks_follow_the_corrected_p() -> None:
    found = mean_of([1.0, 3.0])
    assert (found.n, found.mean, found.se) == (2, 2.0, pytest.approx(1.0))
    assert found.high - found.mean == pytest.approx(stats.t.ppf(0.975, 1))
    test = student_t([1.0, 1.1, 0.9, 1.0], [2.0, 2.1, 1.9, 2.0])
    assert (test.stars, replace(test, p_corrected=0.04).stars) == ("***", "*")
    assert asdict(test)["n"] == (4, 4)
