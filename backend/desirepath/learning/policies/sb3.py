"""Stable-Baselines3's TD3 on the same network: the honest baseline of the benchmark, and the frame of exported zips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import TD3
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.sb3_extractor import TwoBranchExtractor
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.td3 import Td3Config
from desirepath.simulation.environments import action_space, observation_space
from desirepath.simulation.setups import Setup, get_setup


class SpacesOnly(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """The spaces of a setup without a simulation, for models that are only saved. Cannot be stepped."""

    def __init__(self, setup: Setup) -> None:
        self.observation_space, self.action_space = observation_space(setup), action_space()


def sb3_td3(
    env: VecEnv,
    setup: Setup,
    config: Td3Config,
    *,
    heads: tuple[int, ...],
    seed: int,
    buffer_size: int,
    updates_per_step: int,
    learning_starts: int = 0,
    shape: NetworkShape | None = None,
) -> TD3:
    """SB3's TD3 with the same network and hyper-parameters as ours, `updates_per_step` updates per vector step. shape:
    of a network that is not the setup's with these heads."""
    shape = shape or NetworkShape.of(setup, heads)
    extractors: dict[str, Any] = {}
    if shape.extractor:
        extractors = {
            "features_extractor_class": TwoBranchExtractor,
            "features_extractor_kwargs": {"task_inputs": shape.task_inputs, "width": shape.extractor},
        }
    return TD3(
        "MlpPolicy",
        env,
        learning_rate=config.learning_rate,
        buffer_size=buffer_size,
        learning_starts=learning_starts,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.gamma,
        train_freq=1,
        gradient_steps=updates_per_step,
        policy_delay=config.policy_delay,
        target_policy_noise=config.target_noise,
        target_noise_clip=config.target_noise_clip,
        policy_kwargs=extractors | {"net_arch": list(heads)},
        seed=seed,
        device="cpu",
    )


def _linear_layers(*modules: torch.nn.Module) -> list[torch.nn.Linear]:
    return [layer for module in modules for layer in module.modules() if isinstance(layer, torch.nn.Linear)]


def actor_layers(model: TD3, *, target: bool = False) -> list[torch.nn.Linear]:
    """SB3's actor layers in the order of `NetworkShape.actor_layers`."""
    actor = model.actor_target if target else model.actor
    return _linear_layers(actor.features_extractor, actor.mu)


def critic_layers(model: TD3, *, target: bool = False) -> list[torch.nn.Linear]:
    """SB3's critic layers in the order of `NetworkShape.critic_layers`."""
    critic = model.critic_target if target else model.critic
    return _linear_layers(critic.features_extractor, *critic.q_networks)


def write_layers(layers: list[torch.nn.Linear], arrays: Sequence[NDArray[np.float32]]) -> None:
    """Write our arrays (weights (inputs, outputs)) into torch's layers (weights (outputs, inputs))."""
    with torch.no_grad():
        for layer, weight, bias in zip(layers, arrays[0::2], arrays[1::2], strict=True):
            layer.weight.copy_(torch.from_numpy(np.ascontiguousarray(weight.T)))
            layer.bias.copy_(torch.from_numpy(np.ascontiguousarray(bias)))


def read_layers(layers: list[torch.nn.Linear]) -> tuple[NDArray[np.float32], ...]:
    """The reverse of `write_layers`."""
    return tuple(
        array
        for layer in layers
        for array in (layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy())
    )


def sb3_model_of(policy: Policy) -> TD3:
    """An SB3 TD3 model holding this policy's weights, targets included, ready to save or to train on."""
    setup = get_setup(policy.setup)
    model = sb3_td3(
        DummyVecEnv([lambda: SpacesOnly(setup)]),
        setup,
        Td3Config(gamma=setup.gamma),
        heads=policy.shape.heads,
        seed=0,
        buffer_size=1,
        updates_per_step=1,
        shape=policy.shape,
    )
    for target in (False, True):
        write_layers(actor_layers(model, target=target), policy.actor)
        if policy.critic:
            write_layers(critic_layers(model, target=target), policy.critic)
    return model
