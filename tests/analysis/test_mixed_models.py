"""Mixed models against R's `ordinal` and `lme4`-like limits."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import special, stats
from statsmodels.miscmodels.ordinal_model import OrderedModel

from desirepath.analysis.mixed_models import MixedFit, NoFit, chance_of_the_higher, cumulative_logit, ratio_test

# Randall (1989), ratings of bitterness of wines by nine judges, cold and warm, without and with contact to the skins,
# twice each; R's `ordinal::wine`. Christensen's tutorial of clmm2 gives for rating ~ temp + contact, random judge,
# nAGQ = 10: 3.0619 (0.5951), 1.8334 (0.5122), thresholds -1.6237, 1.5134, 4.2285, 6.0888 (Laplace), variance 1.288,
# log-likelihood -81.53246.
RATINGS = [
    *(2, 3, 3, 4, 4, 4, 5, 5, 1, 2, 1, 3, 2, 3, 5, 4, 2, 3, 3, 2, 5, 5, 4, 4, 3, 2, 3, 2, 3, 2, 5, 3, 2, 3, 4, 3),
    *(3, 3, 3, 3, 3, 2, 3, 2, 2, 4, 5, 4, 1, 1, 2, 2, 2, 3, 2, 3, 2, 2, 2, 3, 3, 3, 3, 4, 1, 2, 3, 2, 3, 2, 4, 4),
]
CONDITIONS = np.column_stack([np.tile([0, 0, 0, 0, 1, 1, 1, 1], 9), np.tile([0, 0, 1, 1, 0, 0, 1, 1], 9)])
JUDGES = np.repeat(np.arange(9), 8)


def test_the_judges_of_wine() -> None:
    fit = cumulative_logit(RATINGS, CONDITIONS, JUDGES, ("warm", "contact"))
    assert fit.coefficients == pytest.approx([3.0619, 1.8334], abs=2e-4)
    assert fit.errors == pytest.approx([0.5951, 0.5122], abs=2e-4)
    assert fit.log_likelihood == pytest.approx(-81.53246, abs=1e-4)
    assert fit.person_sd**2 == pytest.approx(1.288, abs=1e-3)
    assert fit.thresholds == pytest.approx([-1.6237, 1.5134, 4.2285, 6.0888], abs=0.005)
    assert fit.interval(0) == pytest.approx((3.0619 - 1.96 * 0.5951, 3.0619 + 1.96 * 0.5951), abs=1e-3)


def test_a_condition_is_tested_by_the_ratio_of_likelihoods() -> None:
    """Twice the difference of the log-likelihoods, one degree of freedom: contact with the skins matters."""
    whole = cumulative_logit(RATINGS, CONDITIONS, JUDGES, ("warm", "contact"))
    without = cumulative_logit(RATINGS, CONDITIONS[:, :1], JUDGES, ("warm",))
    test = ratio_test(whole, without)
    assert (test.statistic, test.df) == (pytest.approx(2 * (whole.log_likelihood - without.log_likelihood)), 1)
    assert test.p < 0.001


def test_people_who_do_not_differ_leave_an_ordinary_model() -> None:
    """Everybody once: statsmodels' ordered logit has the same likelihood, to which the mixed one converges."""
    random = np.random.default_rng(2)
    x = random.integers(0, 2, 400)
    y = 1 + np.digitize(0.8 * x + random.logistic(size=400), [-1.0, 0.5, 1.5])
    theirs = OrderedModel(y, x[:, None].astype(float), distr="logit").fit(disp=False)
    fit = cumulative_logit(y, x, np.repeat(np.arange(40), 10), ("x",))
    assert fit.person_sd < 0.3
    assert fit.log_likelihood >= theirs.llf - 1e-3
    assert fit.coefficients[0] == pytest.approx(theirs.params[0], abs=0.03)
    assert fit.errors[0] == pytest.approx(theirs.bse[0], abs=0.02)


def test_choices_of_two_are_a_logistic_model() -> None:
    random = np.random.default_rng(5)
    people = np.repeat(np.arange(60), 12)
    x = np.tile([0, 1], 360)
    own = random.normal(0, 1.2, 60)
    y = random.random(720) < special.expit(0.4 + 0.9 * x + own[people])
    fit = cumulative_logit(y, x, people, ("x",))
    assert fit.coefficients[0] == pytest.approx(0.9, abs=2.5 * fit.errors[0])
    assert fit.person_sd == pytest.approx(1.2, abs=0.4)
    assert -fit.thresholds[0] == pytest.approx(0.4, abs=0.5)
    ordinary = sm.Logit(y.astype(float), sm.add_constant(x.astype(float))).fit(disp=False)
    assert fit.log_likelihood > ordinary.llf + 20  # people differ
    alone = cumulative_logit(y, np.zeros((720, 0)), people, [])
    at, low, high = chance_of_the_higher(alone)
    assert low < at < high
    assert at == pytest.approx(special.expit(0.85), abs=0.1)
    assert special.logit(high) - special.logit(low) == pytest.approx(2 * 1.959964 * alone.first_error, rel=1e-5)


def test_what_has_no_fit_says_why() -> None:
    with pytest.raises(NoFit, match="same answer"):
        cumulative_logit([3, 3, 3], np.zeros((3, 0)), [1, 2, 3], [])
    with pytest.raises(NoFit):
        cumulative_logit([1] * 20 + [2] * 20, [0] * 20 + [1] * 20, list(range(20)) * 2, ("x",))


def test_answers_that_tell_the_conditions_apart_without_exception_have_no_fit() -> None:
    """Six people who each rate the second condition two or three points lower: the likelihood grows without end."""
    ratings = [6, 4, 7, 4, 6, 4, 6, 4, 5, 2, 6, 4]
    people = [f"P-{k // 2}" for k in range(12)]
    with pytest.raises(NoFit, match="without exception"):
        cumulative_logit(ratings, np.tile([[0.0], [1.0]], (6, 1)), people, ["second"], nodes=5)


def marginal(theta: np.ndarray, y: np.ndarray, x: np.ndarray, who: np.ndarray) -> float:
    """Log-likelihood of thresholds, coefficients and the SD of people: intercepts summed over a dense fixed grid."""
    cuts = int(y.max())
    edges = np.concatenate([[-40.0], theta[:cuts], [40.0]])
    z, weights = np.polynomial.hermite_e.hermegauss(120)
    eta = (x @ theta[cuts:-1])[:, None] + theta[-1] * z
    chance = special.expit(edges[y + 1][:, None] - eta) - special.expit(edges[y][:, None] - eta)
    own = np.stack([chance[who == person].prod(axis=0) for person in np.unique(who)])
    return float(np.log(own @ weights / np.sqrt(2 * np.pi)).sum())


def parameters(fit: MixedFit) -> np.ndarray:
    return np.concatenate([fit.thresholds, fit.coefficients, [fit.person_sd]])


@pytest.mark.parametrize(("levels", "seed"), [(2, 1), (3, 2), (5, 3)])
def test_the_maximum_and_the_errors_are_those_of_another_integration(levels: int, seed: int) -> None:
    """Log-likelihood at the estimates, no slope there, and the errors of its curvature, all over a grid of our own."""
    random = np.random.default_rng(seed)
    who = np.repeat(np.arange(12), 8)
    x = random.normal(size=(96, 2))
    latent = x @ [0.8, -0.5] + random.normal(0, 1.3, 12)[who] + random.logistic(size=96)
    y = np.digitize(latent, np.linspace(-1.5, 1.5, levels + 1)[1:-1] if levels > 2 else [0.2])
    fit = cumulative_logit(10 * y + 3, x, who + 100, ("one", "other"))
    at = parameters(fit)
    assert fit.log_likelihood == pytest.approx(marginal(at, y, x, who), abs=1e-4)
    h = 1e-3 * np.eye(len(at))
    slope = [(marginal(at + e, y, x, who) - marginal(at - e, y, x, who)) / 2e-3 for e in h]
    assert slope == pytest.approx(np.zeros(len(at)), abs=0.01)
    curvature = np.array(
        [
            [
                (
                    marginal(at + a + b, y, x, who) - marginal(at + a - b, y, x, who)
                    - marginal(at - a + b, y, x, who) + marginal(at - a - b, y, x, who)
                ) / 4e-6
                for b in h
            ]
            for a in h
        ]
    )  # fmt: skip
    errors = np.sqrt(np.diag(np.linalg.inv(-curvature)))
    assert fit.errors == pytest.approx(errors[levels - 1 : -1], rel=2e-3)
    assert fit.first_error == pytest.approx(errors[0], rel=2e-3)
    assert fit.interval(1) == pytest.approx(at[levels] + np.array([-1.959964, 1.959964]) * fit.errors[1])


def test_the_interval_of_the_higher_answer_is_wald_s_in_log_odds() -> None:
    """15 of 20 answers by hand, a person each: logit 0.75, error of the logit sqrt(1 / 15 + 1 / 5)."""
    fit = cumulative_logit([1] * 15 + [0] * 5, np.zeros((20, 0)), np.zeros(20), [])
    at, low, high = chance_of_the_higher(MixedFit((), fit.coefficients, fit.errors, -special.logit([0.75]), 0.5, 0, 0))
    assert (at, low, high) == pytest.approx(
        (0.75, *special.expit(special.logit(0.75) + np.array([-0.98, 0.98]))), abs=1e-4
    )


def test_predictors_that_say_the_same_have_no_errors() -> None:
    with pytest.raises(NoFit, match="predictors say the same"):
        cumulative_logit(RATINGS, np.column_stack([CONDITIONS[:, 0]] * 2), JUDGES, ("warm", "again"))


def test_a_larger_model_that_says_no_more_has_no_evidence() -> None:
    small = MixedFit((), np.zeros(1), np.zeros(1), np.zeros(1), 1.0, 1.0, -50.0)
    large = MixedFit((), np.zeros(3), np.zeros(3), np.zeros(1), 1.0, 1.0, -47.0)
    test = ratio_test(large, small)
    assert (test.statistic, test.df, test.p) == (6.0, 2, pytest.approx(stats.chi2.sf(6, 2)))
    worse = ratio_test(MixedFit((), np.zeros(2), np.zeros(2), np.zeros(1), 1.0, 1.0, -50.1), small)
    assert (worse.statistic, worse.p) == (0.0, 1.0)
