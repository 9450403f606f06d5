"""The gradients that are written out by hand are those of the losses, and Adam is torch's Adam."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import huber_loss, mse_loss

from desirepath.learning.policies.networks import Parameters, actor_forward, critic_forward
from desirepath.learning.policies.shape import EXPLAINED_HEADS, NetworkShape
from desirepath.learning.td3.backprop import Adam
from desirepath.learning.td3.td3 import (
    MOST_AWAY,
    Batch,
    Td3Config,
    act,
    actor_gradients,
    cloning_gradients,
    critic_gradients,
    td_targets,
)
from desirepath.simulation.setups import Setup, get_setup

EXPLAINED_ROOM = get_setup("explained_room")
OPEN_FIELD = get_setup("open_field")
STUDY_ROOM = get_setup("study_room")

SHAPES = [
    NetworkShape.of(OPEN_FIELD),
    NetworkShape.of(STUDY_ROOM),
    NetworkShape(task_inputs=7, lidar_inputs=12, extractor=16, heads=(40, 24)),
    NetworkShape.of(EXPLAINED_ROOM, EXPLAINED_HEADS),
]
BATCH = 33


def networks(shape: NetworkShape) -> tuple[Parameters, Parameters]:
    generator = torch.Generator().manual_seed(4)
    actor = Parameters(shape.actor_layers(), trainable=True)
    critic = Parameters(shape.critic_layers(), trainable=True)
    for parameters in (actor, critic):
        parameters.initialise(generator)
    return actor, critic


def random_batch(shape: NetworkShape) -> Batch:
    generator = torch.Generator().manual_seed(7)

    def uniform(*size: int) -> Tensor:
        return torch.rand(*size, generator=generator) * 2 - 1

    continues = (torch.rand(BATCH, generator=generator) < 0.8).float()
    size = shape.observation_size
    return Batch(uniform(BATCH, size), uniform(BATCH, 2), 5 * uniform(BATCH), uniform(BATCH, size), continues)


def assert_equal_gradients(ours: np.ndarray, theirs: Tensor) -> None:
    assert theirs.abs().max() > 1e-4  # something was there to compare
    np.testing.assert_allclose(ours, theirs.numpy(), atol=2e-6 * float(theirs.abs().max()), rtol=1e-4)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_critic_gradients_are_those_of_the_loss(shape: NetworkShape) -> None:
    _, critic = networks(shape)
    batch, targets = random_batch(shape), torch.linspace(-3, 3, BATCH)
    critic_gradients(batch, targets.numpy(), critic.weights, critic.gradients)
    assert critic.grad is not None
    ours = critic.grad.numpy().copy()
    critic.zero_grad()
    first, second = critic_forward(batch.observations, batch.actions, critic.layers)
    torch.autograd.backward(mse_loss(first, targets) + mse_loss(second, targets))
    assert_equal_gradients(ours, critic.grad)


@pytest.mark.parametrize("with_term", [False, True])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_actor_gradients_are_those_of_the_loss(shape: NetworkShape, with_term: bool) -> None:
    def added(observations: Tensor, actions: Tensor) -> Tensor:
        return (observations[:, :1] * actions**3).sum()

    def term(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        return observations[:, :1] * 3 * actions**2

    actor, critic = networks(shape)
    batch = random_batch(shape)
    observations = batch.observations.numpy()
    actor_gradients(observations, actor.weights, critic.weights, actor.gradients, term if with_term else None)
    assert actor.grad is not None
    ours = actor.grad.numpy().copy()
    actor.zero_grad()
    actions = actor_forward(batch.observations, actor.layers)
    loss = -critic_forward(batch.observations, actions, critic.frozen(), n_heads=1)[0].mean()
    torch.autograd.backward(loss + added(batch.observations, actions) if with_term else loss)
    assert_equal_gradients(ours, actor.grad)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_cloning_gradients_are_those_of_hubers_loss(shape: NetworkShape) -> None:
    actor, _ = networks(shape)
    batch = random_batch(shape)
    cloning_gradients(batch.observations.numpy(), batch.actions.numpy(), actor.weights, actor.gradients)
    assert actor.grad is not None
    ours = actor.grad.numpy().copy()
    actor.zero_grad()
    actions = actor_forward(batch.observations, actor.layers)
    torch.autograd.backward(2 / BATCH * huber_loss(actions, batch.actions, reduction="sum", delta=MOST_AWAY))
    assert_equal_gradients(ours, actor.grad)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_targets_are_the_equation_written_in_torch(shape: NetworkShape) -> None:
    actor, critic = networks(shape)
    batch, config = random_batch(shape), Td3Config(gamma=0.9)
    noise = torch.randn(BATCH, 2, generator=torch.Generator().manual_seed(1))
    clipped = (noise * config.target_noise).clamp(-config.target_noise_clip, config.target_noise_clip)
    actions = (actor_forward(batch.next_observations, actor.frozen()) + clipped).clamp(-1, 1)
    worth = torch.minimum(*critic_forward(batch.next_observations, actions, critic.frozen()))
    expected = batch.rewards + 0.9 * batch.continues * worth
    targets = td_targets(batch, noise.numpy(), actor.weights, critic.weights, config)
    np.testing.assert_allclose(targets, expected.numpy(), atol=1e-5)


@pytest.mark.parametrize("setup", [OPEN_FIELD, STUDY_ROOM, EXPLAINED_ROOM], ids=lambda setup: setup.name)
def test_the_actor_acts_as_in_torch(setup: Setup) -> None:
    actor, _ = networks(NetworkShape.of(setup))
    observations = torch.rand(50, setup.observation_size)
    np.testing.assert_allclose(
        act(observations.numpy(), actor.weights), actor_forward(observations, actor.frozen()).numpy(), atol=1e-6
    )


def test_adam_is_that_of_torch() -> None:
    generator = torch.Generator().manual_seed(2)
    theirs = torch.randn(500, generator=generator).requires_grad_(True)
    ours = theirs.detach().numpy().copy()
    reference, adam = torch.optim.Adam([theirs], lr=3e-3), Adam(500, 3e-3)
    for k in range(50):
        gradient = torch.randn(500, generator=generator) * 10.0 ** (k % 5 - 3)
        theirs.grad = gradient
        reference.step()
        adam.step(ours, gradient.numpy())
    np.testing.assert_allclose(ours, theirs.detach().numpy(), atol=1e-6)
