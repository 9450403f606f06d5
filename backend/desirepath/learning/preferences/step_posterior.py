"""What answers say about the weights of a step basis: which reward, of all that the basis can say, somebody goes by.

A Gaussian prior N(0, strength) of every weight, or of what earlier people weigh, a logistic likelihood, Laplace's
approximation, at several strengths weighed by their evidence (Bishop 2006, 4.4-4.5). Pure and deterministic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.preferences.advantage_process import AdvantageProcess, Seen, entropy_bits

STRENGTHS = (8.0, 32.0, 128.0, 512.0)
"""Variance of a typical pair's advantage, in log odds."""


@dataclass(frozen=True)
class StepPosterior:
    """After some answers. differences (n, K): first minus second of each pair's trajectory means, in lengths of a
    typical pair; chosen (n,): whether the first was. before: mean (K,) and factor (K, K) of what earlier people weigh
    (`population_prior.fit_people`), if that may be known."""

    differences: Doubles
    chosen: NDArray[np.bool_]
    before: tuple[Doubles, Doubles] | None = None

    @classmethod
    def from_answers(
        cls,
        differences: Doubles,
        chosen: Sequence[bool] | NDArray[np.bool_],
        before: tuple[Doubles, Doubles] | None = None,
    ) -> StepPosterior:
        """Raises LearningError if the numbers of both do not agree."""
        if len(differences) != len(chosen):
            raise LearningError(f"choices = {len(chosen)}: {len(differences)} pairs need as many")
        return cls(np.asarray(differences, dtype=np.float64), np.asarray(chosen, dtype=np.bool_), before)

    @cached_property
    def mean(self) -> Doubles:
        """(K,) posterior mean of the weights."""
        mean: Doubles = np.sum([mass * self._weights(process) for mass, process in self._weighed], axis=0)
        return mean

    def predict(self, differences: Doubles) -> Doubles:
        """(n,) probability that the first of each pair is chosen."""
        pairs = self._pairs(differences)
        probable: Doubles = np.sum([mass * process.predict(pairs) for mass, process in self._weighed], axis=0)
        return probable

    def advantages(self, differences: Doubles) -> tuple[Doubles, Doubles]:
        """(n,) how much better the first of each pair is expected to be, in log odds, and its standard deviation."""
        pairs, masses = self._pairs(differences), np.array([mass for mass, _ in self._weighed])
        means, variances = map(np.array, zip(*(of.advantages(pairs) for _, of in self._weighed), strict=True))
        expected: Doubles = masses @ means
        return expected, np.sqrt(masses @ (variances + np.square(means - expected)))

    def probability_better(self, differences: Doubles) -> float:
        """That the first of these pairs are on average preferred to the second; that scenes are a sample is counted."""
        if not len(differences):
            return 0.5
        probable = 0.0
        of_scenes = np.cov(differences.T) / len(differences) if len(differences) > 1 else 0.0
        for mass, process in self._weighed:
            mean, variance = (
                float(part[0]) for part in process.advantages(self._pairs(differences.mean(0, keepdims=True)))
            )
            if len(differences) > 1:
                weights = self._weights(process)
                variance += float(weights @ of_scenes @ weights)
            probable += mass * float(ndtr(mean / math.sqrt(variance + 1e-12)))
        return probable

    def information_bits(self, differences: Doubles) -> Doubles:
        """(n,) mutual information (bits) between the answer to each pair and the weights (Houlsby 2011)."""
        predicted, doubt = np.zeros(len(differences)), np.zeros(len(differences))
        for mass, process in self._weighed:
            probable, left = process.predict_and_doubt(self._pairs(differences))
            predicted += mass * probable
            doubt += mass * left
        return np.maximum(entropy_bits(predicted) - doubt, 0.0)

    @cached_property
    def _weighed(self) -> list[tuple[float, AdvantageProcess]]:
        signs = np.where(self.chosen, 1.0, -1.0)
        fits = [AdvantageProcess.after(strength, self._pairs(self.differences), signs) for strength in STRENGTHS]
        evidence = np.array([fit.log_evidence for fit in fits])
        masses = np.exp(evidence - evidence.max())
        return list(zip((masses / masses.sum()).tolist(), fits, strict=True))

    def _pairs(self, differences: Doubles) -> Seen:
        """Where nobody was before, nothing is expected of the weights."""
        if self.before is None:
            return np.zeros(len(differences)), differences
        mean, factor = self.before
        return differences @ mean, differences @ factor

    def _weights(self, process: AdvantageProcess) -> Doubles:
        """(K,) expected by one of the strengths."""
        if self.before is None:
            return process.weights()
        mean, factor = self.before
        weights: Doubles = math.sqrt(process.strength) * mean + factor @ process.weights()
        return weights
