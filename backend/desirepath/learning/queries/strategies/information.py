"""Where an answer tells most about the weights of the objectives.

Mutual information as in active preference learning. What an answer tells of the foremost objective counts twice: else
queries about shares, care and lapses come early, and it stays in doubt. Ours.
"""

from __future__ import annotations

import numpy as np

from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.queries.choosing import (
    PARTICLES,
    Candidates,
    Doubles,
    ObjectivesStrategy,
    entropy_bits,
    mutual_information,
)


class Information(ObjectivesStrategy):
    """I(answer; particle) + I(answer; foremost objective), bits."""

    def values(self, posterior: Posterior, candidates: Candidates[Doubles]) -> Doubles:
        few = posterior.sample(PARTICLES)
        predicted = few.choice_probabilities(candidates.differences)
        masses = np.full(PARTICLES, 1 / PARTICLES, dtype=np.float32)
        told: Doubles = mutual_information(predicted).astype(np.float64)
        about = entropy_bits(masses @ predicted)
        foremost = few.weights.argmax(axis=1)
        for objective in np.unique(foremost):
            of = foremost == objective
            share = max(float(masses[of].sum()), 1e-12)
            about -= share * entropy_bits(masses[of] @ predicted[of] / np.float32(share))
        return told + about


STRATEGY = Information()
