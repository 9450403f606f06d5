"""The replay buffer and the interaction that fills it. What is learned from it lives in the algorithms' files."""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.policies.policy import Policy
from desirepath.learning.td3.td3 import Batch
from desirepath.simulation.acting import ActFunction
from desirepath.simulation.fast import FastEngine, make_engine
from desirepath.simulation.setups import get_setup

Floats = NDArray[np.float32]


class ReplayBuffer:
    """A ring of transitions, oldest overwritten first."""

    def __init__(self, capacity: int, observation_size: int) -> None:
        self.capacity, self.size, self._next = capacity, 0, 0
        self.data = Batch(
            torch.zeros(capacity, observation_size),
            torch.zeros(capacity, 2),
            torch.zeros(capacity),
            torch.zeros(capacity, observation_size),
            torch.zeros(capacity),
        )
        self._arrays = tuple(part.numpy() for part in self.data)

    def add(
        self,
        observations: Floats,
        actions: Floats,
        rewards: Floats,
        next_observations: Floats,
        dones: NDArray[np.bool_],
    ) -> None:
        """Append n transitions (shapes as in `Batch`, dones instead of continues)."""
        self._append(observations, actions, rewards, next_observations, (~dones).astype(np.float32))

    def add_batch(self, batch: Batch) -> None:
        """Append transitions that already are a batch."""
        self._append(*(part.numpy() for part in batch))

    def next_rows(self, n: int) -> NDArray[np.int64]:
        """(n,) the rows that the next n transitions go to."""
        return (self._next + np.arange(n)) % self.capacity

    def _append(self, *parts: Floats) -> None:
        """Append rows, the parts in the order of `Batch`."""
        n = len(parts[0])
        rows = self.next_rows(n)
        for store, new in zip(self._arrays, parts, strict=True):
            store[rows] = new
        self._next = (self._next + n) % self.capacity
        self.size = min(self.capacity, self.size + n)

    def filled(self) -> Batch:
        """Everything stored so far, as views: writing to `rewards` relabels the buffer in place."""
        return Batch(*(part[: self.size] for part in self.data))

    def sample(self, n: int, generator: torch.Generator) -> Batch:
        """n transitions drawn uniformly, with replacement."""
        return self.transitions(self.draw_rows(n, generator))

    def draw_rows(self, n: int, generator: torch.Generator) -> torch.Tensor:
        """(n,) rows drawn uniformly, with replacement."""
        return torch.randint(self.size, (n,), generator=generator)

    def transitions(self, rows: torch.Tensor) -> Batch:
        """What these rows (n,) hold."""
        return Batch(*(part.index_select(0, rows) for part in self.data))

    def digest(self) -> str:
        """sha256 of the stored transitions; the lineage of whatever is trained on a regenerated buffer."""
        digest = hashlib.sha256()
        for part in self.filled():
            digest.update(np.ascontiguousarray(part.numpy()).tobytes())
        return digest.hexdigest()


def concatenate(first: Batch, second: Batch) -> Batch:
    """One batch of both, first rows first."""
    return Batch(*(torch.cat([a, b]) for a, b in zip(first, second, strict=True)))


class ReplayCollector:
    """Steps a fast engine with a policy plus Gaussian noise; each environment keeps its own noise level."""

    def __init__(self, engine: FastEngine, *, noise: tuple[float, float], seed: int) -> None:
        """noise: smallest and largest standard deviation (action units), spread geometrically over environments."""
        self.engine = engine
        self.n_envs = len(engine.rewards)
        self._random = np.random.default_rng(seed)
        self._noise = np.geomspace(*noise, self.n_envs).astype(np.float32)[:, None]

    def step(self, act: ActFunction | None, buffer: ReplayBuffer) -> None:
        """One step of every environment into the buffer; `act=None` acts uniformly at random."""
        engine = self.engine
        observations = engine.observations.copy()
        if act is None:
            actions = self._random.uniform(-1, 1, (self.n_envs, 2)).astype(np.float32)
        else:
            jitter = self._random.standard_normal((self.n_envs, 2), dtype=np.float32) * self._noise
            actions = np.clip(act(observations) + jitter, -1, 1)
        engine.step(actions)
        buffer.add(observations, actions, engine.rewards, engine.next_observations, engine.dones)


def collect(
    policy: Policy, transitions: int, *, noise: tuple[float, float], seed: int, n_envs: int = 256
) -> ReplayBuffer:
    """Regenerate a replay buffer from policy and seed: that many transitions (rounded up), core reward, in seconds."""
    setup = get_setup(policy.setup)
    steps = -(-transitions // n_envs)
    buffer = ReplayBuffer(steps * n_envs, setup.observation_size)
    collector = ReplayCollector(make_engine(setup, n_envs, seed=seed), noise=noise, seed=seed)
    for _ in range(steps):
        collector.step(policy.act, buffer)
    return buffer
