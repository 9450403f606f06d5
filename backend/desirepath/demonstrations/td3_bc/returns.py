"""Rewards of several steps at once (n-step returns), where episodes are slow and rewards rare. Ours, not the thesis's.

A transition leads from s_t over n steps to s_(t+n): its reward is sum_i gamma^i r_(t+i), and its `continues`, which the
learner multiplies by gamma, is gamma^(n-1); at an episode's end fewer steps, and 0. With n = 1 nothing is changed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.td3.replay import Floats, ReplayBuffer
from desirepath.simulation.trajectory import Trajectory


def returns_along(
    trajectory: Trajectory, rewards: NDArray[np.floating], steps: int, gamma: float
) -> tuple[Floats, Floats, Floats]:
    """Of every step of a finished trajectory: (T,) rewards, (T, obs) observations led to, (T,) continues."""
    length = len(rewards)
    first = np.arange(length)
    last = np.minimum(first + steps, length) - 1
    discounted = np.zeros(length)
    for ahead in range(min(steps, length)):
        discounted[: length - ahead] += rewards[ahead:] * np.float64(gamma**ahead)
    continues = np.where(trajectory.dones[last], 0.0, gamma ** (last - first))
    return discounted.astype(np.float32), trajectory.next_observations[last], continues.astype(np.float32)


class ReturnsBuffer(ReplayBuffer):
    """A replay buffer that is filled by one step of the same environments at a time and stores them `steps` long."""

    def __init__(self, capacity: int, observation_size: int, *, n_envs: int, steps: int, gamma: float) -> None:
        super().__init__(capacity, observation_size)
        self._steps, self._gamma = steps, gamma
        self._begun_at = np.zeros((steps, n_envs, observation_size), dtype=np.float32)
        self._begun_with = np.zeros((steps, n_envs, 2), dtype=np.float32)
        self._sums = np.zeros((steps, n_envs), dtype=np.float32)
        self._pending = np.zeros(n_envs, dtype=np.int64)  # begun and not stored yet, per environment
        self._time = 0

    def add(
        self,
        observations: Floats,
        actions: Floats,
        rewards: Floats,
        next_observations: Floats,
        dones: NDArray[np.bool_],
    ) -> None:
        """Take one step of every environment, in their order; store what is `steps` long or has ended."""
        now = self._time % self._steps
        self._begun_at[now], self._begun_with[now], self._sums[now] = observations, actions, 0.0
        self._pending += 1
        for ago in range(self._steps):
            place = (self._time - ago) % self._steps
            begun = self._pending > ago
            self._sums[place, begun] += np.float32(self._gamma**ago) * rewards[begun]
            whole = begun if ago == self._steps - 1 else begun & dones
            continues = np.where(dones[whole], 0.0, self._gamma**ago).astype(np.float32)
            self._append(
                self._begun_at[place, whole],
                self._begun_with[place, whole],
                self._sums[place, whole],
                next_observations[whole],
                continues,
            )
        self._pending = np.where(dones, 0, np.minimum(self._pending, self._steps - 1))
        self._time += 1
