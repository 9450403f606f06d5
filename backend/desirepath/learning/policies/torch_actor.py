"""A policy as a differentiable function, for who asks what moved it (`explain`): ours, Stable-Baselines3's."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache

import numpy as np
import torch
from torch import Tensor

from desirepath.learning.policies.networks import actor_forward
from desirepath.learning.policies.policy import Policy, PolicyError

Actor = Callable[[Tensor], Tensor]
"""(n, obs) -> (n, 2) actions in [-1, 1]."""


def actor_of(policy: Policy) -> Actor:
    """A policy's usual actor, without its slowing rule and its recovery policies, which drive while the robot is stuck.

    It computes in the precision of what it is given.
    """

    @cache
    def layers(dtype: torch.dtype) -> list[tuple[Tensor, Tensor]]:
        arrays = [torch.from_numpy(np.ascontiguousarray(array)).to(dtype) for array in policy.actor]
        return list(zip(arrays[0::2], arrays[1::2], strict=True))

    return lambda observations: actor_forward(observations, layers(observations.dtype))


def actor_of_sb3(model: object) -> Actor:
    """The deterministic actor of a Stable-Baselines3 model (TD3, SAC, PPO, ...) that reads a setup's observations.

    Of TD3 and DDPG it computes in the precision of what it is given, of others in single.

    Raises PolicyError for anything else.
    """
    policy = getattr(model, "policy", None)
    if not isinstance(policy, torch.nn.Module):
        raise PolicyError(f"model = {type(model).__name__}: needs a Stable-Baselines3 model, which has a policy")

    actor = getattr(policy, "actor", None)
    whole = None
    if isinstance(actor, torch.nn.Module) and not hasattr(actor, "latent_pi"):  # TD3, DDPG
        whole = copy.deepcopy(actor).double()

    def act(observations: Tensor) -> Tensor:
        if observations.dtype == torch.float64 and whole is not None:
            features = whole.get_submodule("features_extractor")(observations)
            exact: Tensor = whole.get_submodule("mu")(features)
            return exact
        actions = policy(observations, deterministic=True)
        first: Tensor = actions[0] if isinstance(actions, tuple) else actions
        return first

    return act
