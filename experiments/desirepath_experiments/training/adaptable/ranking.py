"""D-REX (Brown et al. 2020; section 5.3.3): demonstrations have no ranking, so a clone of them rolls out with noise.

The less noise, the better: pairs of these rollouts train the product's `RankedRewardModel` by Bradley-Terry. What is
cloned, and how: `cloning.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.policies.networks import Parameters
from desirepath.learning.rewards.ranked_rollouts import RankedRewardModel, sigmoid
from desirepath.learning.td3.backprop import Adam, head, head_backward
from desirepath.simulation.acting import ActFunction, EpisodeActs, EpisodicPolicy, Rows
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
DEMONSTRATED_HEADS = (256, 256, 256, 256)  # section 5.3.2.2: four layers of 256, of every network
LEVELS = (0.0, 0.05, 0.1, 0.15, 0.2)  # section 5.3.3: 0 ... 0.2
HELD_STEPS = 5  # ours, 1 s: single random steps average out, and a clone that finds back never loses the way's shape


@dataclass(frozen=True)
class RankedRollouts:
    """Rollouts with the noise that each had. levels (n,): the share of steps that acted at random."""

    trajectories: list[Trajectory]
    levels: Floats

    def __len__(self) -> int:
        return len(self.trajectories)


class NoisyPolicy(EpisodicPolicy):
    """Acts as another policy but for a share of steps, `HELD_STEPS` at a time, with one random action kept up."""

    def __init__(self, act: ActFunction, share: float, random: np.random.Generator) -> None:
        self._act, self._random = act, random
        self._begins = share / (HELD_STEPS * (1 - share))

    def act(self, observations: Floats) -> Floats:
        return self._act(observations)

    def begin(self, episodes: int) -> EpisodeActs:
        left = np.zeros(episodes, dtype=np.int64)
        kept = np.zeros((episodes, 2), dtype=np.float32)

        def acts(observations: Floats, rows: Rows) -> Floats:
            begins = (left[rows] == 0) & (self._random.random(len(rows)) < self._begins)
            drawn = self._random.uniform(-1, 1, (len(rows), 2)).astype(np.float32)
            left[rows[begins]], kept[rows[begins]] = HELD_STEPS, drawn[begins]
            noisy = left[rows] > 0
            left[rows[noisy]] -= 1
            return np.where(noisy[:, None], kept[rows], self._act(observations)).astype(np.float32)

        return acts


def rank_by_noise(
    act: ActFunction, scenes: Sequence[Scene], *, seed: int, levels: Sequence[float] = LEVELS
) -> RankedRollouts:
    """One rollout of each level in every scene: that share of its steps acts uniformly at random."""
    setup, trajectories, had = get_setup(scenes[0].setup), list[Trajectory](), list[float]()
    for number, level in enumerate(levels):
        random = np.random.default_rng([seed, 52, number])
        trajectories += rollout(setup, NoisyPolicy(act, level, random), scenes)
        had += [level] * len(scenes)
    return RankedRollouts(trajectories, np.array(had, dtype=np.float32))


@dataclass(frozen=True)
class RankedConfig:
    """How the reward network is trained. Network and loss: section 5.3.3; the rest ours.

    Snippets of equal length are compared, as D-REX's authors do: else the longer rollout of a pair has more to sum.
    """

    seed: int = 0
    updates: int = 2_500
    pairs: int = 24  # per update
    snippet: int = 25  # steps; of shorter rollouts all
    learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    heads: tuple[int, ...] = DEMONSTRATED_HEADS


def fit_ranked(ranked: RankedRollouts, config: RankedConfig) -> RankedRewardModel:
    """Least sum of -log P[less noisy > noisier], P = 1 / (1 + exp(R(noisier) - R(less noisy))), R: sum over a snippet.

    Raises ValueError where all rollouts had the same noise.
    """
    if len(set(ranked.levels.tolist())) < 2:
        raise ValueError("levels: all rollouts had the same noise, so none is ranked above another")
    setup = get_setup(ranked.trajectories[0].scene.setup)
    steps = [np.concatenate([one.observations, one.actions], axis=1) for one in ranked.trajectories]
    inputs = setup.observation_size + 2
    sizes = (inputs, *config.heads, 1)
    network = Parameters(list(pairwise(sizes)), trainable=True)
    network.initialise(torch.Generator().manual_seed(config.seed))
    assert network.grad is not None  # noqa: S101 - made trainable
    optimiser = Adam(network.flat.numel(), config.learning_rate)
    random = np.random.default_rng([config.seed, 53])
    for update in range(config.updates):
        optimiser.learning_rate = config.learning_rate * (1 - 0.9 * update / config.updates)
        better, worse = draw_pairs(ranked.levels, config.pairs, random)
        parts = [_snippet(steps[k], config.snippet, random) for pair in zip(better, worse, strict=True) for k in pair]
        of = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        through = head(seen := np.concatenate(parts), network.weights)
        rewards = sigmoid(through.output[:, 0])
        sums: NDArray[Any] = np.bincount(of, rewards, minlength=len(parts))
        wrong = sigmoid(-(sums[0::2] - sums[1::2])) / config.pairs  # minus the gradient of the loss
        at_sums = np.stack([-wrong, wrong], axis=1).ravel()
        at_logits = (at_sums[of] * rewards * (1 - rewards)).astype(np.float32)[:, None]
        head_backward(at_logits, seen, through, network.weights, network.gradients)
        flat, gradient = network.flat.numpy(), network.grad.numpy()
        gradient += np.float32(config.weight_decay) * flat
        optimiser.step(flat, gradient)
    raw = RankedRewardModel(setup.name, tuple(network.to_arrays()))
    least = [one for one, level in zip(ranked.trajectories, ranked.levels, strict=True) if level == ranked.levels.min()]
    seen_by_clone = np.concatenate([one.observations for one in least])
    by_clone = np.concatenate([one.actions for one in least])
    by_chance = random.uniform(-1, 1, by_clone.shape).astype(np.float32)
    low, high = (float(raw.rewards(seen_by_clone, actions).mean()) for actions in (by_chance, by_clone))
    if high - low < 1e-3:
        raise ValueError(
            f"reward network tells the clone ({high:.3f}) from chance ({low:.3f}) by nothing; train longer"
        )
    return RankedRewardModel(setup.name, raw.layers, low, high)


def draw_pairs(levels: Floats, n: int, random: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n,) and (n,) rollouts of which the first had less noise than the second, drawn uniformly among such pairs."""
    first, second = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    while len(first) < n:
        a, b = random.integers(len(levels), size=(2, 2 * n))
        apart = levels[a] != levels[b]
        a, b = a[apart], b[apart]
        swap = levels[a] > levels[b]
        first = np.concatenate([first, np.where(swap, b, a)])
        second = np.concatenate([second, np.where(swap, a, b)])
    return first[:n], second[:n]


def _snippet(steps: Floats, length: int, random: np.random.Generator) -> Floats:
    begin = int(random.integers(max(1, len(steps) - length + 1)))
    return steps[begin : begin + length]
