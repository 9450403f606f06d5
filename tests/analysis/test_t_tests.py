"""t-tests against textbook numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from backend.analysis.t_tests import student_t, student_t_against
from backend.analysis.tested import holm, mean_of

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
    test = student_t_against(SECOND, 0.0)
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
