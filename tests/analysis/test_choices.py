"""Tests and measures of choices against published or hand-worked examples."""

from __future__ import annotations

import math

import pytest

from desirepath.analysis.choices import (
    agreement,
    cohens_kappa,
    equal_first_choices,
    first_choice_pairs,
    share_over_people,
    sign_test,
)
from desirepath.analysis.triads import whole_triads


def test_chi_square_of_rs_example() -> None:
    """R's help of chisq.test: c(A = 20, B = 15, C = 25) gives X-squared = 2.5, df = 2, p-value = 0.2865."""
    test = equal_first_choices([20, 15, 25], about="first choices")
    assert (test.statistic, test.df, test.p) == pytest.approx((2.5, 2, 0.2865), abs=5e-5)
    assert test.effect == pytest.approx(math.sqrt(2.5 / 120))


def test_the_thesis_s_ranking_of_intention_to_use() -> None:
    """29 of 32 chose VR first, nobody FPV (ch. 7): z of VR against top-down is 26 / sqrt(32) = 4.60."""
    names = ("immersive", "top_down", "first_person")
    assert equal_first_choices([29, 3, 0], about="intention").stars() == "***"
    pairs = first_choice_pairs([29, 3, 0], names, about="intention")
    assert [test.statistic for test in pairs] == pytest.approx([26 / math.sqrt(32), math.sqrt(29), math.sqrt(3)])
    assert pairs[0].direction == "immersive is more often the first choice than top_down"
    assert pairs[0].effect == pytest.approx(29 / 32 - 0.5)


def test_kappa_of_a_known_table() -> None:
    """20 both yes, 15 both no, 5 and 10 apart: agreement 0.7, by chance 0.5, kappa 0.4 (a common textbook example)."""
    first = ["y"] * 25 + ["n"] * 25
    second = ["y"] * 20 + ["n"] * 5 + ["y"] * 10 + ["n"] * 15
    assert agreement(first, second) == pytest.approx(0.7)
    assert cohens_kappa(first, second) == pytest.approx(0.4)


def test_a_position_habit_looks_like_agreement_and_kappa_tells() -> None:
    first, second = ["b"] * 9 + ["a"], ["b"] * 10
    assert agreement(first, second) == pytest.approx(0.9)
    assert cohens_kappa(first, second) == pytest.approx(0.0)
    assert math.isnan(cohens_kappa(["b"] * 5, ["b"] * 5))


def test_people_not_answers_are_counted() -> None:
    """8 of 9 people with a majority: two-sided binomial p = 2 (9 + 1) / 2^9 = 0.0390625, however many answers each."""
    wins, losses = [3] * 8 + [0, 1], [0] * 8 + [3, 1]
    test = sign_test(wins, losses, about="comparisons", names=("own", "base"))
    assert (test.p, test.n, test.used) == (pytest.approx(0.0390625), 10, 9)
    assert test.direction == "own is mostly chosen over base"
    share = share_over_people(wins, losses)
    assert (share.n, share.mean) == (10, pytest.approx(0.85))
    assert share_over_people([*wins, 0], [*losses, 0]) == share, "who was asked nothing has no share"
    with pytest.raises(ValueError, match="shorter"):
        share_over_people([1, 2], [1])


@pytest.mark.parametrize("bad", [[5], [0, 0], [3, -1]])
def test_counts_that_are_none_are_refused(bad: list[int]) -> None:
    with pytest.raises(ValueError, match="counts"):
        equal_first_choices(bad, about="first choices")


def test_triads_are_the_three_pairs_of_three() -> None:
    """p, q, r were compared in all pairs, x, y, z in two; p, q, r and s share trajectories and make two triads."""
    pairs = {frozenset(pair): pair for pair in ("pq", "qr", "rp", "xy", "yz")}
    assert whole_triads(pairs) == [["pq", "qr", "rp"]]
    pairs |= {frozenset(pair): pair for pair in ("rs", "sp")}
    assert whole_triads(pairs) == [["pq", "qr", "rp"], ["rp", "rs", "sp"]]


def test_two_that_nobody_put_first_do_not_differ() -> None:
    (nobody,) = [one for one in first_choice_pairs([9, 0, 0], ("x", "y", "z"), about="fun") if one.used == 0]
    assert (nobody.statistic, nobody.effect, nobody.p) == (0.0, 0.0, 1.0)
    assert [one.used for one in first_choice_pairs([5, 3, 1], ("x", "y", "z"), about="fun")] == [8, 6, 4]
