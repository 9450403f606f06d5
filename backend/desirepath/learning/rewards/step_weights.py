"""The reward that answers speak for where the nine objectives do not say it: weights of a step basis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from desirepath.learning.measures.step_basis import StepBasis
from desirepath.learning.preferences.preferences import Preference, usable
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.rewards.reward_model import Doubles, Floats, Reduction, RewardModel
from desirepath.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class StepWeightsRewardModel(RewardModel):
    """weights (K,): in log odds between two trajectories, of the mean over each one's steps."""

    kind: ClassVar[str] = "step_weights"

    setup: str
    basis: StepBasis
    weights: Floats
    reduction: Reduction = "mean"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        found: Floats = self.basis.of_steps(observations, actions, next_observations) @ self.weights
        return found

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        """(n,) of whole trajectories."""
        found: Doubles = self.basis.means(trajectories) @ self.weights.astype(np.float64)
        return found

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        meta: dict[str, object] = {"kind": self.kind, "setup": self.setup}
        return meta, {"weights": self.weights, **{f"basis_{k}": v for k, v in self.basis.to_arrays().items()}}

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> Self:
        of_basis = {key.removeprefix("basis_"): part for key, part in arrays.items() if key.startswith("basis_")}
        return cls(meta["setup"], StepBasis.from_arrays(meta["setup"], of_basis), arrays["weights"])


def step_posterior(
    basis: StepBasis, pairs: Sequence[tuple[Trajectory, Trajectory]], chosen: Sequence[bool]
) -> StepPosterior:
    """What answers to pairs say; chosen: whether each pair's first was. Raises LearningError if the numbers differ."""
    return StepPosterior.from_answers(step_differences(basis, pairs), chosen)


def step_differences(basis: StepBasis, pairs: Sequence[tuple[Trajectory, Trajectory]]) -> Doubles:
    """(n, K) first minus second of each pair's means; a typical pair of the basis has length 1."""
    means = basis.means([one for pair in pairs for one in pair])
    return basis.between(means[0::2], means[1::2])


def step_posterior_of(preferences: Sequence[Preference], basis: StepBasis) -> StepPosterior:
    """What preferences say. Raises LearningError without answers about two different trajectories of one setup."""
    _, kept = usable(preferences)
    return step_posterior(basis, [(one.chosen, one.rejected) for one in kept], [True] * len(kept))


MODEL = StepWeightsRewardModel
