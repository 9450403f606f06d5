"""A policy that slows down beside the person: the hand-made candidate for a ceiling where slowness is preferred.

Training through the simulation goes back over few hundred steps and finds slow driving late; a rule finds it at once.
All ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backend.learning.policies.policy import Policy
from backend.simulation.acting import ActFunction, EpisodeActs, EpisodicPolicy, act_on, begin
from backend.simulation.setups import Setup, get_setup

Floats = NDArray[np.float32]
PERSON_DISTANCE = 2  # its column of the observation


@dataclass(frozen=True)
class SlowedPolicy(Policy):
    """Drives as the policy does, but within `near_m` of the person no faster than the share `most` of full speed."""

    near_m: float = 2.2
    most: float = 0.2

    @classmethod
    def of(cls, policy: Policy, near_m: float, most: float) -> SlowedPolicy:
        return cls(
            policy.setup, policy.shape, policy.actor, (), policy.recovery_policies, policy.made_for, near_m, most
        )

    @cached_property
    def rollout_policy(self) -> EpisodicPolicy:
        """What acts: the policy, its recovery too, with its speed limited."""
        usual = Policy(self.setup, self.shape, self.actor, (), self.recovery_policies).rollout_policy
        return _Limited(usual, get_setup(self.setup), self.near_m, self.most)


class _Limited(EpisodicPolicy):
    def __init__(self, usual: ActFunction | EpisodicPolicy, setup: Setup, near_m: float, most: float) -> None:
        self._usual, self._near, self._most = usual, near_m / setup.distance_scale_m, 2 * most - 1

    def act(self, observations: Floats) -> Floats:
        return self._limited(act_on(self._usual, observations), observations)

    def begin(self, episodes: int) -> EpisodeActs:
        steer = begin(self._usual, episodes)
        return lambda observations, running: self._limited(steer(observations, running), observations)

    def _limited(self, actions: Floats, observations: Floats) -> Floats:
        limited = actions.copy()
        near = observations[:, PERSON_DISTANCE] < self._near
        limited[near, 0] = np.minimum(limited[near, 0], np.float32(self._most))
        return limited
