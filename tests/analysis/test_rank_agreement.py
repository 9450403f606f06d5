"""Kendall's tau-b of many rankings at once against scipy's of each, ties on either side included."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.estimates import kendall_tau_b


@pytest.mark.parametrize(("columns", "points"), [(2, 9), (3, 3), (5, 4), (9, 3)])
def test_each_row_s_tau_is_scipy_s(columns: int, points: int) -> None:
    random = np.random.default_rng(columns)
    first, second = random.integers(0, points, (2, 40, columns))
    found = kendall_tau_b(first, second)
    theirs = [stats.kendalltau(a, b).statistic for a, b in zip(first, second, strict=True)]
    assert found.shape == (40,)
    assert found == pytest.approx(np.array(theirs), nan_ok=True)
    assert np.isfinite(found).any()


def test_an_order_agrees_with_itself_and_one_without_any_order_says_nothing() -> None:
    assert kendall_tau_b([1, 2, 3], [10, 20, 30]) == pytest.approx([1.0])
    assert kendall_tau_b([[1, 2, 3], [1, 2, 3]], [[3, 2, 1], [2, 2, 2]]) == pytest.approx([-1.0, np.nan], nan_ok=True)
    assert kendall_tau_b([1, 2], [2, 1]) == pytest.approx([-1.0])


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ([[1, 2, 3]], [[1, 2]]),  # as many objects in both
        ([[1], [2]], [[1], [2]]),  # of one object there is no order
        ([[[1, 2], [2, 1]]], [[[1, 2], [2, 1]]]),  # rows of rows
    ],
)
def test_rankings_that_are_not_of_the_same_objects_are_refused(first: list, second: list) -> None:
    with pytest.raises(ValueError, match="at least two columns"):
        kendall_tau_b(first, second)
