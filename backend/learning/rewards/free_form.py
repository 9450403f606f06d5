"""The free-form reward model, several neural networks together, and which kind of model some answers deserve.

One network lives in `reward_mlp.py`, the vocabulary's model in `reward_weights.py`. A few answers say no more than the
vocabulary holds; a study's hundreds may say something it has no word for. Ours (issue 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.learning.policies.mirroring import ACTION_SIGNS, mirror_of
from backend.learning.preferences.posterior import PosteriorConfig
from backend.learning.preferences.preferences import Preference, usable
from backend.learning.rewards.holding_out import Fit, held_out_odds
from backend.learning.rewards.reward_mlp import MlpConfig, MlpRewardModel, fit_mlp
from backend.learning.rewards.reward_model import Reduction, RewardModel, bradley_terry_loss
from backend.learning.rewards.reward_weights import fit_weights
from backend.simulation.setups import get_setup
from backend.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class EnsembleConfig:
    """Ours: the thesis trains one network, one pair per step, for ten epochs; hundreds of answers bear more."""

    members: int = 3
    seed: int = 0
    member: MlpConfig = field(default_factory=lambda: MlpConfig(epochs=20, learning_rate=1e-3, pairs_per_step=16))


@dataclass(frozen=True)
class MlpEnsembleRewardModel:
    """Networks that were trained on the same answers from different starts."""

    members: tuple[MlpRewardModel, ...]

    @property
    def setup(self) -> str:
        return self.members[0].setup

    @property
    def reduction(self) -> Reduction:
        return self.members[0].reduction

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        mean: Floats = np.mean(
            [member.rewards(observations, actions, next_observations) for member in self.members], axis=0
        ).astype(np.float32)
        return mean

    def log_odds(self, a: Trajectory, b: Trajectory) -> float:
        """Of the members' mean probability that A is chosen (equation 6.4, outputs as they were trained)."""
        choice_probabilities = [1 / (1 + math.exp(-_within(m.raw_reward(a) - m.raw_reward(b)))) for m in self.members]
        chance = float(np.clip(np.mean(choice_probabilities), 1e-6, 1 - 1e-6))
        return math.log(chance / (1 - chance))

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        metas: list[dict[str, object]] = []
        arrays: dict[str, Floats] = {}
        for k, member in enumerate(self.members):
            meta, of_member = member.to_arrays()
            metas.append(meta)
            arrays |= {f"member_{k:02d}_{name}": array for name, array in of_member.items()}
        return {"kind": "mlp_ensemble", "setup": self.setup, "members": metas}, arrays

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
    preferences: Sequence[Preference], config: EnsembleConfig | None = None, *, left_right_symmetry: bool = False
) -> MlpEnsembleRewardModel:
    """left_right_symmetry: every answer counts in the mirrored world, too; only where the protocol declares that.

    Raises LearningError for fewer than two usable answers, SetupError for mixed setups.
    """
    config = config or EnsembleConfig()
    seeds = [config.seed * 100 + k for k in range(config.members)]
    if left_right_symmetry:
        preferences = [*preferences, *map(_mirrored, preferences)]
    return MlpEnsembleRewardModel(tuple(fit_mlp(preferences, replace(config.member, seed=seed)) for seed in seeds))


def _mirrored(preference: Preference) -> Preference:
    """The answer as the networks see it with left and right exchanged; they read neither poses nor scene."""
    order, signs = mirror_of(get_setup(preference.setup))

    def turned(trajectory: Trajectory) -> Trajectory:
        seen, then = (part[:, order] * signs for part in (trajectory.observations, trajectory.next_observations))
        return replace(trajectory, observations=seen, next_observations=then, actions=trajectory.actions * ACTION_SIGNS)

    return replace(preference, chosen=turned(preference.chosen), rejected=turned(preference.rejected))


@dataclass(frozen=True)
class Chosen:
    """name: `weights`, `mlp_ensemble_sum` or `mlp_ensemble_mean`, fitted to all answers as `model`.

    log_likelihoods: mean natural log-likelihood of a held-out answer under each kind that was tried; a coin has -0.69.
    """

    name: str
    model: RewardModel
    log_likelihoods: dict[str, float]
    answers: int


FEWEST_FOR_FREE_FORM = 60  # ours: below, they are not tried
MARGIN = 0.02  # nats per answer by which the networks must be better: of two alike, the one that can be read


def choose_reward_model(
    preferences: Sequence[Preference],
    *,
    folds: int = 3,
    seed: int = 0,
    networks: EnsembleConfig | None = None,
    fewest: int = FEWEST_FOR_FREE_FORM,
    left_right_symmetry: bool = False,
) -> Chosen:
    """The kind of model that predicts held-out answers better, fitted to all of them.

    Cross-validated log-likelihood of the objectives' model and of networks whose outputs are summed or averaged over a
    trajectory; networks must win by MARGIN. Preferences over the objectives stay with it. Of one that is not made of
    them, looking towards the person, 400 answers to varied queries let the averaging networks predict 86 % of 200
    others, the summing ones 76 % and the posterior over the objectives 66 %; of another, passing at a certain distance,
    none learns much (60 to 65 %).

    Raises LearningError for fewer than two usable answers, SetupError for mixed setups.
    """
    _, kept = usable(preferences)
    posterior, networks = PosteriorConfig(left_right_symmetry=left_right_symmetry), networks or EnsembleConfig()

    def of_networks(reduction: Reduction) -> Fit:
        config = replace(networks, member=replace(networks.member, reduction=reduction))
        return lambda given: fit_mlp_ensemble(given, config, left_right_symmetry=left_right_symmetry)

    fits: dict[str, Fit] = {"weights": lambda given: fit_weights(given, posterior)}
    if len(kept) < fewest:
        return Chosen("weights", fits["weights"](kept), {}, len(kept))
    fits |= {"mlp_ensemble_sum": of_networks("sum"), "mlp_ensemble_mean": of_networks("mean")}
    likelihoods = {name: held_out_log_likelihood(kept, fit, folds=folds, seed=seed) for name, fit in fits.items()}
    best = max(likelihoods, key=lambda name: likelihoods[name])
    name = best if likelihoods[best] > likelihoods["weights"] + MARGIN else "weights"
    return Chosen(name, fits[name](kept), likelihoods, len(kept))


def held_out_log_likelihood(preferences: Sequence[Preference], fit: Fit, *, folds: int = 3, seed: int = 0) -> float:
    """Mean natural log-likelihood of answers under models that never saw them, over `folds` folds in a seeded order."""
    fold_of = np.empty(len(preferences), dtype=np.int64)
    fold_of[np.random.default_rng([seed, 65]).permutation(len(preferences))] = np.arange(len(preferences)) % folds
    return -bradley_terry_loss(held_out_odds(preferences, fit, fold_of)) / len(preferences)
