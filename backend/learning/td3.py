"""TD3 (Fujimoto et al. 2018) on flat parameters: the update that base training, ensemble and alignment share.

Same algorithm and equations as Stable-Baselines3's TD3 (`tests/learning/test_td3.py` holds one update equal to 1e-5);
owned for speed on one thread; `desirepath benchmark train` measures both.
Interaction with environments lives in `collect.py`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from backend.learning.networks import Layer, Parameters, actor_forward, critic_forward
from backend.learning.shape import NetworkShape

ActorTerm = Callable[[Tensor, Tensor], Tensor]
"""(observations (n, obs), this actor's actions (n, 2)) -> scalar that is added to the actor's loss."""


@dataclass(frozen=True)
class Td3Config:
    """Hyper-parameters of one update. Defaults: ours, measured on prototypes (DESIGN, simulation and learning)."""

    gamma: float = 0.98  # table 6.1
    batch_size: int = 128
    learning_rate: float = 5e-4
    tau: float = 0.01
    policy_delay: int = 2  # SB3's default, as the two noises below
    target_noise: float = 0.2
    target_noise_clip: float = 0.5


class Batch(NamedTuple):
    """Transitions. observations, next_observations (n, obs); actions (n, 2); rewards, continues (n,) float32.

    continues is 0 where the episode ended. A timeout ends it too: the core rewards punish it, so it is no truncation.
    """

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    next_observations: Tensor
    continues: Tensor


def td_targets(
    batch: Batch, noise: Tensor, actor_target: list[Layer], critic_target: list[Layer], config: Td3Config
) -> Tensor:
    """y = r + gamma * min_k Q'_k(s', clip(pi'(s') + clip(noise))), no gradient."""
    with torch.no_grad():
        clipped = (noise * config.target_noise).clamp(-config.target_noise_clip, config.target_noise_clip)
        next_actions = (actor_forward(batch.next_observations, actor_target) + clipped).clamp(-1, 1)
        first, second = critic_forward(batch.next_observations, next_actions, critic_target)
        return batch.rewards + config.gamma * batch.continues * torch.minimum(first, second)


def critic_loss(batch: Batch, targets: Tensor, critic: list[Layer]) -> Tensor:
    """Sum over both heads of the mean squared temporal-difference error."""
    first, second = critic_forward(batch.observations, batch.actions, critic)
    return torch.nn.functional.mse_loss(first, targets) + torch.nn.functional.mse_loss(second, targets)


def actor_loss(observations: Tensor, actor: list[Layer], critic: list[Layer], term: ActorTerm | None = None) -> Tensor:
    """-mean Q_1(s, pi(s)), plus an extra term on the actions where an algorithm has one (equation 6.3)."""
    actions = actor_forward(observations, actor)
    loss = -critic_forward(observations, actions, critic, n_heads=1)[0].mean()
    return loss if term is None else loss + term(observations, actions)


class Memory(NamedTuple):
    """An agent's weights (actor, critic, their targets) and optimiser states at one moment."""

    flats: list[Tensor]
    optimisers: list[dict[str, Any]]


class Td3Agent:
    """One actor, one two-headed critic, their targets and optimisers."""

    def __init__(self, shape: NetworkShape, config: Td3Config, *, seed: int) -> None:
        self.shape, self.config = shape, config
        self.generator = torch.Generator().manual_seed(seed)
        self.actor = Parameters(shape.actor_layers(), trainable=True)
        self.critic = Parameters(shape.critic_layers(), trainable=True)
        self.actor.initialise(self.generator)
        self.critic.initialise(self.generator)
        self.actor_target = Parameters(shape.actor_layers(), trainable=False)
        self.critic_target = Parameters(shape.critic_layers(), trainable=False)
        self.synchronise_targets()
        self.actor_optimiser = torch.optim.Adam([self.actor.flat], lr=config.learning_rate, fused=True)
        self.critic_optimiser = torch.optim.Adam([self.critic.flat], lr=config.learning_rate, fused=True)
        self.updates = 0

    def synchronise_targets(self) -> None:
        """Copy actor and critic into their targets, at the start and after loading weights."""
        self.actor_target.flat.copy_(self.actor.flat)
        self.critic_target.flat.copy_(self.critic.flat)

    def remember(self) -> Memory:
        """Everything that learning has changed, to `go_back` to."""
        flats = [parameters.flat.detach().clone() for parameters in self._parameters()]
        return Memory(flats, [copy.deepcopy(optimiser.state_dict()) for optimiser in self._optimisers()])

    def go_back(self, memory: Memory) -> None:
        """Be as at `remember`; the count of updates and the random stream go on."""
        with torch.no_grad():
            for parameters, flat in zip(self._parameters(), memory.flats, strict=True):
                parameters.flat.copy_(flat)
        for optimiser, state in zip(self._optimisers(), memory.optimisers, strict=True):
            optimiser.load_state_dict(copy.deepcopy(state))

    def _parameters(self) -> tuple[Parameters, ...]:
        return self.actor, self.critic, self.actor_target, self.critic_target

    def _optimisers(self) -> tuple[torch.optim.Adam, ...]:
        return self.actor_optimiser, self.critic_optimiser

    def set_learning_rate(self, learning_rate: float) -> None:
        """Change both optimisers' step size from the next update on."""
        for optimiser in self._optimisers():
            optimiser.param_groups[0]["lr"] = learning_rate

    def update(self, batch: Batch, term: ActorTerm | None = None) -> None:
        """One critic step; every `policy_delay`-th time one actor step and one step of the targets."""
        noise = torch.randn(batch.actions.shape, generator=self.generator)
        targets = td_targets(batch, noise, self.actor_target.layers, self.critic_target.layers, self.config)
        self.critic.zero_grad()
        critic_loss(batch, targets, self.critic.layers).backward()  # type: ignore[no-untyped-call]
        self.critic_optimiser.step()
        self.updates += 1
        if self.updates % self.config.policy_delay:
            return
        self.actor.zero_grad()
        loss = actor_loss(batch.observations, self.actor.layers, self.critic.frozen(), term)
        loss.backward()  # type: ignore[no-untyped-call]
        self.actor_optimiser.step()
        self.actor_target.flat.lerp_(self.actor.flat, self.config.tau)
        self.critic_target.flat.lerp_(self.critic.flat, self.config.tau)

    @torch.no_grad()
    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """observations (n, obs) -> actions (n, 2) in [-1, 1], without exploration."""
        actions: NDArray[np.float32] = actor_forward(torch.from_numpy(observations), self.actor.frozen()).numpy()
        return actions
