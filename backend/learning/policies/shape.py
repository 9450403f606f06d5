"""The sizes of actor and critic (chapter 6), without torch: a server that only rolls out does not import it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from backend.simulation.setups import Setup

ACTION_SIZE = 2
THESIS_HEADS = (400, 300)  # ch. 6.3.2.1: 128 x 400 x 300 x (1, 2)
FAST_HEADS = (128, 128)  # ours: the fast default where the card shows equal success
EXTRACTOR_WIDTH = 64  # ch. 6.3.2.1


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of the actor and the critic of one setup."""

    task_inputs: int
    lidar_inputs: int
    extractor: int = EXTRACTOR_WIDTH
    heads: tuple[int, int] = FAST_HEADS

    @classmethod
    def of(cls, setup: Setup, heads: tuple[int, int] = FAST_HEADS) -> NetworkShape:
        """The shape that reads this setup's observation."""
        return cls(task_inputs=setup.polar_size, lidar_inputs=setup.surroundings_size, heads=heads)

    @property
    def observation_size(self) -> int:
        return self.task_inputs + self.lidar_inputs

    def _extractors(self) -> list[tuple[int, int]]:
        width = self.extractor
        return [(self.task_inputs, width), (width, width), (self.lidar_inputs, width), (width, width)]

    def _head(self, inputs: int, outputs: int) -> list[tuple[int, int]]:
        return [(inputs, self.heads[0]), (self.heads[0], self.heads[1]), (self.heads[1], outputs)]

    def actor_layers(self) -> list[tuple[int, int]]:
        """(inputs, outputs) of the actor's seven linear layers: task, task, lidar, lidar, three of the head."""
        return self._extractors() + self._head(2 * self.extractor, ACTION_SIZE)

    def critic_layers(self, n_heads: int = 2) -> list[tuple[int, int]]:
        """The same for the critic: the action joins after the extractors, then `n_heads` heads with one output."""
        return self._extractors() + n_heads * self._head(2 * self.extractor + ACTION_SIZE, 1)

    def as_dict(self) -> dict[str, Any]:
        return {
            "task_inputs": self.task_inputs,
            "lidar_inputs": self.lidar_inputs,
            "extractor": self.extractor,
            "heads": list(self.heads),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> NetworkShape:
        return cls(data["task_inputs"], data["lidar_inputs"], data["extractor"], (data["heads"][0], data["heads"][1]))
