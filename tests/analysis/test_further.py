"""Equivalence, Bayes factors, reliability and worths against published numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from statsmodels.stats.weightstats import DescrStatsW

from backend.analysis.bradley_terry import bradley_terry
from backend.analysis.equivalence import bayes_factor, bayes_factor_of_choices, equivalence
from backend.analysis.reliability import reliability

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
    assert equivalence([0.25, 0.25, 0.25], 0.5, about="x").p == 0.0
    assert equivalence([0.9, 0.9], 0.5, about="x").p == 1.0
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
