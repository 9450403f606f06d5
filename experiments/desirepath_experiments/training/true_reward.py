"""A simulated person's own reward of every step, to be trained on: the yardstick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Never

import numpy as np

from desirepath.learning.measures.step_basis import seen_steps
from desirepath.learning.people.families.base import StepFamilyMember
from desirepath.learning.rewards.reward_model import Floats, Reduction, RewardModel
from desirepath.simulation.setups import get_setup


@dataclass(frozen=True)
class TrueReward(RewardModel):
    """A simulated person's own reward of every step; stored nowhere."""

    kind: ClassVar[str] = "true"

    setup: str
    person: StepFamilyMember
    reduction: Reduction = "mean"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        steps = seen_steps(get_setup(self.setup), observations, actions, next_observations)
        return self.person.step_scores(steps).astype(np.float32)

    def to_arrays(self) -> Never:
        raise NotImplementedError("a simulated person is not stored")

    @classmethod
    def from_arrays(cls, meta: object, arrays: object) -> Never:
        raise NotImplementedError("a simulated person is not stored")
