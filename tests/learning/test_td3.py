"""Our TD3 update is TD3: equal to Stable-Baselines3's on the same weights, batch and noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import DummyVecEnv

from desirepath.learning.policies.networks import Parameters, actor_forward
from desirepath.learning.policies.sb3 import SpacesOnly, actor_layers, critic_layers, read_layers, sb3_td3, write_layers
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.td3 import Batch, Td3Agent, Td3Config
from desirepath.simulation.setups import Setup, get_setup

OPEN_FIELD = get_setup("open_field")
STUDY_ROOM = get_setup("study_room")


def random_batch(setup: Setup, n: int, seed: int) -> Batch:
    random = np.random.default_rng(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.from_numpy(random.uniform(-1, 1, shape).astype(np.float32))

    size = setup.observation_size
    continues = torch.from_numpy((random.random(n) < 0.9).astype(np.float32))
    return Batch(uniform(n, size), uniform(n, 2), 5 * uniform(n), uniform(n, size), continues)


@pytest.mark.parametrize("setup", [OPEN_FIELD, STUDY_ROOM], ids=lambda setup: setup.name)
def test_two_updates_equal_those_of_stable_baselines3(setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    config = Td3Config(gamma=0.97, batch_size=32, tau=0.02)
    ours = Td3Agent(NetworkShape.of(setup), config, seed=1)
    theirs = sb3_td3(
        DummyVecEnv([lambda: SpacesOnly(setup)]),
        setup,
        config,
        heads=(128, 128),
        seed=0,
        buffer_size=10,
        updates_per_step=1,
    )
    for target in (False, True):
        write_layers(actor_layers(theirs, target=target), ours.actor.to_arrays())
        write_layers(critic_layers(theirs, target=target), ours.critic.to_arrays())
    # Two: the second is the first in which actor and targets move as well.
    batches = [random_batch(setup, 32, seed) for seed in range(2)]
    noises = [torch.randn(32, 2, generator=torch.Generator().manual_seed(seed)) for seed in range(2)]

    # SB3 draws its noise with Tensor.normal_, we with torch.randn: both are given the same numbers.
    ours_noise, theirs_noise = iter(noises), iter(noises)
    monkeypatch.setattr(torch, "randn", lambda *_, **__: next(ours_noise))
    for batch in batches:
        ours.update(batch)
    monkeypatch.undo()

    def sample(_: Any, batch_size: int, env: Any = None) -> ReplayBufferSamples:
        batch = batches[sample.calls]  # type: ignore[attr-defined]
        sample.calls += 1  # type: ignore[attr-defined]
        dones = 1 - batch.continues[:, None]
        return ReplayBufferSamples(
            batch.observations, batch.actions, batch.next_observations, dones, batch.rewards[:, None], None
        )

    sample.calls = 0  # type: ignore[attr-defined]
    monkeypatch.setattr(type(theirs.replay_buffer), "sample", sample)
    monkeypatch.setattr(torch.Tensor, "normal_", lambda self, *_: self.copy_(next(theirs_noise) * config.target_noise))
    theirs.set_logger(configure(None, []))
    for _ in batches:
        theirs.train(gradient_steps=1, batch_size=32)

    for mine, sb3 in (
        (ours.actor, actor_layers(theirs)),
        (ours.critic, critic_layers(theirs)),
        (ours.actor_target, actor_layers(theirs, target=True)),
        (ours.critic_target, critic_layers(theirs, target=True)),
    ):
        for a, b in zip(mine.to_arrays(), read_layers(sb3), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)


def test_layer_views_and_flat_vector_are_the_same_memory() -> None:
    parameters = Parameters(NetworkShape.of(OPEN_FIELD).actor_layers(), trainable=True)
    parameters.initialise(torch.Generator().manual_seed(0))
    observations = torch.rand(5, OPEN_FIELD.observation_size)
    before = actor_forward(observations, parameters.layers)
    torch.autograd.backward(before.sum())
    assert parameters.grad is not None
    assert parameters.grad.abs().sum() > 0
    with torch.no_grad():
        parameters.flat.add_(parameters.grad, alpha=-1e-3)
    assert actor_forward(observations, parameters.layers).sum() < before.sum()


def test_weights_of_another_shape_are_refused() -> None:
    small = Parameters(NetworkShape.of(OPEN_FIELD).actor_layers(), trainable=False)
    large = Parameters(NetworkShape.of(STUDY_ROOM).actor_layers(), trainable=False)
    with pytest.raises(ValueError, match="this network needs"):
        small.load_arrays(large.to_arrays())


def test_an_agent_goes_back_to_what_it_remembers_and_learns_on_the_same_way() -> None:
    torch.set_num_threads(1)
    agent = Td3Agent(NetworkShape.of(OPEN_FIELD), Td3Config(gamma=0.97, batch_size=32), seed=1)
    batches = [random_batch(OPEN_FIELD, 32, seed) for seed in range(6)]
    for batch in batches[:2]:
        agent.update(batch)
    memory, noise = agent.remember(), agent.generator.get_state()

    def four_updates_more() -> torch.Tensor:
        agent.generator.set_state(noise)
        for batch in batches[2:]:
            agent.update(batch)
        return agent.actor.flat.detach().clone()

    first = four_updates_more()
    agent.go_back(memory)
    assert not torch.equal(agent.actor.flat, first)
    torch.testing.assert_close(four_updates_more(), first, rtol=0, atol=0)
