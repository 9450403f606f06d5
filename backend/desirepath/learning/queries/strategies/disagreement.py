"""Where the particles of the posterior disagree most."""

from __future__ import annotations

import numpy as np

from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.queries.choosing import PARTICLES, Candidates, Doubles, ObjectivesStrategy


class Disagreement(ObjectivesStrategy):
    """Values a query by the variance of the particles' predictions."""

    def values(self, posterior: Posterior, candidates: Candidates[Doubles]) -> Doubles:
        predicted = posterior.sample(PARTICLES).choice_probabilities(candidates.differences)
        variance: Doubles = predicted.var(axis=0, dtype=np.float64)
        return variance


STRATEGY = Disagreement()
