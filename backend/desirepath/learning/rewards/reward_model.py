"""What a learned reward is, whatever its kind. The Bradley-Terry loss (equation 6.4) stands here in NumPy, as answers
that were held out are scored by it and `linear` is fitted; networks have it in torch (`grep bradley_terry`).

Each kind has a file of its own, found by looking, or a module of another package by an entry point of
`desirepath.reward_models`. `held_out.py` says how well they predict, `auto.py`
which kind some answers deserve.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.kinds import MODELS
from desirepath.npz import Arrays
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Trajectory, require_steps

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Reduction = Literal["sum", "mean"]


class RewardModel(StoredArrays):
    """One interface. A kind gives the reward of steps and is stored; what it knows better than the sum of its steps,
    how a whole trajectory is judged or how sure an answer is, it overrides.

    kind: its name in stored files, which is its module's.
    """

    noun, file_format, raises = "reward model", "desirepath-reward-model-1", LearningError
    kind: ClassVar[str]
    setup: str
    reduction: Reduction

    @abstractmethod
    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        """Predicted reward of n steps: (n,) float32."""

    def trajectory_reward(self, trajectory: Trajectory) -> float:
        """What the model thinks of a whole trajectory; of two, the one with more is predicted to be chosen.

        Sum or mean (the model's reduction) of the predicted rewards, unless the kind judges otherwise.
        """
        require_steps([trajectory])
        steps = self.rewards(trajectory.observations, trajectory.actions, trajectory.next_observations)
        return float(steps.sum() if self.reduction == "sum" else steps.mean())

    def log_odds(self, a: Trajectory, b: Trajectory) -> float:
        """log of how much likelier A is chosen than B: the difference of rewards (equation 6.4), unless the kind knows
        how sure it is."""
        return self.trajectory_reward(a) - self.trajectory_reward(b)

    def importance(self) -> dict[str, float]:
        """Share of each thing that the answers were about, by name; empty where the kind cannot say."""
        return {}

    @abstractmethod
    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        """JSON-ready description, `kind` among it, and weights, for storage."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> Self:
        """Back from `to_arrays`."""

    def to_parts(self) -> tuple[dict[str, object], dict[str, Floats]]:
        return self.to_arrays()

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> RewardModel:
        """A model of whatever kind the header names."""
        if header.get("kind") not in MODELS:
            raise LearningError(f"kind {header.get('kind')!r} is unknown; known are {', '.join(MODELS)}")
        kind: type[RewardModel] = MODELS[header["kind"]]
        return kind.from_arrays(header, arrays)


Fit = Callable[[Sequence[Preference]], RewardModel]
"""How a kind of model is made of answers."""


@dataclass(frozen=True)
class FitSettings:
    """What a job asks of a fit. left_right_symmetry: nobody prefers a side; particles: of a posterior."""

    reduction: Reduction = "sum"
    seed: int = 0
    left_right_symmetry: bool = False
    particles: int = PosteriorConfig.particles


@dataclass(frozen=True)
class Fitting:
    """How a kind is fitted to answers. takes_long: too long for many held-out folds while somebody may be waiting."""

    fit: Callable[[Sequence[Preference], FitSettings], RewardModel]
    takes_long: bool = True


def bradley_terry_loss(advantages: Doubles) -> float:
    """Equation 6.4 as cross-entropy: sum of -log P[chosen > rejected], P = 1 / (1 + exp(-(R_chosen - R_rejected)))."""
    return float(np.logaddexp(0.0, -advantages).sum())


def bradley_terry_gradient(advantages: Doubles) -> Doubles:
    """d loss / d advantage, one per pair."""
    gradient: Doubles = -1.0 / (1.0 + np.exp(np.clip(advantages, -500, 500)))
    return gradient
