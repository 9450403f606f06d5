"""The free-form reward model: several of the thesis's networks (`mlp.py`) together, for a study's hundreds of answers.

Ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.policies.mirroring import ACTION_SIGNS, mirror_of
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.mlp import MlpConfig, MlpRewardModel, fit_mlp
from desirepath.learning.rewards.reward_model import Reduction, RewardModel
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RewardEnsembleConfig:
    """Ours: the thesis trains one network, one pair per step, for ten epochs; hundreds of answers bear more."""

    members: int = 3
    seed: int = 0
    member: MlpConfig = field(default_factory=lambda: MlpConfig(epochs=20, learning_rate=1e-3, pairs_per_step=16))


@dataclass(frozen=True)
class MlpEnsembleRewardModel(RewardModel):
    """Networks that were trained on the same answers from different starts."""

    kind: ClassVar[str] = "mlp_ensemble"

    members: tuple[MlpRewardModel, ...]
    setup: str = field(init=False)
    reduction: Reduction = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "setup", self.members[0].setup)
        object.__setattr__(self, "reduction", self.members[0].reduction)

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        mean: Floats = np.mean(
            [member.rewards(observations, actions, next_observations) for member in self.members], axis=0
        ).astype(np.float32)
        return mean

    def log_odds(self, a: Trajectory, b: Trajectory) -> float:
        """Of the members' mean probability that A is chosen (equation 6.4, outputs as they were trained)."""
        choice_probabilities = [1 / (1 + math.exp(-_within(m.raw_reward(a) - m.raw_reward(b)))) for m in self.members]
        probability = float(np.clip(np.mean(choice_probabilities), 1e-6, 1 - 1e-6))
        return math.log(probability / (1 - probability))

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        metas: list[dict[str, object]] = []
        arrays: dict[str, Floats] = {}
        for k, member in enumerate(self.members):
            meta, of_member = member.to_arrays()
            metas.append(meta)
            arrays |= {f"member_{k:02d}_{name}": array for name, array in of_member.items()}
        return {"kind": self.kind, "setup": self.setup, "members": metas}, arrays

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> MlpEnsembleRewardModel:
        members = []
        for k, of_member in enumerate(meta["members"]):
            prefix = f"member_{k:02d}_"
            own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
            members.append(MlpRewardModel.from_arrays(of_member, own))
        return cls(tuple(members))


def _within(advantage: float) -> float:
    return max(-30.0, min(30.0, advantage))


def fit_mlp_ensemble(
    preferences: Sequence[Preference], config: RewardEnsembleConfig | None = None, *, left_right_symmetry: bool = False
) -> MlpEnsembleRewardModel:
    """left_right_symmetry: every answer counts in the mirrored world, too; only where the protocol declares that.

    Raises LearningError for fewer than two usable answers, SetupError for mixed setups.
    """
    config = config or RewardEnsembleConfig()
    seeds = [config.seed * 100 + k for k in range(config.members)]
    if left_right_symmetry:
        preferences = [*preferences, *map(_mirrored, preferences)]
    return MlpEnsembleRewardModel(tuple(fit_mlp(preferences, replace(config.member, seed=seed)) for seed in seeds))


def _mirrored(preference: Preference) -> Preference:
    """The answer as the networks see it with left and right exchanged; they read neither poses nor scene."""
    order, signs = mirror_of(get_setup(preference.setup))

    def mirrored(trajectory: Trajectory) -> Trajectory:
        seen, then = (part[:, order] * signs for part in (trajectory.observations, trajectory.next_observations))
        return replace(trajectory, observations=seen, next_observations=then, actions=trajectory.actions * ACTION_SIGNS)

    return replace(preference, chosen=mirrored(preference.chosen), rejected=mirrored(preference.rejected))


MODEL = MlpEnsembleRewardModel
