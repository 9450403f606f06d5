"""The linear Bradley-Terry reward model: R(s, a) = w . features, fitted in a tenth of a second to a few answers.

MAP estimate with non-negative weights (spec 06). The thesis's neural model lives in `reward_mlp.py`; both are
`RewardModel`s and are stored as NPZ by `save_reward_model` / `load_reward_model`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from backend.learning.errors import LearningError
from backend.learning.policies.evaluate import wilson
from backend.learning.preferences.features import CLOSENESS, FEATURE_NAMES, step_features
from backend.learning.preferences.preferences import Preference, usable
from backend.simulation.npz import NpzError, from_npz, to_npz
from backend.simulation.setups import Setup, get_setup
from backend.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Reduction = Literal["sum", "mean"]
FORMAT = "desirepath-reward-model-1"
FEWEST_TO_HOLD_OUT = 3  # one is predicted by a model of at least two others


class RewardModel(Protocol):
    """What alignment and evaluation need of a learned reward, whatever its kind."""

    @property
    def setup(self) -> str: ...

    @property
    def reduction(self) -> Reduction: ...

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        """Predicted reward of n steps: (n,) float32."""
        ...

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        """JSON-ready description and weights, for storage."""
        ...


@runtime_checkable
class JudgesTrajectories(Protocol):
    """A reward model with a view of whole trajectories that is not the sum of their steps."""

    def trajectory_reward(self, trajectory: Trajectory) -> float: ...


@runtime_checkable
class PredictsAnswers(Protocol):
    """A reward model that knows how sure it is of an answer."""

    def log_odds(self, a: Trajectory, b: Trajectory) -> float:
        """log of how much likelier A is chosen than B."""
        ...


def trajectory_reward(model: RewardModel, trajectory: Trajectory) -> float:
    """What the model thinks of a whole trajectory; of two, the one with more is predicted to be chosen.

    Sum or mean (the model's reduction) of the predicted rewards, unless the model judges whole trajectories.
    """
    if isinstance(model, JudgesTrajectories):
        return model.trajectory_reward(trajectory)
    steps = model.rewards(trajectory.observations, trajectory.actions, trajectory.next_observations)
    return float(steps.sum() if model.reduction == "sum" else steps.mean())


def log_odds(model: RewardModel, a: Trajectory, b: Trajectory) -> float:
    """log of how much likelier A is chosen than B: the model's own, or the difference of rewards (equation 6.4)."""
    if isinstance(model, PredictsAnswers):
        return model.log_odds(a, b)
    return trajectory_reward(model, a) - trajectory_reward(model, b)


def bradley_terry_loss(advantages: Doubles) -> float:
    """Equation 6.4 as cross-entropy: sum of -log P[chosen > rejected], P = 1 / (1 + exp(-(R_chosen - R_rejected)))."""
    return float(np.logaddexp(0.0, -advantages).sum())


def bradley_terry_gradient(advantages: Doubles) -> Doubles:
    """d loss / d advantage, one per pair."""
    gradient: Doubles = -1.0 / (1.0 + np.exp(np.clip(advantages, -500, 500)))
    return gradient


class TrajectoryFeatures(NamedTuple):
    """(9,) each. by_steps: sum or mean over the steps, as a policy collects them. as_judged: as a person compares two
    trajectories: nearness to person and obstacles by its worst moment, everything else over the steps."""

    by_steps: Doubles
    as_judged: Doubles


def trajectory_features(trajectory: Trajectory, setup: Setup, reduction: Reduction) -> TrajectoryFeatures:
    """The features of a whole trajectory. The worst moment is ours: with the sum alone, 15 answers of the
    minimum-distance oracle predicted 79 % of other answers in the study room, with it 91 % (40 draws from the shipped
    queries)."""
    steps = step_features(trajectory.actions, trajectory.next_observations, setup).astype(np.float64)
    by_steps: Doubles = steps.sum(0) if reduction == "sum" else steps.mean(0)
    return TrajectoryFeatures(by_steps, np.where(CLOSENESS, steps.min(0), by_steps))


@dataclass(frozen=True)
class LinearConfig:
    """Ours (spec 06): prior standard deviation of the standardised weights, and how a trajectory's steps add up."""

    reduction: Reduction = "sum"
    prior_std: float = 1.0
    scale_floor: float = 0.25  # of a summed feature: a smaller difference between two trajectories is an accident
    closeness_floor: float = 0.05  # the same for how close the closest moment of a trajectory was
    iterations: int = 3_000


@dataclass(frozen=True)
class LinearRewardModel:
    """All (9,) float32, >= 0, in the order of FEATURE_NAMES.

    weights: of the features of one step, what a policy is rewarded by. trajectory_weights: of the features of a whole
    trajectory (`trajectory_features`), what predicts an answer. standardised: both in units of the features' typical
    differences between two trajectories, comparable with each other.
    """

    setup: str
    weights: Floats
    trajectory_weights: Floats
    standardised: Floats
    reduction: Reduction = "sum"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        del observations  # features are read from the states that the steps led to
        values: Floats = step_features(actions, next_observations, get_setup(self.setup)) @ self.weights
        return values

    def trajectory_reward(self, trajectory: Trajectory) -> float:
        """Of a whole trajectory, nearness judged by its worst moment."""
        judged = trajectory_features(trajectory, get_setup(self.setup), self.reduction).as_judged
        return float(judged @ self.trajectory_weights)

    def importance(self) -> dict[str, float]:
        """Share of each feature in the standardised weights, by name: what the answers were about."""
        total = float(self.standardised.sum()) or 1.0
        return {name: float(w) / total for name, w in zip(FEATURE_NAMES, self.standardised, strict=True)}

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        meta: dict[str, object] = {"kind": "linear", "setup": self.setup, "reduction": self.reduction}
        return meta, {
            "weights": self.weights,
            "drive_weights": self.trajectory_weights,
            "standardised": self.standardised,
        }

    @classmethod
    def from_arrays(cls, meta: dict[str, str], arrays: dict[str, Floats]) -> LinearRewardModel:
        reduction: Reduction = "mean" if meta["reduction"] == "mean" else "sum"
        return cls(meta["setup"], arrays["weights"], arrays["drive_weights"], arrays["standardised"], reduction)


def fit_linear(preferences: Sequence[Preference], config: LinearConfig | None = None) -> LinearRewardModel:
    """MAP weights: minimise sum -log P[chosen > rejected] + |w|^2 / (2 prior^2) over w >= 0, by projected gradient.

    Features are scaled by their root-mean-square difference over the given pairs, so the prior treats them alike.
    The floor keeps a feature that hardly occurs in them from getting a huge weight.
    Raises LearningError for fewer than two usable answers, SetupError for mixed setups.
    """
    config = config or LinearConfig()
    setup, kept = usable(preferences)

    pairs = [
        [trajectory_features(trajectory, setup, config.reduction) for trajectory in (p.chosen, p.rejected)]
        for p in kept
    ]
    differences = np.stack([chosen.as_judged - rejected.as_judged for chosen, rejected in pairs])
    by_steps = np.stack([chosen.by_steps - rejected.by_steps for chosen, rejected in pairs])
    mean_steps = np.mean([len(trajectory.actions) for p in kept for trajectory in (p.chosen, p.rejected)])
    floor = config.scale_floor if config.reduction == "sum" else config.scale_floor / mean_steps
    floors = np.where(CLOSENESS, config.closeness_floor, floor)
    scale = np.sqrt(np.square(differences).mean(0) + floors**2)
    step_scale = np.sqrt(np.square(by_steps).mean(0) + floor**2)
    x = differences / scale
    step = 1.0 / (0.25 * np.square(x).sum() + 1.0 / config.prior_std**2)
    w = np.full(x.shape[1], 0.1)
    for _ in range(config.iterations):
        gradient = x.T @ bradley_terry_gradient(x @ w) + w / config.prior_std**2
        w = np.maximum(w - step * gradient, 0.0)
    return LinearRewardModel(
        setup.name,
        (w / step_scale).astype(np.float32),
        (w / scale).astype(np.float32),
        w.astype(np.float32),
        reduction=config.reduction,
    )


def accuracy(model: RewardModel, preferences: Sequence[Preference]) -> float:
    """Share of pairs whose chosen trajectory is predicted to be chosen; ties count half."""
    if not preferences:
        raise LearningError("preferences: none given to measure accuracy on")
    gaps = [log_odds(model, p.chosen, p.rejected) for p in preferences]
    return float(np.mean([1.0 if gap > 0 else 0.5 if gap == 0 else 0.0 for gap in gaps]))


@dataclass(frozen=True)
class HeldOut:
    """How often models of some of `n` answers predict the others. low and high: 95 % Wilson interval of the share; it
    takes the answers as independent, which predictions by models of nearly the same answers are only roughly.
    """

    n: int
    method: str  # "leave_one_out" or e.g. "5_folds"
    accuracy: float
    low: float
    high: float


def held_out_accuracy(
    preferences: Sequence[Preference],
    fit: Callable[[Sequence[Preference]], RewardModel],
    *,
    folds: int = 5,
    seed: int = 0,
) -> HeldOut:
    """Cross-validated accuracy: each answer is predicted by a model that never saw it.

    `folds` folds in a seeded order, leave-one-out where there are fewer than two answers per fold. Raises TooFewAnswers
    for fewer than FEWEST_TO_HOLD_OUT answers about two different trajectories.
    """
    _, kept = usable(preferences, fewest=FEWEST_TO_HOLD_OUT)
    n = len(kept)
    parts = n if n < 2 * folds else folds
    order = np.random.default_rng([seed, 64]).permutation(n)
    hits = 0.0
    for part in range(parts):
        test = set(order[part::parts].tolist())
        model = fit([p for k, p in enumerate(kept) if k not in test])
        hits += accuracy(model, [kept[k] for k in sorted(test)]) * len(test)
    hits = round(2 * hits) / 2  # whole or half: ties count half
    low, high = wilson(math.floor(hits), n).low, wilson(math.ceil(hits), n).high
    return HeldOut(n, "leave_one_out" if parts == n else f"{parts}_folds", hits / n, low, high)


def reward_model_to_bytes(model: RewardModel) -> bytes:
    """NPZ without pickled objects; same model, same bytes."""
    meta, arrays = model.to_arrays()
    return to_npz({"format": FORMAT, **meta}, arrays)


def reward_model_from_bytes(data: bytes) -> RewardModel:
    """Read `reward_model_to_bytes` back, never unpickling. Raises LearningError on anything else."""
    from backend.learning.rewards.free_form import (
        MlpEnsembleRewardModel,  # these three import torch, which the others do not
    )
    from backend.learning.rewards.reward_interface import InterfaceRewardModel
    from backend.learning.rewards.reward_mlp import MlpRewardModel
    from backend.learning.rewards.reward_weights import WeightsRewardModel

    kinds: dict[str, Callable[[dict[str, str], dict[str, Floats]], RewardModel]] = {
        "interface": InterfaceRewardModel.from_arrays,
        "linear": LinearRewardModel.from_arrays,
        "mlp": MlpRewardModel.from_arrays,
        "mlp_ensemble": MlpEnsembleRewardModel.from_arrays,
        "weights": WeightsRewardModel.from_arrays,
    }
    try:
        meta, arrays = from_npz(data)
    except NpzError as problem:
        raise LearningError(f"not a desirepath reward model (.npz): {problem}") from None
    if meta.get("format") != FORMAT or meta.get("kind") not in kinds:
        raise LearningError(f"reward model format {meta.get('format')!r}, kind {meta.get('kind')!r} is unknown")
    return kinds[meta["kind"]](meta, arrays)


def save_reward_model(model: RewardModel, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(reward_model_to_bytes(model))


def load_reward_model(path: Path) -> RewardModel:
    """Raises LearningError if the file is missing or no reward model."""
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise LearningError(f"cannot read reward model {path}: {problem.strerror}") from None
    return reward_model_from_bytes(data)
