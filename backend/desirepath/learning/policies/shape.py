"""The sizes of actor and critic (chapters 6 and 8), without torch: a server that only rolls out does not import it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from desirepath.simulation.setups import Setup

ACTION_SIZE = 2
THESIS_HEADS = (400, 300)  # ch. 6.3.2.1: 128 x 400 x 300 x (1, 2)
FAST_HEADS = (128, 128)  # ours: the fast default where the card shows equal success
EXPLAINED_HEADS = (256, 128, 64)  # ch. 8.3.2: one network without extractors
EXTRACTOR_WIDTH = 64  # ch. 6.3.2.1


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of the actor and the critic of one setup. extractor: 0 where one network reads the whole observation."""

    task_inputs: int
    lidar_inputs: int
    extractor: int = EXTRACTOR_WIDTH
    heads: tuple[int, ...] = FAST_HEADS

    @classmethod
    def of(cls, setup: Setup, heads: tuple[int, ...] = FAST_HEADS) -> NetworkShape:
        """The shape that reads this setup's observation."""
        return cls(setup.polar_size, setup.surroundings_size, EXTRACTOR_WIDTH if setup.extractors else 0, heads)

    @property
    def observation_size(self) -> int:
        return self.task_inputs + self.lidar_inputs

    def _extractors(self) -> list[tuple[int, int]]:
        width = self.extractor
        return [(self.task_inputs, width), (width, width), (self.lidar_inputs, width), (width, width)] if width else []

    def _head(self, inputs: int, outputs: int) -> list[tuple[int, int]]:
        return list(pairwise((inputs, *self.heads, outputs)))

    @property
    def _features(self) -> int:
        return 2 * self.extractor or self.observation_size

    def actor_layers(self) -> list[tuple[int, int]]:
        """(inputs, outputs) of the actor's linear layers: task, task, lidar, lidar of extractors, then the head."""
        return self._extractors() + self._head(self._features, ACTION_SIZE)

    def critic_layers(self, n_heads: int = 2) -> list[tuple[int, int]]:
        """The same for the critic: the action joins after the extractors, then `n_heads` heads with one output."""
        return self._extractors() + n_heads * self._head(self._features + ACTION_SIZE, 1)

    def as_dict(self) -> dict[str, Any]:
        return {
            "task_inputs": self.task_inputs,
            "lidar_inputs": self.lidar_inputs,
            "extractor": self.extractor,
            "heads": list(self.heads),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> NetworkShape:
        return cls(data["task_inputs"], data["lidar_inputs"], data["extractor"], tuple(data["heads"]))
