"""Equivalence, Bayes factors, reliability and worths against published numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import integrate, stats
from statsmodels.stats.weightstats import DescrStatsW

from desirepath.analysis.bradley_terry import bradley_terry
from desirepath.analysis.equivalence import bayes_factor, bayes_factor_of_choices, equivalence
from desirepath.analysis.reliability import reliability

# Student (1908); R's `sleep`
FIRST = np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
SECOND = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
# Agresti (2013), table 11.10: games of the American League, eastern division, 1987, row over column.
TEAMS = ("Milwaukee", "Detroit", "Toronto", "New York", "Boston", "Cleveland", "Baltimore")
WINS = np.array(
    [
        [0, 7, 9, 7, 7, 9, 11],
        [6, 0, 7, 5, 11, 9, 9],
        [4, 6, 0, 7, 7, 8, 12],
        [6, 8, 6, 0, 6, 7, 10],
        [6, 2, 6, 7, 0, 7, 12],
        [4, 4, 5, 6, 6, 0, 6],
        [2, 4, 1, 3, 1, 7, 0],
    ]
)


def test_two_one_sided_tests_are_statsmodels() -> None:
    differences = FIRST - SECOND
    for margin in (1.0, 2.0, 3.0):
        test = equivalence(differences, margin, about="sleep")
        assert test.p == pytest.approx(DescrStatsW(differences).ttost_mean(-margin, margin)[0])
        within = -margin < test.effect_low and test.effect_high < margin
        assert within == (test.p <= 0.05)
    assert test.effect == pytest.approx(-1.58)
    assert test.sentence().startswith("Sleep, within ±3: the difference is smaller than 3, t(9, N = 10)")
    with pytest.raises(ValueError, match="margin = 0"):
        equivalence(differences, 0, about="x")


def test_the_bayes_factor_is_that_of_r() -> None:
    """BayesFactor::ttestBF(sleep, paired) gives 17.25888."""
    assert bayes_factor(FIRST - SECOND) == pytest.approx(17.25888, abs=1e-4)
    assert bayes_factor([-1.0, 1.0, -0.5, 0.5, 0.2, -0.2]) < 0.5
    assert math.isnan(bayes_factor([1.0, 1.0]))
    # 115 of 200: a well-known example of Wikipedia's article on Bayes factors gives 1 / 1.2
    assert bayes_factor_of_choices(115, 85) == pytest.approx(1 / 1.2, abs=0.01)
    assert bayes_factor_of_choices(0, 0) == pytest.approx(1.0)


@pytest.mark.parametrize("margin", [1.0, 1.58, 2.5])
def test_a_difference_is_within_a_margin_where_both_one_sided_tests_say_so(margin: float) -> None:
    """t = (|mean| - margin) / se by hand; at the margin itself p is one half."""
    differences = FIRST - SECOND
    test = equivalence(differences, margin, about="sleep")
    se = differences.std(ddof=1) / math.sqrt(10)
    assert test.statistic == pytest.approx((1.58 - margin) / se, abs=1e-9)
    assert (test.effect_low, test.effect_high) == pytest.approx((-1.58 - 1.833113 * se, -1.58 + 1.833113 * se))
    assert (test.p_corrected, test.n, test.used, test.df) == (test.p, 10, 10, 9)


@pytest.mark.parametrize("same", [[0, 0], [0.25, 0.25, 0.25], [0.2, 0.2, 0.2], [0.9, 0.9], [0.3, 0.1 + 0.2]])
def test_whoever_differs_alike_shows_neither_equivalence_nor_difference(same: list[float]) -> None:
    test = equivalence(same, 0.5, about="ease")
    assert (test.p, test.no_spread, test.significant(), test.possible()) == (1.0, True, False, True)
    assert math.isnan(test.statistic)
    assert math.isnan(test.effect_low)
    assert test.sentence() == f"Ease, within ±0.5: no spread, not testable (N = {len(same)})."
    assert math.isnan(bayes_factor(same))


def test_two_people_and_two_numbers_are_enough_for_equivalence() -> None:
    assert equivalence([0.1, 0.3], 5.0, about="x").n == 2
    for bad in ([1.0], [[1.0, 2.0], [2.0, 1.0]], [1.0, math.nan]):
        with pytest.raises(ValueError, match="at least 2 numbers"):
            equivalence(bad, 1.0, about="x")
    with pytest.raises(ValueError, match="margin = -1"):
        equivalence([1.0, 2.0], -1, about="x")


@pytest.mark.parametrize("data", [[0.4, 1.9], [1.0, -0.5, 2.0, 0.3, 0.8], list(np.linspace(-2, 3, 31))])
def test_the_bayes_factor_averages_over_cauchy_effects(data: list[float]) -> None:
    """Rouder et al. (2009): the noncentral t distribution averaged over effects, Cauchy of scale 0.7071, against the
    central one."""
    n, t = len(data), stats.ttest_1samp(data, 0).statistic

    def weighed(effect: float) -> float:
        return float(stats.nct.pdf(t, n - 1, effect * math.sqrt(n)) * stats.cauchy.pdf(effect, 0, math.sqrt(0.5)))

    alternative = sum(integrate.quad(weighed, a, b)[0] for a, b in ((-8, -1), (-1, 0), (0, 1), (1, 8)))
    assert bayes_factor(data) == pytest.approx(alternative / stats.t.pdf(t, n - 1), rel=0.003)


@pytest.mark.parametrize(("first", "second"), [(1, 0), (3, 3), (2, 9), (20, 11)])
def test_of_choices_every_number_of_wins_is_as_likely_if_any_chance_may_be(first: int, second: int) -> None:
    """Uniform chances make each of the n + 1 numbers as likely: 1 / (n + 1) against C(n, k) / 2^n."""
    n = first + second
    assert bayes_factor_of_choices(first, second) == pytest.approx(2**n / (n + 1) / math.comb(n, first))


def test_who_is_alone_has_no_bayes_factor() -> None:
    assert math.isnan(bayes_factor([1.0]))
    assert math.isnan(bayes_factor([2.0, 2.0, 2.0]))


def test_omega_of_three_items_has_a_closed_form() -> None:
    """Three covariances are three products of loadings: l1^2 = c12 c13 / c23. A loading beyond its item's variance
    leaves that item no variance of its own, not a negative one."""
    random = np.random.default_rng(4)
    raw = random.normal(size=(60, 3))
    raw -= raw.mean(axis=0)
    white = raw @ np.linalg.inv(np.linalg.cholesky(np.cov(raw, rowvar=False))).T
    for covariance in (
        [[2.0, 0.8, 0.6], [0.8, 1.5, 0.5], [0.6, 0.5, 1.0]],
        [[1.0, 0.9, 0.8], [0.9, 1.5, 0.6], [0.8, 0.6, 1.5]],
    ):
        c = np.array(covariance)
        found = reliability(white @ np.linalg.cholesky(c).T)
        squares = np.array([c[0, 1] * c[0, 2] / c[1, 2], c[0, 1] * c[1, 2] / c[0, 2], c[0, 2] * c[1, 2] / c[0, 1]])
        common = np.sqrt(squares).sum() ** 2
        assert found.omega == pytest.approx(common / (common + np.maximum(np.diag(c) - squares, 0).sum()), abs=1e-6)
        assert found.alpha == pytest.approx(1.5 * (1 - np.trace(c) / c.sum()))


def test_three_people_have_an_alpha_and_opposite_items_have_none() -> None:
    few = reliability([[1.0, 2.0, 2.0], [2.0, 2.0, 3.0], [4.0, 3.0, 5.0]])
    assert (few.n, few.items) == (3, 3)
    assert few.low < few.alpha < few.high <= 1
    opposite = reliability([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0], [4.0, 0.0]])
    assert math.isnan(opposite.alpha)
    assert math.isnan(opposite.omega)
    with pytest.raises(ValueError, match="finite"):
        reliability([[1.0, math.nan], [1.0, 2.0], [2.0, 2.0]])
    with pytest.raises(ValueError, match="people in rows"):
        reliability([1.0, 2.0, 3.0])


def test_alpha_and_omega_of_a_known_factor() -> None:
    """With loadings l of standardised items omega is (sum l)^2 / ((sum l)^2 + sum(1 - l^2)), alpha less."""
    loadings = np.array([0.8, 0.6, 0.7, 0.5])
    covariance = np.outer(loadings, loadings) + np.diag(1 - loadings**2)
    random = np.random.default_rng(1)
    raw = random.normal(size=(300, 4))
    raw -= raw.mean(axis=0)
    exact = raw @ np.linalg.inv(np.linalg.cholesky(np.cov(raw, rowvar=False))).T @ np.linalg.cholesky(covariance).T
    found = reliability(exact)
    assert found.omega == pytest.approx(2.6**2 / (2.6**2 + (1 - loadings**2).sum()), abs=1e-6)
    assert found.alpha == pytest.approx(4 / 3 * (1 - 4 / covariance.sum()))
    assert found.low < found.alpha < found.high < 1
    assert (found.n, found.items) == (300, 4)


def test_alpha_is_pingouin_s() -> None:
    """pingouin.cronbach_alpha of these answers."""
    answers = np.array([[1, 2, 2], [3, 3, 4], [5, 4, 5], [2, 2, 1], [4, 5, 3], [3, 2, 4], [5, 5, 4], [2, 4, 3]])
    found = reliability(answers)
    assert found.alpha == pytest.approx(0.8442857142857144)
    assert (found.low, found.high) == pytest.approx((0.474, 0.966), abs=5e-4)
    assert math.isnan(reliability(answers[:, :2]).omega)
    assert math.isnan(reliability(answers[:2]).alpha)
    assert math.isnan(reliability(np.ones((5, 3))).alpha)
    with pytest.raises(ValueError, match="at least 2 items"):
        reliability(answers[:, :1])


def test_worths_of_the_baseball_teams() -> None:
    """Agresti: 1.58, 1.44, 1.29, 1.25, 1.11, 0.68 above Baltimore."""
    found = bradley_terry(WINS[None], TEAMS, shared=0.0)
    against = [one.log_worth - found[-1].log_worth for one in found]
    assert against == pytest.approx([1.581, 1.436, 1.294, 1.248, 1.108, 0.684, 0.0], abs=1e-3)
    assert sum(one.share for one in found) == pytest.approx(1.0)
    assert sum(one.log_worth for one in found) == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(found[0].low)


def test_who_always_wins_has_a_worth_and_people_are_the_units() -> None:
    always = np.array([[[0, 5], [0, 0]]] * 8)
    own, other = bradley_terry(always, ("own", "other"))
    assert own.log_worth == -other.log_worth
    assert 1 < own.log_worth < 4
    random = np.random.default_rng(3)
    own = random.binomial(10, random.beta(3, 2, 20))
    people = np.array([[[0, w], [10 - w, 0]] for w in own])
    (one, _) = bradley_terry(people, ("own", "other"), shared=0.0)
    share = own.mean() / 10
    assert one.log_worth == pytest.approx(math.log(share / (1 - share)) / 2, abs=1e-4)
    se = own.std(ddof=1) / 10 / math.sqrt(20) / (share * (1 - share)) / 2
    assert (one.high - one.low) / 2 == pytest.approx(2.093 * se, rel=0.02)
    with pytest.raises(ValueError, match="at least one win"):
        bradley_terry(np.zeros((2, 2, 2)), ("a", "b"))


def test_worths_of_three_and_their_intervals_are_those_of_a_clustered_logistic_model() -> None:
    """Each answer a row with +1 for the one and -1 for the other; covariance clustered by people, times n / (n - 1)."""
    random = np.random.default_rng(6)
    people = np.zeros((14, 3, 3))
    rows, won, who = [], [], []
    for person in range(14):
        worth = np.array([0.8, 0.2, -1.0]) + random.normal(0, 0.7, 3)
        for i, j in ((0, 1), (0, 2), (1, 2)) * 4:
            first = random.random() < 1 / (1 + math.exp(worth[j] - worth[i]))
            people[person][(i, j) if first else (j, i)] += 1
            row = np.zeros(3)
            row[i], row[j] = 1, -1
            rows.append(row), won.append(float(first)), who.append(person)
    free = np.array(rows)[:, :2] - np.array(rows)[:, 2:]  # worths sum up to 0
    model = sm.GLM(np.array(won), free, family=sm.families.Binomial())
    fit = model.fit(cov_type="cluster", cov_kwds={"groups": np.array(who), "use_correction": False})
    found = bradley_terry(people, ("a", "b", "c"), shared=0.0)
    assert [one.log_worth for one in found[:2]] == pytest.approx(list(fit.params), abs=1e-4)
    half = stats.t.ppf(0.975, 13) * np.sqrt(np.diag(fit.cov_params()) * 14 / 13)
    assert [one.high - one.log_worth for one in found[:2]] == pytest.approx(list(half), rel=1e-3)
    assert [one.log_worth - one.low for one in found[:2]] == pytest.approx(list(half), rel=1e-3)
    worths = np.exp([one.log_worth for one in found])
    assert [one.share for one in found] == pytest.approx(list(worths / worths.sum()))


def test_worths_have_no_interval_where_nobody_differs() -> None:
    wins = np.zeros((4, 3, 3))
    wins[:, 0, 1] = wins[:, 0, 2] = wins[:, 1, 2] = 3
    assert all(math.isnan(one.low) and math.isnan(one.high) for one in bradley_terry(wins, ["a", "b", "c"]))
    wins[0, 1, 0] = 1  # one of them once chose otherwise
    assert all(one.low < one.log_worth < one.high for one in bradley_terry(wins, ["a", "b", "c"]))


def test_half_a_win_and_half_a_loss_are_shared_among_the_pairs_that_were_compared() -> None:
    """40 wins of 40: 40.5 against 0.5. Of two pairs compared each gets half of that; the third was not compared."""
    own, _ = bradley_terry(np.array([[[0, 5], [0, 0]]] * 8), ("own", "other"))
    assert own.log_worth == pytest.approx(math.log(40.5 / 0.5) / 2, abs=1e-4)
    chain = np.zeros((2, 3, 3))
    chain[:, 0, 1], chain[:, 1, 2] = 3, 2
    a, b, c = bradley_terry(chain, ("a", "b", "c"))
    assert a.log_worth - b.log_worth == pytest.approx(math.log(6.25 / 0.25), abs=1e-3)
    assert b.log_worth - c.log_worth == pytest.approx(math.log(4.25 / 0.25), abs=1e-3)


@pytest.mark.parametrize("bad", [np.ones((2, 2)), np.ones((3, 2, 3)), np.ones((1, 1, 1))])
def test_tables_of_another_shape_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match="wins: shape"):
        bradley_terry(bad, ("a", "b")[: bad.shape[-1]])
