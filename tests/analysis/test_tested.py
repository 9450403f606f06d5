"""Corrections for families, marks, and what a sentence says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from statsmodels.stats.multitest import multipletests

from desirepath.analysis import tested as results
from desirepath.analysis.anova import rm_anova
from desirepath.analysis.between_groups import kruskal_wallis, mann_whitney
from desirepath.analysis.equivalence import equivalence
from desirepath.analysis.factorial import Factorial
from desirepath.analysis.repeated_measures import friedman, wilcoxon
from desirepath.analysis.tested import correct_pairs, correct_tests, p_in_words, star_bounds, stars
from desirepath.report.report_cells import p_cells, statistic_cell


def result(p: float, *, least: float = 0.0) -> results.Tested:
    return results.Tested(
        "Test", "fun", "W", 3.0, None, p, p, "uncorrected", "r", 0.5, 9, 9, "a is higher", least_p=least,
        least_p_corrected=least,
    )  # fmt: skip


@pytest.mark.parametrize("how", ["holm", "bonferroni"])
def test_corrections_are_statsmodels(how: str) -> None:
    raw = [0.04, 0.001, 0.03, 0.2, 0.011]
    theirs = multipletests(raw, method=how)[1]
    assert [one.p_corrected for one in correct_tests([result(p) for p in raw], how)] == pytest.approx(list(theirs))
    assert [one.p_corrected for one in correct_tests([result(p) for p in raw], "none")] == raw


def test_marks_follow_alpha() -> None:
    assert [stars(p) for p in (0.06, 0.05, 0.01, 0.001)] == ["", "*", "**", "***"]
    assert [stars(p, 0.01) for p in (0.05, 0.011, 0.01, 0.001)] == ["", "", "*", "**"]
    assert [stars(p, 0.1) for p in (0.11, 0.1, 0.01, 0.001)] == ["", "*", "**", "***"]
    assert star_bounds(0.0005) == [0.0005]


def test_who_could_not_have_found_anything_is_told_so() -> None:
    """Five people: no signed-rank test can be below 2 / 2^5."""
    few = result(0.0625, least=2 / 2**5)
    assert not few.possible(0.05)
    assert few.sentence().startswith("Fun: no difference was found and none could be with so few people (p cannot be ")
    assert few.possible(0.1)
    three = correct_tests([result(0.3, least=0.03), result(0.4, least=0.03)], "bonferroni")
    assert [one.least_p_corrected for one in three] == [0.06, 0.06]
    enough = correct_tests([result(0.3, least=0.001), result(0.4, least=0.03)], "holm")
    assert [one.possible() for one in enough] == [True, True]


def test_pairs_behind_a_gate_are_corrected_over_pairs_and_items() -> None:
    """Of three conditions that are not all alike at most one pair is (Shaffer): times items; of four at most three."""
    gate = result(0.002)
    pairs = correct_pairs([result(0.001), result(0.004), result(0.3)], 10, gate)
    assert [one.p_corrected for one in pairs] == pytest.approx([0.02, 0.04, 1.0])
    assert {one.correction for one in pairs} == {"Shaffer, Bonferroni over the items"}
    alone = correct_pairs([result(0.001), result(0.004), result(0.3)], 1, gate)
    assert [one.p_corrected for one in alone] == pytest.approx([0.002, 0.004, 0.3])
    thesis = correct_pairs([result(0.001), result(0.004), result(0.3)], None, gate)
    assert [one.p_corrected for one in thesis] == pytest.approx([0.003, 0.012, 0.9])
    assert thesis[0].correction == "Bonferroni"
    of_four = correct_pairs([result(0.001)] * 6, 2, result(0.0001))
    assert of_four[0].p_corrected == pytest.approx(0.006)
    free = correct_pairs([result(0.001, least=0.0005)] * 3, 10, None)
    assert (free[0].p_corrected, free[0].least_p_corrected) == pytest.approx((0.03, 0.015))
    assert free[0].correction == "Bonferroni"


def test_the_sentence_says_how_p_was_found() -> None:
    test = result(0.004)
    assert test.sentence() == "Fun: a is higher, W(N = 9) = 3.00, p = 0.004, r = 0.50."
    (found,) = correct_tests(
        [results.Tested(**{**test.as_dict(), "method": "exact", "effect_low": 0.1, "effect_high": 0.8})], "holm"
    )
    assert found.sentence() == "Fun: a is higher, W(N = 9) = 3.00, p = 0.004 (exact, Holm), r = 0.50 [0.10, 0.80]."
    f = results.Tested(**{**test.as_dict(), "symbol": "F", "df": 2, "df_error": 24, "used": 7, "z": -2.0})
    assert "F(2, 24, N = 9, 7 used) = 3.00, z = -2.00, p = 0.004, r" in f.sentence()


def test_p_is_told_as_papers_write_it() -> None:
    assert [p_in_words(p) for p in (0.0009, 0.001, 0.05)] == ["p < 0.001", "p = 0.001", "p = 0.050"]


def test_a_test_of_which_nothing_is_known_could_have_found_something() -> None:
    """Without a least p, as of approximate tests; and p that is alpha itself is significant, no p is twice one."""
    plain = results.Tested("Test", "fun", "W", 3.0, None, 0.2, 0.2, "uncorrected", "r", 0.5, 9, 9, "a is higher")
    assert plain.possible(0.0)
    assert plain.sentence() == "Fun: no difference was found, W(N = 9) = 3.00, p = 0.200, r = 0.50."
    assert result(0.05).significant()
    assert result(0.01).significant(0.01)
    assert not result(0.0501).significant()
    assert result(0.3, least=0.05).possible()
    (same,) = correct_tests([plain], "bonferroni")
    assert (same.p_corrected, same.correction) == (0.2, "Bonferroni")
    assert [one.p_corrected for one in correct_tests([result(0.6)] * 3, "bonferroni")] == [1.0] * 3
    assert [one.p_corrected for one in correct_tests([result(0.6)] * 3, "holm")] == [1.0] * 3


def test_pairs_are_no_smaller_than_their_gate_and_least_p_neither() -> None:
    """Two items of three conditions: p times two for the one pair that can be alike, but at least the gate's."""
    gate = result(0.02, least=0.003)
    low, high = correct_pairs([result(0.001, least=0.001), result(0.03, least=0.004), result(0.6)], 2, gate)[:2]
    assert (low.p_corrected, high.p_corrected) == pytest.approx((0.04, 0.06))
    assert (low.least_p_corrected, high.least_p_corrected) == pytest.approx((0.006, 0.008))
    (two,) = correct_pairs([result(0.01)], 3, result(0.01))
    assert two.p_corrected == pytest.approx(0.03)
    assert correct_pairs([result(0.4)] * 3, 2, None)[0].p_corrected == 1.0
    assert correct_pairs([result(0.4, least=0.4)] * 3, 2, None)[0].least_p_corrected == 1.0
    assert correct_pairs([result(0.01)] * 3, 1, gate)[0].correction == "Shaffer"
    assert correct_pairs([], 2, None) == []


def test_no_test_whatever_is_significant_without_spread() -> None:
    """Everybody's answers the same, or (t and F) everybody's difference the same."""
    names = ("a", "b")
    alike, shifted = np.full(12, 4.0), np.tile([4.0, 4.2], (12, 1))
    within = Factorial(shifted, np.zeros(12, dtype=int), {"view": names}, {})
    between = Factorial(np.repeat([[4.0], [5.0]], 6, axis=0), np.repeat([0, 1], 6), {}, {"robot": names})
    tests = [
        wilcoxon(alike, alike, about="ease", names=names),
        friedman(np.full((12, 3), 4.0), about="ease"),
        mann_whitney(alike, alike, about="ease", names=names),
        kruskal_wallis([alike, alike, alike], about="ease"),
        equivalence(shifted[:, 1] - shifted[:, 0], 0.5, about="ease"),
        *rm_anova(within, about="ease"),
        *rm_anova(between, about="ease"),
    ]
    for test in correct_tests(tests, "none"):
        assert (test.no_spread, test.significant(), test.stars()) == (True, False, ""), test.test
        assert "no spread, not testable" in test.sentence()
        assert p_cells(test, 0.05) == ["not testable", "–", "no spread"]
        assert statistic_cell(test) == "–"
        assert math.isnan(test.effect_low), test.test
