"""How sure it must be that a policy is better for somebody before it is shown as theirs. Pure.

In which scenes it is judged is `alignment/never_worse.py`'s. What is clear is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.free_posterior import FreePosterior

SURE = 0.9
"""Issue 15: shown as personal only where it is better for this person with at least this probability."""
LEAST_GAIN, CLEARLY = 0.05, 0.85
"""Better by at least this, in what a typical pair of trajectories differs by for this person, with this probability.
Who was harmed before, was harmed by what is surely better by next to nothing. Chosen on tuning families."""


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

    def enough(self, needed: float = SURE) -> bool:
        """Whether it is shown. needed: of `better`; where that is at most one half nothing is asked, and the usual
        policy itself will do."""
        return self.better >= needed and (self.clearly >= CLEARLY or needed <= 0.5)
