"""TD3 (Fujimoto et al. 2018) on flat parameters: the update that base training, ensemble and alignment share.

Same algorithm and equations as Stable-Baselines3's TD3 (`tests/learning/test_td3.py` holds one update equal to 1e-5);
owned for speed on one thread; `desirepath benchmark train` measures both. The chain rule through the networks is
written out in `backprop.py`; interaction with environments lives in `replay.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from desirepath.learning.policies.networks import Parameters
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.backprop import (
    Adam,
    Floats,
    Weights,
    features,
    features_backward,
    has_extractors,
    head,
    head_backward,
    heads_of,
    input_gradient,
    move_towards,
)

MOST_AWAY = 0.5  # where Huber's loss of cloning turns from square to straight; ours

CRITIC_ALONE = 600  # updates in which a critic learns what a policy is worth that can drive already; ours

ActorTerm = Callable[[Floats, Floats], Floats]
"""(observations (n, obs), this actor's actions (n, 2)) -> gradient (n, 2), at these actions, of what an algorithm adds
to the actor's loss; in closed form, as everything here."""


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


def pull_gradient(actions: Floats, towards: Floats, weight: float) -> Floats:
    """Gradient (n, 2) of weight * mean |a - towards|^2 over actions (n, 2)."""
    gradient: Floats = np.float32(2 * weight / len(actions)) * (actions - towards)
    return gradient


def held_to(actor: Sequence[Floats], shape: NetworkShape, weight: float) -> ActorTerm | None:
    """Draws a learning actor to what another does (as in TD3+BC, Fujimoto and Gu 2021); None without weight."""
    if weight <= 0:
        return None
    other = Parameters(shape.actor_layers(), trainable=False)
    other.load_arrays(actor)
    return lambda observations, actions: pull_gradient(actions, act(observations, other.weights), weight)


class _ActorPass:
    """Observations (n, obs) on their way through an actor to `actions` (n, 2), and a gradient on its way back."""

    def __init__(self, observations: Floats, actor: Weights) -> None:
        self._observations, self._actor = observations, actor
        self.seen = features(observations, actor)
        (self._layers,) = heads_of(observations, actor)
        self._through = head(self.seen.joined, self._layers)
        self.actions: Floats = np.tanh(self._through.output)

    def back(self, at_actions: Floats, gradients: Weights) -> None:
        """Write the gradients of what has the gradient `at_actions` (n, 2) at these actions."""
        (of_layers,) = heads_of(self._observations, gradients)
        at_output = at_actions * (1 - self.actions * self.actions)
        at_first = head_backward(at_output, self.seen.joined, self._through, self._layers, of_layers)
        if has_extractors(self._observations, self._actor):
            features_backward(at_first @ self._layers[0][0].T, self.seen, self._actor, gradients)


def act(observations: Floats, actor: Weights) -> Floats:
    """observations (n, obs) -> actions (n, 2) in [-1, 1]."""
    return _ActorPass(observations, actor).actions


def td_targets(batch: Batch, noise: Floats, actor_target: Weights, critic_target: Weights, config: Td3Config) -> Floats:
    """y = r + gamma * min_k Q'_k(s', clip(pi'(s') + clip(noise))): (n,). noise (n, 2): standard normal."""
    following = batch.next_observations.numpy()
    clipped = np.clip(noise * np.float32(config.target_noise), -config.target_noise_clip, config.target_noise_clip)
    actions = np.clip(act(following, actor_target) + clipped, -1, 1)
    joined = features(following, critic_target, actions).joined
    first, second = heads_of(following, critic_target, 2)
    value = np.minimum(head(joined, first).output, head(joined, second).output)[:, 0]
    targets: Floats = batch.rewards.numpy() + np.float32(config.gamma) * batch.continues.numpy() * value
    return targets


def critic_gradients(batch: Batch, targets: Floats, critic: Weights, gradients: Weights) -> float:
    """Write the gradients of sum_k mean (Q_k(s, a) - y)^2 over both heads k; returns that loss."""
    observations = batch.observations.numpy()
    seen = features(observations, critic, batch.actions.numpy())
    extracted = has_extractors(observations, critic)
    width = seen.joined.shape[1] - batch.actions.shape[1]
    at_joined = np.zeros((len(targets), width), dtype=np.float32)
    loss = 0.0
    for layers, of_layers in zip(heads_of(observations, critic, 2), heads_of(observations, gradients, 2), strict=True):
        through = head(seen.joined, layers)
        error = (through.output - targets[:, None]) * np.float32(2 / len(targets))
        loss += float(np.vdot(error, error)) * len(targets) / 4
        at_first = head_backward(error, seen.joined, through, layers, of_layers)
        if extracted:
            at_joined += at_first @ layers[0][0][:width].T
    if extracted:
        features_backward(at_joined, seen, critic, gradients)
    return loss


def actor_gradients(
    observations: Floats, actor: Weights, critic: Weights, gradients: Weights, term: ActorTerm | None = None
) -> float:
    """Write the gradients of -mean Q_1(s, pi(s)), plus a term on the actions where an algorithm has one (eq. 6.3);
    returns the former, without the term."""
    passed = _ActorPass(observations, actor)
    actions = passed.actions
    judged = features(observations, critic, actions)
    width = passed.seen.joined.shape[1]
    minus_mean = np.full((len(actions), 1), -1 / len(actions), dtype=np.float32)
    judge = heads_of(observations, critic, 2)[0]
    value = head(judged.joined, judge)
    at_actions = input_gradient(minus_mean, value, judge, slice(width, None))
    if term is not None:
        at_actions += term(observations, actions)
    passed.back(at_actions, gradients)
    return -float(value.output.mean())


def cloning_gradients(observations: Floats, wanted: Floats, actor: Weights, gradients: Weights) -> None:
    """Write the gradients of Huber's loss between pi(s) and the wanted actions (n, 2)."""
    passed = _ActorPass(observations, actor)
    away = np.clip(passed.actions - wanted, -MOST_AWAY, MOST_AWAY)
    passed.back(away * np.float32(2 / len(observations)), gradients)


class Memory(NamedTuple):
    """An agent's weights (actor, critic, their targets) and optimiser states at one moment."""

    flats: list[Tensor]
    optimisers: list[Any]


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
        self._actor_optimiser = Adam(self.actor.flat.numel(), config.learning_rate)
        self._critic_optimiser = Adam(self.critic.flat.numel(), config.learning_rate)
        self.updates = 0
        self.actor_waits = 0
        """So many updates teach the critic alone, of an actor that can drive already."""
        self.losses: dict[str, float] = {}
        """Of the last update, by name, for curves; nothing is decided by them."""

    def synchronise_targets(self) -> None:
        """Copy actor and critic into their targets, at the start and after loading weights."""
        self.actor_target.flat.copy_(self.actor.flat)
        self.critic_target.flat.copy_(self.critic.flat)

    def remember(self) -> Memory:
        """Everything that learning has changed, to `go_back` to."""
        flats = [parameters.flat.detach().clone() for parameters in self._parameters()]
        return Memory(flats, [optimiser.remember() for optimiser in self._optimisers()])

    def go_back(self, memory: Memory) -> None:
        """Be as at `remember`; the count of updates and the random stream go on."""
        with torch.no_grad():
            for parameters, flat in zip(self._parameters(), memory.flats, strict=True):
                parameters.flat.copy_(flat)
        for optimiser, state in zip(self._optimisers(), memory.optimisers, strict=True):
            optimiser.go_back(state)

    def _parameters(self) -> tuple[Parameters, ...]:
        return self.actor, self.critic, self.actor_target, self.critic_target

    def _optimisers(self) -> tuple[Adam, Adam]:
        return self._actor_optimiser, self._critic_optimiser

    def set_learning_rate(self, learning_rate: float, *, critic: float | None = None) -> None:
        """Change both optimisers' step size from the next update on; the critic's may differ."""
        self._actor_optimiser.learning_rate = learning_rate
        self._critic_optimiser.learning_rate = learning_rate if critic is None else critic

    def update(self, batch: Batch, term: ActorTerm | None = None) -> None:
        """One critic step; every `policy_delay`-th time one actor step and one step of the targets."""
        noise = torch.randn(batch.actions.shape, generator=self.generator).numpy()
        targets = td_targets(batch, noise, self.actor_target.weights, self.critic_target.weights, self.config)
        loss = critic_gradients(batch, targets, self.critic.weights, self.critic.gradients)
        self.losses["critic_loss"] = loss
        _step(self._critic_optimiser, self.critic)
        self.updates += 1
        if self.updates % self.config.policy_delay:
            return
        if self.updates > self.actor_waits:
            observations = batch.observations.numpy()
            value = actor_gradients(observations, self.actor.weights, self.critic.weights, self.actor.gradients, term)
            self.losses["actor_loss"] = value
            _step(self._actor_optimiser, self.actor)
        tau = np.float32(self.config.tau)
        move_towards(self.actor_target.flat.numpy(), self.actor.flat.numpy(), tau)
        move_towards(self.critic_target.flat.numpy(), self.critic.flat.numpy(), tau)

    def clone(self, observations: Floats, wanted: Floats) -> None:
        """One step of the actor alone towards the wanted actions (n, 2) there, as in DAgger (Ross et al. 2011)."""
        cloning_gradients(observations, wanted, self.actor.weights, self.actor.gradients)
        _step(self._actor_optimiser, self.actor)

    def act(self, observations: Floats) -> Floats:
        """observations (n, obs) -> actions (n, 2) in [-1, 1], without exploration."""
        return act(observations, self.actor.weights)


def _step(optimiser: Adam, parameters: Parameters) -> None:
    if parameters.grad is None:
        raise ValueError("parameters: made without gradients, so there is nothing to step along")
    optimiser.step(parameters.flat.numpy(), parameters.grad.numpy())
