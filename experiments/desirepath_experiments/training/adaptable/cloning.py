"""Behavioural cloning: a network that acts as demonstrations do, by mean squared error, and nothing else.

TD3 with a cloning term (chapter 2) is `desirepath.demonstrations.td3_bc`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.policies.networks import Parameters
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.backprop import Adam, head, head_backward
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.training.adaptable.ranking import DEMONSTRATED_HEADS

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class CloningConfig:
    """All ours; section 5.3.2.2 has the network only."""

    seed: int = 0
    updates: int = 6_000
    batch_size: int = 256
    learning_rate: float = 1e-3  # falls linearly to a tenth
    heads: tuple[int, ...] = DEMONSTRATED_HEADS


def clone_policy(trajectories: Sequence[Trajectory], config: CloningConfig) -> Policy:
    """The policy that acts as in these trajectories of one setup: least mean |pi(s) - a|^2.

    Raises ValueError without trajectories, SetupError where they are of several setups.
    """
    if not trajectories:
        raise ValueError("trajectories: none given, so there is nothing to clone")
    setup = get_setup(
        require_same(**{f"trajectory {k}": trajectory.scene.setup for k, trajectory in enumerate(trajectories)})
    )
    observations = np.concatenate([trajectory.observations for trajectory in trajectories])
    actions = np.concatenate([trajectory.actions for trajectory in trajectories])
    shape = NetworkShape(setup.polar_size, setup.surroundings_size, 0, config.heads)
    network = Parameters(shape.actor_layers(), trainable=True)
    network.initialise(torch.Generator().manual_seed(config.seed))
    assert network.grad is not None  # noqa: S101 - made trainable
    optimiser = Adam(network.flat.numel(), config.learning_rate)
    random = np.random.default_rng([config.seed, 51])
    for update in range(config.updates):
        optimiser.learning_rate = config.learning_rate * (1 - 0.9 * update / config.updates)
        rows = random.integers(len(actions), size=config.batch_size)
        seen = observations[rows]
        through = head(seen, network.weights)
        done = np.tanh(through.output)
        at_output = (done - actions[rows]) * np.float32(2 / config.batch_size) * (1 - done * done)
        head_backward(at_output, seen, through, network.weights, network.gradients)
        optimiser.step(network.flat.numpy(), network.grad.numpy())
    return Policy(setup.name, shape, tuple(network.to_arrays()))
