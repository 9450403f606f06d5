"""How sure it is that a policy is better for somebody. Pure.

In which scenes it is judged is `alignment/never_worse.py`'s, what is sure enough `alignment/gate.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.free_posterior import FreePosterior

LEAST_GAIN = 0.05
"""Clearly better is better by at least this, in what a typical pair of trajectories differs by for this person."""


@dataclass(frozen=True)
class Sureness:
    """Of a policy's rollouts against the usual ones. better: probability that they are on average preferred; clearly:
    that they are by LEAST_GAIN."""

    better: float
    clearly: float

    @classmethod
    def of(cls, posterior: FreePosterior, differences: PairDifferences | None) -> Sureness:
        """None: the same trajectories, which are not better than themselves."""
        if differences is None:
            return cls(0.5, 0.0)
        return cls(posterior.probability_better(differences), posterior.probability_better(differences, by=LEAST_GAIN))
