"""What MO-TD3-HER replays: transitions with the vector of rewards, so that hindsight may judge them by any preference.

Where they come from lives in `training.py`, what is learned from them in `vector_td3.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.adaptable.objectives import REWARDS, SIZE, sample_preferences
from desirepath_experiments.training.adaptable.vector_td3 import VectorBatch

Floats = NDArray[np.float32]


class VectorTransitions(NamedTuple):
    """What the buffer keeps of n transitions, as in `VectorBatch`."""

    observations: Floats
    actions: Floats
    rewards: Floats
    following: Floats
    continues: Floats
    preferences: Floats


class VectorReplayBuffer:
    """A ring of transitions with vectors of rewards and the preferences they were rolled out under."""

    def __init__(self, capacity: int, observation_size: int) -> None:
        self.capacity, self.size, self._next = capacity, 0, 0
        widths = (observation_size, 2, len(REWARDS), observation_size, 0, SIZE)
        shapes = [(capacity, width) if width else (capacity,) for width in widths]
        self.data = VectorTransitions(*(np.zeros(shape, dtype=np.float32) for shape in shapes))

    def add(self, transitions: VectorTransitions) -> None:
        n = len(transitions.actions)
        rows = (self._next + np.arange(n)) % self.capacity
        for store, new in zip(self.data, transitions, strict=True):
            store[rows] = new
        self._next, self.size = (self._next + n) % self.capacity, min(self.capacity, self.size + n)

    def sample(self, n: int, random: np.random.Generator) -> VectorBatch:
        """n transitions drawn uniformly, with replacement."""
        rows = random.integers(self.size, size=n)
        return VectorBatch(*(part[rows] for part in self.data))


def relabelled(batch: VectorBatch, share: float, random: np.random.Generator) -> VectorBatch:
    """Hindsight: the first `share` of the batch as if rolled out under preferences drawn anew. Rewards are vectors, so
    nothing else changes, and what a trajectory returns under the new preference is what it would have returned."""
    count = int(len(batch.actions) * share)
    preferences = batch.preferences.copy()
    preferences[:count] = sample_preferences(count, random)
    return batch._replace(preferences=preferences)
