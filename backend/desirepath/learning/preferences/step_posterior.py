"""What answers say about the weights of a step basis: which reward, of all that the basis can say, somebody goes by.

A Gaussian prior N(0, strength) of every weight, a logistic likelihood, Laplace's approximation, at several strengths
weighed by their evidence (Bishop 2006, 4.4-4.5). Pure and deterministic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtr

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.step_basis import Doubles

STRENGTHS = (8.0, 32.0, 128.0, 512.0)
"""Variance of a typical pair's advantage, in log odds."""
ITERATIONS = 40


@dataclass(frozen=True)
class _Fit:
    mean: Doubles
    covariance: Doubles
    log_evidence: float


@dataclass(frozen=True)
class StepPosterior:
    """After some answers. differences (n, K): first minus second of each pair's trajectory means, in lengths of a
    typical pair; chosen (n,): whether the first was."""

    differences: Doubles
    chosen: NDArray[np.bool_]

    @classmethod
    def from_answers(cls, differences: Doubles, chosen: Sequence[bool] | NDArray[np.bool_]) -> StepPosterior:
        """Raises LearningError if the numbers of both do not agree."""
        if len(differences) != len(chosen):
            raise LearningError(f"choices = {len(chosen)}: {len(differences)} pairs need as many")
        return cls(np.asarray(differences, dtype=np.float64), np.asarray(chosen, dtype=np.bool_))

    @cached_property
    def mean(self) -> Doubles:
        """(K,) posterior mean of the weights."""
        found: Doubles = np.sum([mass * fit.mean for mass, fit in self._weighed], axis=0)
        return found

    def predict(self, differences: Doubles) -> Doubles:
        """(n,) probability that the first of each pair is chosen."""
        found: Doubles = np.sum(
            [
                mass * expit(mean / np.sqrt(1 + math.pi * variance / 8))
                for mass, mean, variance in self._of(differences)
            ],
            axis=0,
        )
        return found

    def advantages(self, differences: Doubles) -> tuple[Doubles, Doubles]:
        """(n,) how much better the first of each pair is expected to be, in log odds, and its standard deviation."""
        masses, means, variances = (np.array(part) for part in zip(*self._of(differences), strict=True))
        expected: Doubles = masses @ means
        return expected, np.sqrt(masses @ (variances + np.square(means - expected)))

    def probability_better(self, differences: Doubles) -> float:
        """That the first of these pairs are on average preferred to the second; that scenes are a sample is counted."""
        if not len(differences):
            return 0.5
        found = 0.0
        of_scenes = np.cov(differences.T) / len(differences) if len(differences) > 1 else 0.0
        for mass, fit in self._weighed:
            average = differences.mean(0)
            variance = average @ fit.covariance @ average
            if len(differences) > 1:
                variance += fit.mean @ of_scenes @ fit.mean
            found += mass * float(ndtr(average @ fit.mean / math.sqrt(variance + 1e-12)))
        return found

    def information_bits(self, differences: Doubles) -> Doubles:
        """(n,) mutual information (bits) between the answer to each pair and the weights (Houlsby 2011)."""
        flat = math.pi * math.log(2) / 2
        predicted, certain = np.zeros(len(differences)), np.zeros(len(differences))
        for mass, mean, variance in self._of(differences):
            mean, variance = mean / 1.6, variance / 1.6**2  # a logistic curve as a normal one
            predicted += mass * ndtr(mean / np.sqrt(1 + variance))
            certain += mass * np.sqrt(flat / (variance + flat)) * np.exp(-np.square(mean) / (2 * (variance + flat)))
        sure = np.clip(predicted, 1e-9, 1 - 1e-9)
        entropy = -(sure * np.log2(sure) + (1 - sure) * np.log2(1 - sure))
        found: Doubles = np.maximum(entropy - certain, 0.0)
        return found

    def _of(self, differences: Doubles) -> list[tuple[float, Doubles, Doubles]]:
        return [
            (mass, differences @ fit.mean, np.einsum("ij,jk,ik->i", differences, fit.covariance, differences))
            for mass, fit in self._weighed
        ]

    @cached_property
    def _weighed(self) -> list[tuple[float, _Fit]]:
        signs = np.where(self.chosen, 1.0, -1.0)
        fits = [_fitted(self.differences, signs, strength) for strength in STRENGTHS]
        evidence = np.array([fit.log_evidence for fit in fits])
        masses = np.exp(evidence - evidence.max())
        return list(zip((masses / masses.sum()).tolist(), fits, strict=True))


def _fitted(differences: Doubles, signs: Doubles, strength: float) -> _Fit:
    size = differences.shape[1]
    prior = np.eye(size) / strength
    weights = np.zeros(size)
    for _ in range(ITERATIONS):
        likely = expit(signs * (differences @ weights))
        gradient = differences.T @ (signs * (1 - likely)) - weights / strength
        step = np.linalg.solve((differences.T * (likely * (1 - likely))) @ differences + prior, gradient)
        weights = weights + step
        if np.abs(step).max() < 1e-6:
            break
    likely = expit(signs * (differences @ weights))
    curvature = (differences.T * (likely * (1 - likely))) @ differences + prior
    log_evidence = (
        float(np.log(np.maximum(likely, 1e-300)).sum())
        - float(weights @ weights) / strength / 2
        - 0.5 * float(np.linalg.slogdet(curvature * strength)[1])
    )
    return _Fit(weights, np.linalg.inv(curvature), log_evidence)
