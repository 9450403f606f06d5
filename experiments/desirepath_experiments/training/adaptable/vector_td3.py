"""MO-TD3 (PD-MORL, Basaklar et al. 2023; section 5.3.2): TD3 whose critic estimates every objective's return.

critic:  sum_k mean |Q_k(s, a, w) - y|^2,  y = r + gamma Q'_j(s', a', w),  j = the twin with the least (1, w) . Q'
actor:   -mean (1, w) . Q_1(s, pi(s, w), w) + alpha mean angle(I(w), q(Q_1)) + beta mean w_d^2 |pi(s, w) - clone(s)|^2

r is the vector (core, demonstration, distance, efficiency), w the preference of the latter three, I the interpolator,
q the objectives' values normalised as its nodes are, w_d the weight of the demonstration and clone(s) what its clone
would do. That last term is ours: TD3+BC (Fujimoto and Gu 2021) as far as the demonstration counts, left out where the
critic sees the clone lose much of the core reward (Nair et al.'s Q-filter, 2018). The chain rule is written out as in
`td3/backprop.py`; where transitions come from lives in `training.py`. Core counts once, whatever the
preference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.adaptable.objectives import REWARDS, SIZE, sample_preferences
from desirepath.learning.policies.networks import Parameters
from desirepath.learning.td3.backprop import Adam, Weights, head, head_backward, input_gradient, move_towards

Floats = NDArray[np.float32]
CLIP_COSINE = 0.999
CORE_LOST = 0.15  # of the scaled core return (an eighth of a metre of progress): who would lose more is not imitated
NARROWEST = 1e-3  # range of an objective that makes no difference to the solutions
SMALLEST = 1e-6


@dataclass(frozen=True)
class Interpolator:
    """PD-MORL's preference interpolator: where in value space a preference points.

    solutions (3, 3): row k holds the objectives' mean returns per metre of way when objective k alone counts.

    Per metre (ours), so that values of a state near the goal and of one far away compare: both are asked which
    direction the rest of the way takes. Penalties are all below 0; normalised, the worst solution of an objective is 0
    and the best 1, so directions lie in the positive octant, where preferences lie.
    """

    solutions: Floats

    @property
    def low(self) -> Floats:
        return np.asarray(self.solutions.min(axis=0), dtype=np.float32)

    @property
    def span(self) -> Floats:
        return np.maximum(np.asarray(self.solutions.max(axis=0) - self.low, dtype=np.float32), NARROWEST)

    def normalise(self, returns_per_m: Floats) -> Floats:
        """(n, 3) returns per metre -> (n, 3), 0 the worst and 1 the best of the solutions; beyond them beyond these."""
        return (returns_per_m - self.low) / self.span

    def __call__(self, preferences: Floats) -> Floats:
        """(n, 3) preferences -> (n, 3) unit vectors; at each corner the direction of that objective's solution."""
        nodes = unit(self.normalise(self.solutions))
        return unit(preferences @ nodes)


def without_solutions() -> Interpolator:
    """Before any solution is known every preference points where it is: each objective alone is best at itself."""
    return Interpolator(np.eye(SIZE, dtype=np.float32))


def unit(vectors: Floats) -> Floats:
    directions: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), SMALLEST)
    return directions


@dataclass(frozen=True)
class VectorTd3Config:
    """Hyper-parameters of one update. TD3's noise as in `td3.py`; the rest ours where the thesis is silent."""

    gamma: float = 1.0  # section 5.4.1
    learning_rate: float = 5e-4
    tau: float = 0.01
    policy_delay: int = 2
    target_noise: float = 0.2
    target_noise_clip: float = 0.5
    angle_weight: float = 0.1  # alpha, per radian, where rewards are scaled by `reward_scale` of the training


class Imitated(NamedTuple):
    """Actions (n, 2) that the actor is drawn to, and how strongly: weights (n,) of the squared difference. Where the
    critic expects an action to lose more than CORE_LOST of the core reward, it does not draw."""

    actions: Floats
    weights: Floats


class VectorBatch(NamedTuple):
    """n transitions. observations, following (n, 34); actions (n, 2); rewards (n, 4); preferences (n, 3);
    continues (n,): 0 where the episode ended."""

    observations: Floats
    actions: Floats
    rewards: Floats
    following: Floats
    continues: Floats
    preferences: Floats


Imitating = Callable[[VectorBatch], Imitated | None]


class VectorReplayBuffer:
    """A ring of transitions with vectors of rewards and the preferences they were rolled out under."""

    def __init__(self, capacity: int, observation_size: int) -> None:
        self.capacity, self.size, self._next = capacity, 0, 0
        widths = (observation_size, 2, len(REWARDS), observation_size, 0, SIZE)
        shapes = [(capacity, width) if width else (capacity,) for width in widths]
        self.data = VectorBatch(*(np.zeros(shape, dtype=np.float32) for shape in shapes))

    def add(self, transitions: VectorBatch) -> None:
        n = len(transitions.actions)
        rows = (self._next + np.arange(n)) % self.capacity
        for store, new in zip(self.data, transitions, strict=True):
            store[rows] = new
        self._next, self.size = (self._next + n) % self.capacity, min(self.capacity, self.size + n)

    def sample(self, n: int, random: np.random.Generator) -> VectorBatch:
        """n transitions drawn uniformly, with replacement."""
        rows = random.integers(self.size, size=n)
        return VectorBatch(*(part[rows] for part in self.data))


def relabel(batch: VectorBatch, share: float, random: np.random.Generator) -> VectorBatch:
    """Hindsight: the first `share` of the batch as if rolled out under preferences drawn anew. Rewards are vectors, so
    nothing else changes, and what a trajectory returns under the new preference is what it would have returned."""
    count = int(len(batch.actions) * share)
    preferences = batch.preferences.copy()
    preferences[:count] = sample_preferences(count, random)
    return batch._replace(preferences=preferences)


def inputs_of(observations: Floats, preferences: Floats, split: int) -> Floats:
    """What the networks read: task part, preference, lidar."""
    return np.concatenate([observations[:, :split], preferences, observations[:, split:]], axis=1)


def with_core(preferences: Floats) -> Floats:
    """(n, 3) -> (n, 4): the core reward's weight is always 1."""
    return np.concatenate([np.ones((len(preferences), 1), dtype=np.float32), preferences], axis=1)


def twins(critic: Weights) -> tuple[Weights, Weights]:
    half = len(critic) // 2
    return critic[:half], critic[half:]


def act(inputs: Floats, actor: Weights) -> Floats:
    """inputs (n, 37) -> actions (n, 2) in [-1, 1]."""
    return np.tanh(head(inputs, actor).output)


def vector_targets(
    batch: VectorBatch, following: Floats, noise: Floats, actor: Weights, critic: Weights, config: VectorTd3Config
) -> Floats:
    """y (n, 4). following: the networks' inputs of the next states. noise (n, 2): standard normal."""
    clipped = np.clip(noise * np.float32(config.target_noise), -config.target_noise_clip, config.target_noise_clip)
    actions = np.clip(act(following, actor) + clipped, -1, 1)
    joined = np.concatenate([following, actions], axis=1)
    first, second = (head(joined, layers).output for layers in twins(critic))
    weights = with_core(batch.preferences)
    lower = ((second - first) * weights).sum(axis=1, keepdims=True) < 0
    values = np.where(lower, second, first)
    return batch.rewards + np.float32(config.gamma) * batch.continues[:, None] * values


def vector_critic_gradients(
    inputs: Floats, actions: Floats, targets: Floats, critic: Weights, gradients: Weights
) -> float:
    """Write the gradients of sum_k mean |Q_k - y|^2 over both twins; returns that loss."""
    joined = np.concatenate([inputs, actions], axis=1)
    loss = 0.0
    for layers, of_layers in zip(twins(critic), twins(gradients), strict=True):
        through = head(joined, layers)
        error = through.output - targets
        loss += float(np.vdot(error, error)) / len(targets)
        head_backward(error * np.float32(2 / len(targets)), joined, through, layers, of_layers)
    return loss


def angles(values: Floats, preferences: Floats, goal_m: Floats, interpolator: Interpolator) -> tuple[Floats, Floats]:
    """(n,) radians between I(w) and the objectives' values (n, 3), and the gradient (n, 3) at these values.

    goal_m (n,): metres to go, which values are divided by. Nothing is pulled below the worst solution, or where the
    angle is next to none.
    """
    per_m = (1 / np.maximum(goal_m, 1.0)[:, None]).astype(np.float32)
    raw = interpolator.normalise(values * per_m)
    q = np.maximum(raw, 1e-3)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    towards = interpolator(preferences)
    cosine = np.clip((q * towards).sum(axis=1, keepdims=True) / length, -CLIP_COSINE, CLIP_COSINE)
    at_q = -(towards - cosine * q / length) / (length * np.sqrt(1 - cosine * cosine))
    pulled = (raw > 1e-3) & (np.abs(cosine) < CLIP_COSINE)
    gradient = (np.where(pulled, at_q, 0) * per_m / interpolator.span).astype(np.float32)
    return np.arccos(cosine[:, 0]), gradient


def vector_actor_gradients(
    inputs: Floats,
    preferences: Floats,
    goal_m: Floats,
    actor: Weights,
    critic: Weights,
    gradients: Weights,
    interpolator: Interpolator,
    *,
    angle_weight: float,
    imitated: Imitated | None = None,
) -> tuple[float, float]:
    """Write the gradients of the actor's loss; returns mean (1, w) . Q_1 and the mean angle."""
    n = len(inputs)
    through = head(inputs, actor)
    actions = np.tanh(through.output)
    judge, width = twins(critic)[0], inputs.shape[1]
    judged = head(np.concatenate([inputs, actions], axis=1), judge)
    weights = with_core(preferences)
    at_values = -weights / np.float32(n)
    angle, pull = angles(judged.output[:, 1:], preferences, goal_m, interpolator)
    at_values[:, 1:] += np.float32(angle_weight / n) * pull
    at_actions = input_gradient(at_values, judged, judge, slice(width, None))
    if imitated is not None:
        core = head(np.concatenate([inputs, imitated.actions], axis=1), judge).output[:, 0]
        draws = imitated.weights * (core > judged.output[:, 0] - np.float32(CORE_LOST))
        at_actions += draws[:, None] * (actions - imitated.actions) * np.float32(2 / n)
    head_backward(at_actions * (1 - actions * actions), inputs, through, actor, gradients)
    return float((judged.output * weights).sum(axis=1).mean()), float(angle.mean())


class VectorTd3Agent:
    """One actor, twin vector critics, their targets and optimisers, on flat parameters.

    observation_size with task part `split`; all networks have `heads` hidden layers (4 x 256 in the thesis).
    """

    def __init__(
        self, observation_size: int, split: int, heads: tuple[int, ...], config: VectorTd3Config, *, seed: int
    ) -> None:
        self.config, self.split = config, split
        self._random = np.random.default_rng([seed, 54])
        inputs = observation_size + len(REWARDS) - 1
        actor, critic = _layers(inputs, heads, 2), _layers(inputs + 2, heads, len(REWARDS))
        generator = torch.Generator().manual_seed(seed)
        self.actor, self.critic = Parameters(actor, trainable=True), Parameters(2 * critic, trainable=True)
        self.actor_target, self.critic_target = (Parameters(p, trainable=False) for p in (actor, 2 * critic))
        for network, target in ((self.actor, self.actor_target), (self.critic, self.critic_target)):
            network.initialise(generator)
            target.flat.copy_(network.flat)
        self.actor_optimiser = Adam(self.actor.flat.numel(), config.learning_rate)
        self.critic_optimiser = Adam(self.critic.flat.numel(), config.learning_rate)
        self.interpolator = without_solutions()
        self.updates = 0
        self.losses: dict[str, float] = {}
        """Of the last update, by name, for curves; nothing is decided by them."""

    def set_learning_rate(self, learning_rate: float) -> None:
        self.actor_optimiser.learning_rate = self.critic_optimiser.learning_rate = learning_rate

    def act(self, observations: Floats, preferences: Floats) -> Floats:
        """observations (n, obs), preferences (n, 3) -> actions (n, 2) in [-1, 1], without exploration."""
        return act(inputs_of(observations, preferences, self.split), self.actor.weights)

    def update(self, batch: VectorBatch, scale_m: float, imitating: Imitating | None = None) -> None:
        """One critic step; every `policy_delay`-th time one actor step and one of the targets.

        scale_m: metres that the goal distance is observed in. imitating: what the actor is drawn to, asked only when
        it steps.
        """
        inputs, following = (
            inputs_of(seen, batch.preferences, self.split) for seen in (batch.observations, batch.following)
        )
        noise = self._random.standard_normal(batch.actions.shape, dtype=np.float32)
        targets = vector_targets(
            batch, following, noise, self.actor_target.weights, self.critic_target.weights, self.config
        )
        self.losses["critic_loss"] = vector_critic_gradients(
            inputs, batch.actions, targets, self.critic.weights, self.critic.gradients
        )
        _step(self.critic_optimiser, self.critic)
        self.updates += 1
        if self.updates % self.config.policy_delay:
            return
        self.losses["value"], self.losses["angle"] = vector_actor_gradients(
            inputs,
            batch.preferences,
            batch.observations[:, 0] * np.float32(scale_m),
            self.actor.weights,
            self.critic.weights,
            self.actor.gradients,
            self.interpolator,
            angle_weight=self.config.angle_weight,
            imitated=None if imitating is None else imitating(batch),
        )
        _step(self.actor_optimiser, self.actor)
        tau = np.float32(self.config.tau)
        move_towards(self.actor_target.flat.numpy(), self.actor.flat.numpy(), tau)
        move_towards(self.critic_target.flat.numpy(), self.critic.flat.numpy(), tau)


def _layers(inputs: int, heads: tuple[int, ...], outputs: int) -> list[tuple[int, int]]:
    sizes = (inputs, *heads, outputs)
    return list(pairwise(sizes))


def _step(optimiser: Adam, parameters: Parameters) -> None:
    if parameters.grad is None:
        raise ValueError("parameters: made without gradients, so there is nothing to step along")
    optimiser.step(parameters.flat.numpy(), parameters.grad.numpy())
