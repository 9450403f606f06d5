"""Family `changing`: after some answers somebody else, who keeps something of the one before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.learning.people.families.base import Doubles, Family, FamilyMember
from desirepath.learning.people.families.mixture import mix_members
from desirepath.learning.people.families.network import NetworkFamily
from desirepath.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class ChangingMember(FamilyMember):
    """Scores are of who it is at first; `after` says who it has become."""

    at_first: FamilyMember
    then: FamilyMember
    change: int

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        return self.at_first.scores(trajectories)

    def after(self, answers: int) -> FamilyMember:
        return self.at_first if answers < self.change else self.then


class ChangingFamily(Family):
    """after: the number of answers, from-to. kept: share of the first that stays. network: as `MixtureFamily`."""

    after: tuple[int, int]
    kept: float
    network: NetworkFamily

    def draw(self, setup: str, random: np.random.Generator) -> ChangingMember:
        first, other = self.network.draw(setup, random), self.network.draw(setup, random)
        then = mix_members(setup, (first, self.kept), (other, 1 - self.kept))
        return ChangingMember(first, then, int(random.integers(self.after[0], self.after[1] + 1)))
