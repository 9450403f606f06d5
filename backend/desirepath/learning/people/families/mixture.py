"""Family `mixture`: one of the nine objectives at a stated share, a random network for the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.learning.measures.remembered import remember_last
from desirepath.learning.people.families.base import Doubles, Family, FamilyMember, Span
from desirepath.learning.people.families.network import NetworkFamily
from desirepath.learning.preferences.measures import measures, typical_differences
from desirepath.learning.preferences.objectives import NAMES, gains
from desirepath.simulation.trajectory import Trajectory

measures_once = remember_last(measures)


@dataclass(frozen=True)
class ObjectiveMember(FamilyMember):
    """One of the nine alone."""

    objective: str

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        scaled = measures_once(trajectories) / typical_differences(trajectories[0].scene.setup)
        return gains(scaled)[:, NAMES.index(self.objective)]


@dataclass(frozen=True)
class MixedMember(FamilyMember):
    """parts: members with what each weighs, on their own scales."""

    parts: tuple[tuple[FamilyMember, float], ...]

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        total: Doubles = np.sum([weight * member.scores(trajectories) for member, weight in self.parts], axis=0)
        return total


def mix_members(setup: str, *parts: tuple[FamilyMember, float]) -> MixedMember:
    """Members by shares: how much a typical pair of each weighs."""
    return MixedMember(tuple((member, share / member.unit(setup)) for member, share in parts))


class MixtureFamily(Family):
    """share: of the objective, from-to. network: what the rest is drawn from, the card's family of that name."""

    share: Span
    network: NetworkFamily

    def draw(self, setup: str, random: np.random.Generator) -> MixedMember:
        objective = ObjectiveMember(NAMES[int(random.integers(len(NAMES)))])
        share = float(random.uniform(*self.share))
        return mix_members(setup, (objective, share), (self.network.draw(setup, random), 1 - share))
