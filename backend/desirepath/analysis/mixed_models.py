"""Mixed models of ordered answers and of choices: logistic, cumulative, with an intercept of each person's own.

A choice between two is an ordered answer with two levels, so one model serves both. Maximum likelihood, people's
intercepts integrated out by adaptive Gauss-Hermite quadrature; what stands in the model is the reports' business.
statsmodels has neither: its ordered models know no people, its mixed logistic ones are Bayesian, by Laplace or
variational approximation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special, stats

Array = NDArray[np.float64]
NODES = 15  # of the quadrature
LARGEST_LOG_SD = 4.0  # of people, 55 in log odds: beyond, who answers how is certain


class NoFit(ValueError):
    """A model that these answers cannot have; says why."""


@dataclass(frozen=True)
class MixedFit:
    """Coefficients of the predictors (log odds of a higher answer) with standard errors, thresholds between the levels,
    the first one's standard error, standard deviation of people's intercepts, log-likelihood."""

    names: Sequence[str]
    coefficients: Array
    errors: Array
    thresholds: Array
    first_error: float
    person_sd: float
    log_likelihood: float

    def interval(self, k: int) -> tuple[float, float]:
        """Wald's 95 % interval of a coefficient."""
        half = float(stats.norm.ppf(0.975)) * float(self.errors[k])
        return float(self.coefficients[k]) - half, float(self.coefficients[k]) + half


@dataclass(frozen=True)
class RatioTest:
    """Likelihood-ratio test of two nested models."""

    statistic: float
    df: int
    p: float


def cumulative_logit(
    answers: ArrayLike, predictors: ArrayLike, people: ArrayLike, names: Sequence[str], *, nodes: int = NODES
) -> MixedFit:
    """The cumulative-link mixed model logit P(y <= j) = threshold_j - x beta - person (Agresti 2013, chapter 8; what
    R's `ordinal::clmm` fits).

    answers (n,): levels in any numbers, ordered; two levels make it a logistic model. predictors (n, m): m may be 0.
    people (n,): whose answer it is. Raises NoFit for a single level, predictors that say the same, or where the
    maximum is not found.
    """
    from statsmodels.tools.numdiff import approx_hess  # 0.3 s: most reports fit no model

    levels, y = np.unique(np.asarray(answers), return_inverse=True)
    x = np.asarray(predictors, dtype=float).reshape(len(y), -1)
    _, who = np.unique(np.asarray(people), return_inverse=True)
    if len(levels) < 2:
        raise NoFit("everybody gave the same answer; there is nothing to model")
    cuts, m = len(levels) - 1, x.shape[1]
    if np.linalg.matrix_rank(np.column_stack([np.ones(len(y)), x])) <= m:
        raise NoFit("predictors say the same as each other, or the same of everybody: their parts cannot be told apart")
    points, weights = special.roots_hermite(nodes)

    def unpacked(theta: Array) -> tuple[Array, Array, float]:
        thresholds = np.concatenate([theta[:1], theta[0] + np.cumsum(np.exp(np.minimum(theta[1:cuts], 50.0)))])
        return thresholds, theta[cuts : cuts + m], math.exp(min(theta[-1], LARGEST_LOG_SD + 1))

    def log_chance(thresholds: Array, eta: Array) -> Array:
        """Log chance of each answer; eta (n, ...)."""
        edges = np.concatenate([[-np.inf], thresholds, [np.inf]])
        shape = (len(y),) + (1,) * (eta.ndim - 1)
        above = special.expit(edges[y + 1].reshape(shape) - eta)
        below = special.expit(edges[y].reshape(shape) - eta)
        return np.asarray(np.log(np.maximum(above - below, 1e-300)))

    count = int(who.max()) + 1
    centre, scale = np.zeros(count), np.ones(count)

    def adapt(theta: Array) -> None:
        """Put each person's nodes where their intercept's distribution lies, by Newton's steps."""
        thresholds, beta, sd = unpacked(theta)
        b = centre.copy()
        for _ in range(30):
            step = 1e-4
            at = [
                _by_person(log_chance(thresholds, x @ beta + sd * b[who] + sd * d), who, count)
                for d in (-step, 0, step)
            ]
            first = (at[2] - at[0]) / (2 * step) - b
            second = np.minimum((at[2] - 2 * at[1] + at[0]) / step**2 - 1, -0.5)
            move = np.clip(first / second, -2, 2)
            b = b - move
            if np.abs(move).max() < 1e-6:
                break
        centre[:], scale[:] = b, np.sqrt(-1 / second)

    def loss(theta: Array) -> float:
        thresholds, beta, sd = unpacked(theta)
        z = centre[:, None] + math.sqrt(2) * scale[:, None] * points
        own = _by_person(log_chance(thresholds, (x @ beta)[:, None] + sd * z[who]), who, count)
        exponents = (
            own
            - z**2 / 2
            - 0.5 * math.log(2 * math.pi)
            + points**2
            + np.log(weights * math.sqrt(2))
            + np.log(scale)[:, None]
        )
        return -float(special.logsumexp(exponents, axis=1).sum())

    shares = np.cumsum(np.bincount(y))[:-1] / len(y)
    first = special.logit(shares)
    theta = np.concatenate([first[:1], np.log(np.maximum(np.diff(first), 1e-3)), np.zeros(m), [0.0]])
    last = math.inf
    for _ in range(8):
        adapt(theta)
        fit = optimize.minimize(loss, theta, method="BFGS", options={"gtol": 1e-5})
        theta = fit.x
        theta[-1] = max(theta[-1], -6.0)
        if abs(last - fit.fun) < 1e-6:
            break
        last = fit.fun
    if not np.isfinite(fit.fun) or np.abs(theta[:-1]).max() > 30 or theta[-1] > LARGEST_LOG_SD:
        raise NoFit("the likelihood has no maximum: answers tell the conditions or the people apart without exception")
    thresholds, beta, sd = unpacked(theta)
    hessian = approx_hess(theta, loss, epsilon=np.full(len(theta), 1e-3))
    free = slice(0, len(theta) if sd > 0.01 else len(theta) - 1)  # at the edge of no differences between people
    try:
        errors = np.sqrt(np.maximum(np.diag(np.linalg.inv(hessian[free, free])), 0.0))
    except np.linalg.LinAlgError:
        raise NoFit("the standard errors cannot be computed: predictors say the same") from None
    return MixedFit(tuple(names), beta, errors[cuts : cuts + m], thresholds, float(errors[0]), sd, -float(fit.fun))


def chance_of_the_higher(fit: MixedFit) -> tuple[float, float, float]:
    """Of a model of two levels without predictors: chance of the higher one for the median person, 95 % interval."""
    middle = -float(fit.thresholds[0])
    half = float(stats.norm.ppf(0.975)) * fit.first_error
    low, at, high = (float(special.expit(value)) for value in (middle - half, middle, middle + half))
    return at, low, high


def ratio_test(larger: MixedFit, smaller: MixedFit) -> RatioTest:
    """Whether the predictors of the larger model that the smaller lacks matter (chi-square)."""
    statistic = max(0.0, 2 * (larger.log_likelihood - smaller.log_likelihood))
    df = len(larger.coefficients) - len(smaller.coefficients)
    return RatioTest(statistic, df, float(stats.chi2.sf(statistic, df)))


def _by_person(values: Array, who: NDArray[np.intp], count: int) -> Array:
    summed = np.zeros((count, *values.shape[1:]))
    np.add.at(summed, who, values)
    return summed
