"""Where an answer tells most about the answers to the set's other queries, whatever they may be about: the nine
objectives, named measures or an embedding of what the robot sees and does. Ours."""

from __future__ import annotations

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.queries.choosing import BeyondStrategy, Candidates, Doubles


class InformationBeyond(BeyondStrategy):
    """Values a query by the bits that its answer is expected to tell about another's."""

    def values(self, posterior: FreePosterior, candidates: Candidates[PairDifferences]) -> Doubles:
        return posterior.bits_about(candidates.differences, candidates.all.thinned())


STRATEGY = InformationBeyond()
