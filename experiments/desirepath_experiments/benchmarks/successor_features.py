"""Successor features over a policy library, the other way to have a policy for any reward at once: at every step the
one drives of which most is expected from here on (generalised policy improvement, Barreto 2017).

A candidate that `benchmark people-policies --successor-features` measures beside the library; nothing of it is shipped.
psi_k(s): mean of the step basis over what policy k still does from s on, discounted, fitted by ridge regression on
random features of the observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.step_basis import StepBasis
from desirepath.learning.policies.policy import Policy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.acting import RecoveringPolicy
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
SCENES_SEED = 7_800  # of no other
HIDDEN = 256
RIDGE = 1.0


@dataclass(frozen=True)
class SuccessorFeatures:
    """Of n policies. weights (observation + 1, HIDDEN): of the random features; psi (n, HIDDEN + 1, K)."""

    policies: tuple[Policy, ...]
    base: Policy
    weights: Floats
    psi: Floats

    @classmethod
    def fitted(
        cls, policies: Sequence[Policy], base: Policy, basis: StepBasis, *, scenes: int = 150, gamma: float = 0.95
    ) -> SuccessorFeatures:
        """Every policy rolls out in the same scenes."""
        setup = get_setup(base.setup)
        drawn = scene_set(base.setup, scenes, purpose=Purpose.ALIGN_SELECT, seed=SCENES_SEED)
        random = np.random.default_rng(SCENES_SEED)
        spread = 2 / np.sqrt(setup.observation_size)
        weights = random.normal(0, spread, (setup.observation_size + 1, HIDDEN)).astype(np.float32)
        found = []
        for policy in policies:
            trajectories = list(rollout(setup, policy.rollout_policy, drawn))
            hidden = _features(np.concatenate([one.observations for one in trajectories]), weights)
            wanted = np.concatenate([_ahead(one, basis, gamma) for one in trajectories])
            square = hidden.T @ hidden + RIDGE * np.eye(hidden.shape[1], dtype=np.float32)
            found.append(np.linalg.solve(square.astype(np.float64), (hidden.T @ wanted).astype(np.float64)))
        return cls(tuple(policies), base, weights, np.stack(found).astype(np.float32))

    def at(self, reward: Doubles) -> RecoveringPolicy:
        """What drives by a reward of the step basis (K,), freed by the base policy where it is stuck."""
        values = np.stack([psi @ reward.astype(np.float32) for psi in self.psi], axis=1)  # (HIDDEN + 1, n)

        def act(observations: Floats) -> Floats:
            chosen = (_features(observations, self.weights) @ values).argmax(axis=1)
            actions = np.zeros((len(observations), 2), dtype=np.float32)
            for k in np.unique(chosen):
                actions[chosen == k] = self.policies[k].act(observations[chosen == k])
            return actions

        return RecoveringPolicy(get_setup(self.base.setup), act, [self.base.act])


def _features(observations: Floats, weights: Floats) -> Floats:
    one = np.ones((len(observations), 1), dtype=np.float32)
    hidden = np.maximum(np.concatenate([observations, one], axis=1) @ weights, 0)
    return np.concatenate([hidden, one], axis=1)


def _ahead(trajectory: Trajectory, basis: StepBasis, gamma: float) -> Floats:
    """(T, K) discounted mean of the basis from each step on."""
    steps = basis.of_steps(trajectory.observations, trajectory.actions, trajectory.next_observations)
    found, total, weight = np.zeros_like(steps), np.zeros(steps.shape[1], dtype=np.float32), 0.0
    for t in range(len(steps) - 1, -1, -1):
        total, weight = steps[t] + np.float32(gamma) * total, 1 + gamma * weight
        found[t] = total / np.float32(weight)
    return found
