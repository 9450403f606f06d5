"""TD3+BC: what TD3 with demonstrations learns, whole: to be read beside sections 2.4 and 2.5 of the thesis.

Every update sees one batch of b = b_E + b_D transitions, the first half explored, the second demonstrated (2.4.2). The
critics i = 1, 2 and the actor pi go down

    L(theta_i) = 1/b sum_j (y_j - Q_i(s_j, a_j))^2                                                   (2.2)
           y_j = r_j + gamma min_i Q'_i(s'_j, pi'(s'_j) + clipped noise)                             (2.1)
        L(phi) = - lambda_RL / b sum_j Q_1(s_j, pi(s_j)) + lambda_BC L_BC                            (2.3, 2.5)
          L_BC = sum over the demonstrated i of ||pi(s_i) - a_i||^2                                  (2.4)

Without L_BC this is TD3, whose gradients stand in `desirepath.learning.td3.td3`. The three parts that make it more are
here: `demonstration_batch` gives the demonstrated r_j the goal's boost (2.8), `cloning_term` is the gradient of L_BC,
`balance` says lambda_RL and lambda_BC (table 2.1, 2.5.6); `update` puts them together.

Other than in the thesis: r_j and gamma reach over several steps (`returns.py`); explored goals earn half of the boost
instead of nothing (`configuration.py`); Q_1 stands for the smaller Q in (2.3), as in TD3's own paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from desirepath.demonstrations.demonstration import Demonstration, augment
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath.demonstrations.td3_bc.returns import returns_along
from desirepath.learning.td3.backprop import Floats
from desirepath.learning.td3.replay import concatenate
from desirepath.learning.td3.td3 import ActorTerm, Batch, Td3Agent
from desirepath.simulation.setups import get_setup


def demonstration_batch(demonstrations: Sequence[Demonstration], config: DemonstrationConfig) -> Batch:
    """The demonstration buffer: every transition of every augmented rollout, the goal rewarded with the boost (2.8)."""
    trajectories = [rollout for d in demonstrations for rollout in augment(d, config.augmentation)]
    gamma = get_setup(trajectories[0].scene.setup).gamma
    led_to = []
    for trajectory in trajectories:
        boosted = trajectory.rewards + np.where(trajectory.dones, config.goal_boost, 0.0)  # each ends at its goal
        led_to.append(returns_along(trajectory, boosted, config.steps_at_once, gamma))
    rewards, following, continues = (np.concatenate(parts) for parts in zip(*led_to, strict=True))
    return Batch(
        torch.from_numpy(np.concatenate([trajectory.observations for trajectory in trajectories])),
        torch.from_numpy(np.concatenate([trajectory.actions for trajectory in trajectories])),
        torch.from_numpy(rewards),
        torch.from_numpy(following),
        torch.from_numpy(continues),
    )


class Balance(NamedTuple):
    """lambda_RL and lambda_BC of equation 2.5."""

    rl: float
    bc: float


def balance(config: DemonstrationConfig, done: float) -> Balance:
    """The two weights once that share of the updates is done."""
    late = int(done >= config.reweighted_at)
    return Balance(config.rl_weight[late], config.bc_weight[late])


def cloning_term(demonstrated: Floats, weights: Balance) -> ActorTerm:
    """The gradient of lambda_BC / lambda_RL * L_BC at the actions pi(s_i) (2.4, 2.5).

    demonstrated (b_D, 2): actions a_i of the last b_D observations of the batch; the others are left alone. Relative to
    lambda_RL, because only the ratio of the two matters to Adam.
    """
    share = np.float32(weights.bc / weights.rl)
    first = -len(demonstrated)

    def term(_: Floats, actions: Floats) -> Floats:
        gradient = np.zeros_like(actions)
        gradient[first:] = 2 * share * (actions[first:] - demonstrated)
        return gradient

    return term


def update(
    agent: Td3Agent, explored: Batch, demonstrated: Batch, weights: Balance, hold: ActorTerm | None = None
) -> None:
    """One step down all of the above, and of what holds the actor to what it was, if anything does (ours)."""
    cloning = cloning_term(demonstrated.actions.numpy(), weights) if weights.bc > 0 else None
    terms = [term for term in (cloning, hold) if term is not None]

    def term(observations: Floats, actions: Floats) -> Floats:
        together: Floats = np.sum([one(observations, actions) for one in terms], axis=0, dtype=np.float32)
        return together

    agent.update(concatenate(explored, demonstrated), term if terms else None)
