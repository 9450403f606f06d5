"""A Gaussian process over how much better the first of a pair is, after choices: Laplace's approximation (Rasmussen and
Williams 2006, algorithms 3.1 and 3.2). Which columns it sees, and what several of them say together, is
`free_posterior.py`'s."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

Doubles = NDArray[np.float64]
ITERATIONS = 40
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
        """After answers: likelihood sigmoid(sign f), f of mean sqrt(strength) m and covariance strength x x'."""
        n = len(signs)
        if not n:
            return cls(strength, seen, np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0)
        mean, kernel = math.sqrt(strength) * seen[0], strength * seen[1] @ seen[1].T
        f = mean.copy()
        for _ in range(ITERATIONS):
            likely = expit(signs * f)
            gradient, curvature = signs * (1 - likely), np.maximum(likely * (1 - likely), 1e-9)
            root = np.sqrt(curvature)
            triangle = np.linalg.cholesky(np.eye(n) + root[:, None] * kernel * root)
            b = curvature * (f - mean) + gradient
            a = b - root * np.linalg.solve(triangle.T, np.linalg.solve(triangle, root * (kernel @ b)))
            before, f = f, kernel @ a + mean
            if np.abs(f - before).max() < 1e-5:
                break
        likely = expit(signs * f)
        evidence = -0.5 * a @ (f - mean) + np.log(np.maximum(likely, 1e-300)).sum() - np.log(np.diag(triangle)).sum()
        return cls(strength, seen, signs * (1 - likely), root, triangle, float(evidence))

    def advantages(self, pairs: Seen) -> tuple[Doubles, Doubles]:
        """Mean and variance (m,) of what pairs differ by, in log odds."""
        expected, features = math.sqrt(self.strength) * pairs[0], pairs[1]
        prior = self.strength * np.square(features).sum(1)
        if not len(self.gradient):
            return expected, prior
        across = self.strength * features @ self.seen[1].T
        spread = np.linalg.solve(self.triangle, self.root[:, None] * across.T)
        return expected + across @ self.gradient, np.maximum(prior - np.square(spread).sum(0), 1e-12)

    def weights(self) -> Doubles:
        """(columns,) posterior mean of what each column weighs, beyond the prior's mean."""
        found: Doubles = self.strength * self.seen[1].T @ self.gradient
        return found
