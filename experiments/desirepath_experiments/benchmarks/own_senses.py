"""A choice per scene by what a robot would know there (`learning/policies/deciding.py`): its lidar, its goal, where the
person is; again every second. Beside it the same choice by somebody's true score, and training on that score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time
from typing import ClassVar, Never

import numpy as np

from desirepath.learning.alignment.own_reward import UPDATES_A_SECOND, OwnRewardConfig, tune_to_reward
from desirepath.learning.measures.step_basis import Doubles, seen_steps
from desirepath.learning.people.families.base import FamilyMember, StepFamilyMember
from desirepath.learning.policies.choosing import ChoosingPolicy
from desirepath.learning.policies.deciding import Chooser, DecidesAgain, Gains
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.reward_model import Floats, Reduction, RewardModel
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class Driven:
    """trajectories: scene by scene; told: what else is worth a row."""

    trajectories: list[Trajectory]
    told: dict[str, float]


def drive_by_senses(policy: ChoosingPolicy, scenes: Sequence[Scene], gains: Gains | None = None) -> Driven:
    """gains: by what the choice is made; default: the policy's answers."""
    drives = DecidesAgain(Chooser(policy.setup, policy.side_by_side, gains or policy.gains))
    began = process_time()
    trajectories = rollout(get_setup(policy.setup), drives, scenes)
    switches = [int(np.count_nonzero(np.diff(choices))) for choices in drives.choices]
    decisions = sum(map(len, drives.choices))
    told = {
        "switches": float(np.mean(switches)),
        "jerk": jerk(trajectories),
        "decision_ms": round(1_000 * (process_time() - began) / decisions, 1),
    }
    return Driven(trajectories, told)


def jerk(trajectories: Sequence[Trajectory]) -> float:
    """Mean change of the action from step to step, both of its numbers together."""
    return float(np.mean([np.abs(np.diff(one.actions, axis=0)).sum(1).mean() for one in trajectories]))


def by_true_score(person: FamilyMember) -> Gains:
    """Whoever chooses knows the person's own score of every way."""

    def gains(usual: Trajectory, others: Sequence[Trajectory]) -> Doubles:
        scores = person.scores([usual, *others])
        gained: Doubles = scores[1:] - scores[0]
        return gained

    return gains


def train_on_true_score(person: FamilyMember, base: Policy, seconds: float, seed: int) -> Policy | None:
    """The base policy, trained for so many seconds of one core on what this person thinks of every step; None for
    whoever judges no steps."""
    if not isinstance(person, StepFamilyMember):
        return None
    config = OwnRewardConfig.of(round(seconds * UPDATES_A_SECOND), seed)
    return tune_to_reward(base, TrueReward(base.setup, person), config).policy


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
