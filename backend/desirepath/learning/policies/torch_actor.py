"""A policy as a differentiable function, for who asks what moved it (`explain`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.networks import actor_forward
from desirepath.learning.policies.policy import Policy
from desirepath.simulation.acting import ActFunction

Actor = Callable[[Tensor], Tensor]
"""(n, obs) -> (n, 2) actions in [-1, 1]."""
ASKED_AT_ONCE = 8192  # rows
STEP = 1e-3  # of scaled inputs: small beside what a lidar can tell, large beside single precision


def actor_of(policy: Policy | ForeignPolicy) -> Actor:
    """A policy's usual actor, without its slowing rule and its recovery policies, which drive while the robot is stuck.

    It computes in the precision of what it is given; a network of others in single, its slopes by differences.
    """
    if isinstance(policy, ForeignPolicy):
        unslowed = policy if policy.slowing is None else replace(policy, slowing=None)  # else its process starts twice
        return partial(_Asked.apply, unslowed.act)

    @cache
    def layers(dtype: torch.dtype) -> list[tuple[Tensor, Tensor]]:
        arrays = [torch.from_numpy(np.ascontiguousarray(array)).to(dtype) for array in policy.actor]
        return list(zip(arrays[0::2], arrays[1::2], strict=True))

    return lambda observations: actor_forward(observations, layers(observations.dtype))


class _Asked(torch.autograd.Function):
    """What an actor that can only be asked does, and how that changes with what it is given."""

    @staticmethod
    def forward(ctx: Any, act: ActFunction, observations: Tensor) -> Tensor:
        ctx.act = act
        ctx.save_for_backward(observations)
        return torch.from_numpy(act(observations.numpy().astype(np.float32))).to(observations.dtype)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor]:
        """Central differences, input by input."""
        (observations,) = ctx.saved_tensors
        given = observations.numpy().astype(np.float32)
        n, size = given.shape
        found = np.zeros((n, size), dtype=np.float64)
        up = STEP * np.eye(size, dtype=np.float32)
        at_once = max(1, ASKED_AT_ONCE // (2 * size))
        for first in range(0, n, at_once):
            rows = given[first : first + at_once, None]
            moved = np.concatenate([rows + up, rows - up])  # (2 * rows, size, size)
            actions = ctx.act(moved.reshape(-1, size)).astype(np.float64).reshape(2, -1, size, 2)
            weights = grads[0][first : first + at_once].numpy().astype(np.float64)
            found[first : first + at_once] = np.einsum("nka,na->nk", (actions[0] - actions[1]) / (2 * STEP), weights)
        return None, torch.from_numpy(found).to(observations.dtype)
