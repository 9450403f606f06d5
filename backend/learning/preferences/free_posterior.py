"""What answers say where the nine objectives may not say it: a mixture of three ways to explain them, weighed by how
well each foretold every answer before it was given.

The ways: the particle posterior over the nine (`posterior.py`), and two Gaussian processes, over the named measures and
over the embedding of trajectories (`backend/learning/measures`), each at several strengths of preference. Pure and
deterministic. All ours; the approximation is Laplace's (Rasmussen and Williams 2006, algorithms 3.1 and 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp, ndtr

from backend.learning.errors import LearningError
from backend.learning.measures.named import NAMES as NAMED
from backend.learning.measures.pairs import PairDifferences
from backend.learning.preferences.measures import typical_differences
from backend.learning.preferences.objectives import gains
from backend.learning.preferences.posterior import Posterior, PosteriorConfig

Doubles = NDArray[np.float64]
Basis = Literal["nine", "named", "embedding"]
GAUSSIAN: tuple[Basis, ...] = ("named", "embedding")
ITERATIONS = 40
PREDICTING = 2_000  # of the particles: what predicting needs not have more of


@dataclass(frozen=True)
class FreeConfig:
    """nine: prior probability that the objectives say it. strengths: variances of a typical pair's advantage in log
    odds, with their prior probabilities. Chosen on the tuning families of `people/card.yaml`."""

    nine: float = 0.5
    strengths: tuple[float, ...] = (2.0, 8.0, 32.0, 128.0, 512.0)
    prior: tuple[float, ...] = (0.05, 0.15, 0.3, 0.3, 0.2)
    posterior: PosteriorConfig = PosteriorConfig()  # noqa: RUF009, frozen


@dataclass(frozen=True)
class _Fit:
    """One Gaussian process after the answers. gradient (n,): of the log likelihood at the mode; root (n,): of its
    curvature; triangle (n, n): Cholesky factor of 1 + root K root; log_evidence: log probability of the answers."""

    way: Basis
    strength: float
    seen: Doubles
    gradient: Doubles
    root: Doubles
    triangle: Doubles
    log_evidence: float

    def advantages(self, features: Doubles) -> tuple[Doubles, Doubles]:
        """Mean and variance (m,) of what pairs (m, columns) differ by, in log odds."""
        if not len(self.gradient):
            return np.zeros(len(features)), self.strength * np.square(features).sum(1)
        across = self.strength * features @ self.seen.T
        spread = np.linalg.solve(self.triangle, self.root[:, None] * across.T)
        prior = self.strength * np.square(features).sum(1)
        return across @ self.gradient, np.maximum(prior - np.square(spread).sum(0), 1e-12)

    def weights(self) -> Doubles:
        """(columns,) posterior mean of what each column weighs."""
        found: Doubles = self.strength * self.seen.T @ self.gradient
        return found


@dataclass(frozen=True)
class FreePosterior:
    """What is believed after some answers. objectives: the posterior over the nine. nine_log_evidence: log probability
    of the answers by it. differences, chosen: what was learned from, whether A was chosen."""

    setup: str
    config: FreeConfig
    objectives: Posterior
    nine_log_evidence: float
    differences: PairDifferences | None
    chosen: NDArray[np.bool_]

    @classmethod
    def prior(cls, setup: str, config: FreeConfig | None = None) -> FreePosterior:
        """What is believed before any answer."""
        config = config or FreeConfig()
        return cls(setup, config, Posterior.prior(setup, config.posterior), 0.0, None, np.zeros(0, dtype=np.bool_))

    @classmethod
    def from_answers(
        cls, differences: PairDifferences, chosen: Sequence[bool] | NDArray[np.bool_], config: FreeConfig | None = None
    ) -> FreePosterior:
        """After answers to these pairs; chosen: was the first of the two chosen? Raises LearningError if the numbers of
        both do not agree."""
        if len(differences) != len(chosen):
            raise LearningError(f"choices = {len(chosen)}: {len(differences)} pairs need as many")
        posterior = cls.prior(differences.setup, config)
        for k, choice in enumerate(chosen):
            posterior = posterior.updated(differences[[k]], bool(choice))
        return posterior

    def updated(self, difference: PairDifferences, a_chosen: bool) -> FreePosterior:
        """After one more answer, to one pair."""
        probability = float(self.objectives.predict(difference.seen)[0])
        return FreePosterior(
            self.setup,
            self.config,
            self.objectives.updated(difference.seen[0], a_chosen),
            self.nine_log_evidence + math.log(probability if a_chosen else 1 - probability),
            difference if self.differences is None else self.differences.joined(difference),
            np.append(self.chosen, a_chosen),
        )

    def predict(self, differences: PairDifferences) -> Doubles:
        """(n,) probability that the first of each pair is chosen."""
        masses, predicted = self._masses, [self._few.predict(differences.seen)]
        for fit in self._fits:
            mean, variance = fit.advantages(_columns(differences, fit.way))
            predicted.append(expit(mean / np.sqrt(1 + math.pi * variance / 8)))
        found: Doubles = masses @ np.stack(predicted)
        return found

    def probability_better(self, differences: PairDifferences) -> float:
        """That the first of these pairs are on average preferred to the second: one policy's rollouts against
        another's in the same scenes. That these scenes are a sample is counted in."""
        if not len(differences):
            return 0.5
        few = self._few
        sure = _probability_positive(
            few.weights @ gains(differences.seen[:, 0] / typical_differences(self.setup)).T.astype(np.float32)
        )
        probable = [float(sure)]
        for fit in self._fits:
            features = _columns(differences, fit.way)
            mean, variance = (float(part[0]) for part in fit.advantages(features.mean(0, keepdims=True)))
            of_scenes = float((features @ fit.weights()).var()) / len(features) if len(self.chosen) else 0.0
            probable.append(float(ndtr(mean / math.sqrt(variance + of_scenes + 1e-12))))
        return float(self._masses @ np.array(probable))

    def each_better(self, differences: PairDifferences) -> Doubles:
        """(n,) probability that the first of each pair is the one preferred, whatever would be answered."""
        advantages = self._few.weights @ gains(differences.seen[:, 0] / typical_differences(self.setup)).T.astype(
            np.float32
        )
        probable = [(advantages > 0).mean(0) + 0.5 * (advantages == 0).mean(0)]
        for fit in self._fits:
            mean, variance = fit.advantages(_columns(differences, fit.way))
            probable.append(ndtr(mean / np.sqrt(variance)))
        found: Doubles = self._masses @ np.stack(probable)
        return found

    def information_bits(self, differences: PairDifferences) -> Doubles:
        """(n,) mutual information (bits) between the answer to each pair and what is not known yet (Houlsby 2011)."""
        few = self._few
        probabilities = [few.choice_probabilities(differences.seen).astype(np.float64)]
        predicted, certain = [probabilities[0].mean(0)], [_entropy(probabilities[0]).mean(0)]
        for fit in self._fits:
            mean, variance = fit.advantages(_columns(differences, fit.way))
            mean, variance = mean / 1.6, variance / 1.6**2  # a logistic curve as a normal one
            predicted.append(ndtr(mean / np.sqrt(1 + variance)))
            flat = math.pi * math.log(2) / 2
            certain.append(np.exp(-np.square(mean) / (2 * (variance + flat))) * np.sqrt(flat / (variance + flat)))
        found: Doubles = _entropy(self._masses @ np.stack(predicted)) - self._masses @ np.stack(certain)
        return np.maximum(found, 0.0)

    def ways(self) -> dict[str, float]:
        """Probability of each way to explain the answers; sums to 1."""
        shares = {"nine": float(self._masses[0])}
        for fit, mass in zip(self._fits, self._masses[1:], strict=True):
            shares[fit.way] = shares.get(fit.way, 0.0) + float(mass)
        return shares

    def something_else(self) -> float:
        """Probability that what the answers are about is not among the nine."""
        return 1.0 - float(self._masses[0])

    def named_weights(self) -> dict[str, float]:
        """By named measure, how much more (above 0) or less of it is preferred: the posterior mean in standard
        deviations of a typical pair, the largest 1 or -1; empty before any answer."""
        fits = [(fit, mass) for fit, mass in zip(self._fits, self._masses[1:], strict=True) if fit.way == "named"]
        if self.differences is None or not fits:
            return {}
        together = np.sum([mass * fit.weights() / math.sqrt(fit.strength) for fit, mass in fits], axis=0)
        largest = float(np.abs(together).max()) or 1.0
        return {name: float(weight) / largest for name, weight in zip(NAMED, together, strict=True)}

    @cached_property
    def _few(self) -> Posterior:
        return self.objectives.sample(PREDICTING)

    @cached_property
    def _fits(self) -> list[_Fit]:
        signs = np.where(self.chosen, 1.0, -1.0)
        return [
            _fitted(way, strength, self._seen(way), signs) for way in GAUSSIAN for strength in self.config.strengths
        ]

    def _seen(self, way: Basis) -> Doubles:
        if self.differences is None:
            return np.zeros((0, 1))
        return _columns(self.differences, way)

    @cached_property
    def _masses(self) -> Doubles:
        """(1 + fits,) probability of the nine, then of each Gaussian process."""
        prior = [math.log((1 - self.config.nine) / len(GAUSSIAN) * share) for share in self.config.prior]
        logs = np.array(
            [math.log(self.config.nine) + self.nine_log_evidence]
            + [fit.log_evidence + prior[k % len(prior)] for k, fit in enumerate(self._fits)]
        )
        masses: Doubles = np.exp(logs - logsumexp(logs))
        return masses


def _columns(differences: PairDifferences, way: Basis) -> Doubles:
    return differences.named if way == "named" else differences.embedding


def _entropy(probabilities: Doubles) -> Doubles:
    certain = np.clip(probabilities, 1e-9, 1 - 1e-9)
    found: Doubles = -(certain * np.log2(certain) + (1 - certain) * np.log2(1 - certain))
    return found


def _probability_positive(advantages: NDArray[np.float32]) -> float:
    """Mean over particles (rows) that their mean over scenes (columns) is above 0, the scenes being a sample."""
    means = advantages.mean(1, dtype=np.float64)
    errors = advantages.std(1, dtype=np.float64) / math.sqrt(advantages.shape[1]) + 1e-9
    return float(ndtr(means / errors).mean())


def _fitted(way: Basis, strength: float, seen: Doubles, signs: Doubles) -> _Fit:
    """Laplace's approximation of a Gaussian process with kernel strength x x', likelihood sigmoid(sign f)."""
    n = len(signs)
    if not n:
        return _Fit(way, strength, np.zeros((0, 1)), np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0)
    kernel = strength * seen @ seen.T
    f = np.zeros(n)
    for _ in range(ITERATIONS):
        likely = expit(signs * f)
        gradient, curvature = signs * (1 - likely), np.maximum(likely * (1 - likely), 1e-9)
        root = np.sqrt(curvature)
        triangle = np.linalg.cholesky(np.eye(n) + root[:, None] * kernel * root)
        b = curvature * f + gradient
        a = b - root * np.linalg.solve(triangle.T, np.linalg.solve(triangle, root * (kernel @ b)))
        before, f = f, kernel @ a
        if np.abs(f - before).max() < 1e-5:
            break
    likely = expit(signs * f)
    log_evidence = -0.5 * a @ f + np.log(np.maximum(likely, 1e-300)).sum() - np.log(np.diag(triangle)).sum()
    return _Fit(way, strength, seen, signs * (1 - likely), root, triangle, float(log_evidence))
