"""A Gaussian process over how much better the first of a pair is, after choices: Laplace's approximation (Rasmussen and
Williams 2006, algorithms 3.1 and 3.2). Which columns it sees, and what several of them say together, is
`free_posterior.py`'s."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtr

Doubles = NDArray[np.float64]
ITERATIONS = 40
HALVINGS = 12
Seen = tuple[Doubles, Doubles]
"""(n,) expected advantage of pairs and (n, columns) how it may differ, both at strength 1."""


@dataclass(frozen=True)
class AdvantageProcess:
    """After the answers. strength: prior variance of a typical pair's advantage in log odds. seen: of the pairs that
    were answered. gradient (n,): of the log likelihood at the mode; root (n,): of its curvature; triangle (n, n):
    Cholesky factor of 1 + root K root; log_evidence: log probability of the answers."""

    strength: float
    seen: Seen
    gradient: Doubles
    root: Doubles
    triangle: Doubles
    log_evidence: float

    @classmethod
    def after(cls, strength: float, seen: Seen, signs: Doubles) -> AdvantageProcess:
        """After answers: likelihood sigmoid(sign f), f of mean sqrt(strength) m and covariance strength x x'. Newton's
        steps are halved until they gain: whole ones overshoot where the prior is wide and the answers surprise."""
        n = len(signs)
        if not n:
            return cls(strength, seen, np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0)
        mean, kernel = math.sqrt(strength) * seen[0], strength * seen[1] @ seen[1].T
        gradient, f = np.zeros(n), mean
        worth = _log_likelihood(signs * f)
        for _ in range(ITERATIONS):
            slope, root, triangle = _at(signs, f, kernel)
            b = np.square(root) * (f - mean) + slope
            whole = b - root * np.linalg.solve(triangle.T, np.linalg.solve(triangle, root * (kernel @ b)))
            step = whole - gradient
            for _ in range(HALVINGS):
                tried = gradient + step
                product = kernel @ tried
                likelihood = float(-0.5 * (tried @ product)) + _log_likelihood(signs * (product + mean))
                if likelihood >= worth:
                    break
                step = step / 2
            else:
                break
            moved, gained = np.abs(product + mean - f).max(), likelihood - worth
            gradient, f, worth = tried, product + mean, likelihood
            if moved < 1e-5 or gained < 1e-9:
                break
        _, root, triangle = _at(signs, f, kernel)
        evidence = worth - np.log(np.diag(triangle)).sum()
        return cls(strength, seen, gradient, root, triangle, float(evidence))

    def advantages(self, pairs: Seen) -> tuple[Doubles, Doubles]:
        """Mean and variance (m,) of what pairs differ by, in log odds."""
        expected, features = math.sqrt(self.strength) * pairs[0], pairs[1]
        prior = self.strength * np.square(features).sum(1)
        if not len(self.gradient):
            return expected, prior
        across = self.strength * features @ self.seen[1].T
        spread = np.linalg.solve(self.triangle, self.root[:, None] * across.T)
        return expected + across @ self.gradient, np.maximum(prior - np.square(spread).sum(0), 1e-12)

    def predict(self, pairs: Seen, sharper: float = 1.0) -> Doubles:
        """(m,) probability that the first of each pair is chosen; sharper: factor on what is expected."""
        mean, variance = self.advantages(pairs)
        probable: Doubles = expit(sharper * mean / np.sqrt(1 + math.pi * variance / 8))
        return probable

    def predict_and_doubt(self, pairs: Seen) -> tuple[Doubles, Doubles]:
        """(m,) probability that the first of each pair is chosen, and bits of its answer's entropy that would be left
        if the weights were known (Houlsby 2011); a logistic curve as a normal one."""
        mean, variance = self.advantages(pairs)
        mean, variance = mean / 1.6, variance / 1.6**2
        flat = math.pi * math.log(2) / 2
        doubt: Doubles = np.exp(-np.square(mean) / (2 * (variance + flat))) * np.sqrt(flat / (variance + flat))
        return ndtr(mean / np.sqrt(1 + variance)), doubt

    def sampled(self, pairs: Seen, random: np.random.Generator, count: int) -> Doubles:
        """(m, count) what pairs differ by, drawn together from what is believed (Matheron's rule)."""
        scale = math.sqrt(self.strength)
        drawn = random.normal(0, scale, (pairs[1].shape[1], count))
        drawn_scores: Doubles = scale * pairs[0][:, None] + pairs[1] @ drawn
        if not len(self.gradient):
            return drawn_scores
        apart = self.root[:, None] * (self.seen[1] @ drawn) + random.normal(0, 1, (len(self.root), count))
        solved = self.root[:, None] * np.linalg.solve(self.triangle.T, np.linalg.solve(self.triangle, apart))
        return drawn_scores + self.strength * pairs[1] @ (self.seen[1].T @ (self.gradient[:, None] - solved))

    def weights(self) -> Doubles:
        """(columns,) posterior mean of what each column weighs, beyond the prior's mean."""
        return self.strength * self.seen[1].T @ self.gradient


def entropy_bits(probabilities: Doubles) -> Doubles:
    """Of answers with these probabilities."""
    sure = np.clip(probabilities, 1e-9, 1 - 1e-9)
    return -(sure * np.log2(sure) + (1 - sure) * np.log2(1 - sure))


def _log_likelihood(margins: Doubles) -> float:
    return float(-np.logaddexp(0.0, -margins).sum())


def _at(signs: Doubles, f: Doubles, kernel: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """Gradient of the log likelihood, root of its curvature, and the Cholesky factor, at f."""
    likely = expit(signs * f)
    root = np.sqrt(np.maximum(likely * (1 - likely), 1e-9))
    return signs * (1 - likely), root, np.linalg.cholesky(np.eye(len(f)) + root[:, None] * kernel * root)
