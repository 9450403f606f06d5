"""How well a kind of reward model predicts answers that it did not see. Which kind is then chosen is not decided here.

One participant's few answers are held out one by one or in folds by `reward_model.held_out_accuracy`; here are many
people's answers, several of which are about the same scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.learning.errors import TooFewAnswers
from backend.learning.policies.evaluate import wilson
from backend.learning.preferences.preferences import Preference, usable
from backend.learning.rewards.reward_model import RewardModel, bradley_terry_loss, log_odds

Doubles = NDArray[np.float64]
Fit = Callable[[Sequence[Preference]], RewardModel]


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
                odds[k] = log_odds(model, preference.chosen, preference.rejected)
    return odds
