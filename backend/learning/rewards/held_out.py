"""How well reward models predict answers that they did not see. Which kind is then chosen is `model_choice.py`'s.

One participant's few answers are held out one by one or in folds (`held_out_accuracy`); of many people's answers,
several of which are about the same scene, whole scenes are (`predicted_in_new_scenes`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.learning.errors import LearningError, TooFewAnswers
from backend.learning.policies.evaluate import wilson
from backend.learning.preferences.preferences import Preference, usable
from backend.learning.rewards.reward_model import Fit, RewardModel, bradley_terry_loss

Doubles = NDArray[np.float64]
FEWEST_TO_HOLD_OUT = 3  # one is predicted by a model of at least two others


def accuracy(model: RewardModel, preferences: Sequence[Preference]) -> float:
    """Share of pairs whose chosen trajectory is predicted to be chosen; ties count half."""
    if not preferences:
        raise LearningError("preferences: none given to measure accuracy on")
    gaps = [model.log_odds(p.chosen, p.rejected) for p in preferences]
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
    fit: Fit,
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


@dataclass(frozen=True)
class Predicted:
    """Answers about scenes that the predicting model never saw. low, high: 95 % Wilson interval of the accuracy, which
    takes answers as independent. log_likelihood: mean natural one of an answer; a coin has -0.69."""

    answers: int
    scenes: int
    folds: int
    accuracy: float
    low: float
    high: float
    log_likelihood: float


def predicted_in_new_scenes(preferences: Sequence[Preference], fit: Fit, *, folds: int = 3, seed: int = 0) -> Predicted:
    """Cross-validated over scenes in a seeded order: all answers about one scene are held out together, whoever gave
    them. Raises TooFewAnswers for fewer scenes than folds."""
    _, kept = usable(preferences)
    names, scene_of = np.unique([preference.chosen.scene.digest() for preference in kept], return_inverse=True)
    if len(names) < folds:
        raise TooFewAnswers(f"{len(names)} scenes with answers: {folds} folds need at least as many")
    fold_of_scene = np.random.default_rng([seed, 66]).permutation(len(names)) % folds
    odds = held_out_odds(kept, fit, fold_of_scene[scene_of])
    hits = int((odds > 0).sum())
    estimate = wilson(hits, len(kept))
    return Predicted(
        len(kept),
        len(names),
        folds,
        hits / len(kept),
        estimate.low,
        estimate.high,
        -bradley_terry_loss(odds) / len(kept),
    )


def held_out_odds(preferences: Sequence[Preference], fit: Fit, fold_of: NDArray[np.int64]) -> Doubles:
    """(n,) log odds of each answer as it was given, under a model of the answers of the other folds."""
    odds = np.zeros(len(preferences))
    for fold in np.unique(fold_of):
        model = fit([preference for preference, of in zip(preferences, fold_of, strict=True) if of != fold])
        for k, (preference, of) in enumerate(zip(preferences, fold_of, strict=True)):
            if of == fold:
                odds[k] = model.log_odds(preference.chosen, preference.rejected)
    return odds
