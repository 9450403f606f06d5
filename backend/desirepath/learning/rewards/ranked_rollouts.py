"""A reward network R(s, a) in [0, 1], trained on rollouts of which some are ranked above others (D-REX, Brown et al.
2020; section 5.3.3). Its training is the laboratory's (`training/adaptable/ranking.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.rewards.reward_model import Reduction, RewardModel
from desirepath.learning.td3.backprop import head

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RankedRewardModel(RewardModel):
    """layers: weight, bias, ... of the network (s, a) -> logit. low, high: of its sigmoid, what counts as 0 and as 1:
    means over random actions and over the clone's own, since Bradley-Terry knows differences only (ours).
    """

    kind: ClassVar[str] = "ranked_rollouts"

    setup: str
    layers: tuple[Floats, ...]
    low: float = 0.0
    high: float = 1.0
    reduction: Reduction = "mean"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats | None = None) -> Floats:
        del next_observations
        seen = np.concatenate([observations, actions], axis=1)
        logits = head(seen, list(zip(self.layers[0::2], self.layers[1::2], strict=True))).output[:, 0]
        found: Floats = np.clip((sigmoid(logits) - self.low) / (self.high - self.low), 0, 1).astype(np.float32)
        return found

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        meta: dict[str, object] = {"kind": self.kind, "setup": self.setup, "low": self.low, "high": self.high}
        return meta, {f"layer_{k:02d}": array for k, array in enumerate(self.layers)}

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> RankedRewardModel:
        return cls(meta["setup"], tuple(arrays[n] for n in sorted(arrays)), float(meta["low"]), float(meta["high"]))


def sigmoid(logits: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -50, 50))))


MODEL = RankedRewardModel
