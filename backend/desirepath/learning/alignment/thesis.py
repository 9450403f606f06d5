"""The thesis's alignment (6.4.5): relabel the replay buffer, learn from it alone, keep the best epoch.

    r* = lambda R + (1 - lambda) r                                                                     (equation 6.5)

R: the reward model's output, normalised over the buffer. The training itself is `relabelling.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch

from desirepath.learning.alignment.relabelling import RelabellingConfig, model_outputs
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.td3.td3 import Batch

UPDATES_PER_EPOCH = 10_000


@dataclass(frozen=True)
class ThesisConfig(RelabellingConfig):
    """The thesis's settings, unless marked ours; the rest in `RelabellingConfig`. One checkpoint per epoch."""

    recipe: ClassVar[str] = "thesis"
    goes_back: ClassVar[bool] = False

    updates: int = 3 * UPDATES_PER_EPOCH
    checkpoints: int = 3
    learning_rate: float = 3e-4  # ours, constant
    final_learning_rate: float = 3e-4
    online_share: float = 0.0  # no new interaction
    reward_weight: float = 0.06  # lambda

    def reward(self, model: RewardModel, replay: Batch, base: Policy) -> ThesisReward:
        return ThesisReward(model, self.reward_weight, replay)

    def choose(self, success_rates: Sequence[float], base_success: float) -> int:
        """The epoch with most success."""
        return int(np.argmax(success_rates))


def thesis_config(*, seed: int = 0, epochs: int = 3) -> ThesisConfig:
    """The thesis's recipe with that many epochs of 10,000 updates."""
    return ThesisConfig(seed=seed, updates=UPDATES_PER_EPOCH * epochs, checkpoints=epochs)


class ThesisReward:
    """r* of the thesis. weight: lambda."""

    def __init__(self, model: RewardModel, weight: float, replay: Batch) -> None:
        self._model, self.weight = model, weight
        raw = model_outputs(model, replay)
        self._mean, self._std = float(raw.mean()), float(raw.std()) + 1e-6

    def preference(self, batch: Batch) -> torch.Tensor:
        """(R - mean) / std of every transition, (n,)."""
        return torch.from_numpy((model_outputs(self._model, batch) - self._mean) / self._std)

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor:
        """Equation 6.5."""
        return self.weight * preference + (1 - self.weight) * core

    def adapt(self, success: float, base_success: float) -> None:
        """lambda stays."""
