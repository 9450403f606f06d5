"""At random, whatever was answered."""

from __future__ import annotations

import numpy as np

from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.queries.choosing import Candidates, Doubles, NextQuery, ObjectivesStrategy


class Random(ObjectivesStrategy):
    """All that are left are as likely."""

    def ask_next(self, posterior: Posterior, candidates: Candidates[Doubles], random: np.random.Generator) -> NextQuery:
        left = candidates.differences
        index = int(random.choice(len(left), 1, replace=False)[0])
        return NextQuery(index, float(self.bits(posterior, left[index : index + 1])[0]))


STRATEGY = Random()
