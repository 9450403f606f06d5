"""Family `last_third`: who judges a drive by its last third alone. Nothing is tuned on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.families.base import Doubles, Family, FamilyMember, StepFamilyMember
from desirepath.learning.people.families.network import NetworkFamily
from desirepath.simulation.trajectory import Trajectory

FROM = 2 / 3  # of its time


@dataclass(frozen=True)
class LastThirdMember(FamilyMember):
    """whole: who values every step, of which only the last ones are looked at."""

    whole: StepFamilyMember

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        steps = SeenSteps.of_trajectories(trajectories)
        late = steps.place >= FROM
        late |= np.append(np.diff(steps.of) > 0, True)  # a single step is the last one, too
        values = self.whole.step_scores(steps)[late]
        scores: Doubles = np.bincount(steps.of[late], values) / np.bincount(steps.of[late])
        return scores


class LastThirdFamily(Family):
    """network: who looks, the card's family of that name."""

    network: NetworkFamily

    def draw(self, setup: str, random: np.random.Generator) -> LastThirdMember:
        return LastThirdMember(self.network.draw(setup, random))
