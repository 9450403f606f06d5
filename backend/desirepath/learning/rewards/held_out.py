"""How well reward models predict answers that they did not see. Which kind is then chosen is `auto.py`'s.

One participant's few answers are held out one by one or in folds (`held_out_accuracy`); of many people's answers,
several of which are about the same scene, whole scenes are (`predict_in_new_scenes`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import wilson
from desirepath.learning.errors import LearningError, TooFewAnswers
from desirepath.learning.preferences.preferences import Preference, usable
from desirepath.learning.rewards.reward_model import Fit, RewardModel, bradley_terry_loss

Doubles = NDArray[np.float64]
FEWEST_TO_HOLD_OUT = 3  # one is predicted by a model of at least two others


def accuracy(model: RewardModel, preferences: Sequence[Preference]) -> float:
    """Share of pairs whose chosen trajectory is predicted to be chosen, where one was; ties of the model count half."""
    gaps = [model.log_odds(p.chosen, p.rejected) for p in preferences if not p.is_tie]
    if not gaps:
        raise LearningError("preferences: none given to measure accuracy on")
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
    """Answers about scenes that the predicting model never saw. low, high: 95 % interval of the accuracy: over people
    where there are several, else Wilson's over answers. log_likelihood: mean natural one of an answer; a coin has
    -0.69."""

    answers: int
    scenes: int
    folds: int
    accuracy: float
    low: float
    high: float
    log_likelihood: float


def predict_in_new_scenes(preferences: Sequence[Preference], fit: Fit, *, folds: int = 3, seed: int = 0) -> Predicted:
    """Cross-validated over scenes in a seeded order: all answers about one scene are held out together, whoever gave
    them. Raises TooFewAnswers for fewer scenes than folds."""
    _, kept = usable(preferences)
    names, scene_of = np.unique([preference.chosen.scene.digest() for preference in kept], return_inverse=True)
    if len(names) < folds:
        raise TooFewAnswers(f"{len(names)} scenes with answers: {folds} folds need at least as many")
    fold_of_scene = np.random.default_rng([seed, 66]).permutation(len(names)) % folds
    odds = held_out_odds(kept, fit, fold_of_scene[scene_of])
    low, high = _interval(kept, odds > 0)
    hits = int((odds > 0).sum())
    return Predicted(
        len(kept),
        len(names),
        folds,
        hits / len(kept),
        low,
        high,
        -bradley_terry_loss(odds) / len(kept),
    )


def _interval(preferences: Sequence[Preference], right: NDArray[np.bool_]) -> tuple[float, float]:
    """Of the share that was predicted: people are the units where several gave the answers."""
    from desirepath.analysis.intervals import bound_share  # scipy's statistics, which a server starts without

    people = np.array([one.person or "" for one in preferences])
    names = np.unique(people)
    if len(names) < 2:
        estimate = wilson(int(right.sum()), len(right))
        return estimate.low, estimate.high
    sizes = np.array([(people == name).sum() for name in names])
    shares = np.array([right[people == name].mean() for name in names])
    mean = float(right.mean())
    spread = float(((sizes * (shares - mean)) ** 2).sum() * len(names) / (len(names) - 1))
    return bound_share(mean, math.sqrt(spread) / len(right), len(names), most=float(len(right)))


def held_out_odds(preferences: Sequence[Preference], fit: Fit, fold_of: NDArray[np.int64]) -> Doubles:
    """(n,) log odds of each answer as it was given, under a model of the answers of the other folds."""
    odds = np.zeros(len(preferences))
    for fold in np.unique(fold_of):
        model = fit([preference for preference, of in zip(preferences, fold_of, strict=True) if of != fold])
        for k, (preference, of) in enumerate(zip(preferences, fold_of, strict=True)):
            if of == fold:
                odds[k] = model.log_odds(preference.chosen, preference.rejected)
    return odds


CHANCE = 0.5  # of two trajectories


@dataclass(frozen=True)
class Prediction:
    """How well a model predicts answers that it did not see, beside what needs no model.

    majority: how often answering as most did would have been right (`majority_share`). low, high: 95 % interval of the
    accuracy. verdict: `better`; `no_better_than_chance`, where chance lies within the interval or above it;
    `no_better_than_majority`; `too_few_answers`, where nothing can be held out (then there is no accuracy).
    """

    n: int
    method: str
    majority: float
    accuracy: float | None = None
    low: float | None = None
    high: float | None = None
    chance: float = CHANCE

    @property
    def verdict(self) -> str:
        if self.accuracy is None or self.low is None:
            return "too_few_answers"
        if self.low <= self.chance:
            return "no_better_than_chance"
        return "better" if self.accuracy > self.majority else "no_better_than_majority"

    def as_dict(self) -> dict[str, float | int | str | None]:
        return {**asdict(self), "verdict": self.verdict}


def majority_share(sides: Sequence[str], chosen: Sequence[str], rejected: Sequence[str]) -> float:
    """How often answering as most did is right: always the side that was chosen more often, or, where most answers are
    about a pair that others answered, too, what most of these chose (a tie is right half of the time). sides, chosen,
    rejected: of each answer. The better of the two."""
    n = len(sides)
    if n == 0:
        raise LearningError("answers: none given to take a majority of")
    by_side = max(sides.count(side) for side in set(sides)) / n
    votes = Counter(zip(chosen, rejected, strict=True))
    right, judged = 0.0, 0
    for pair in zip(chosen, rejected, strict=True):
        same, other = votes[pair] - 1, votes[pair[::-1]]
        if same + other:
            judged += 1
            right += 1.0 if same > other else 0.5 if same == other else 0.0
    return max(by_side, right / judged) if judged > n / 2 else by_side


def predictions(
    preferences: Sequence[Preference], fit: Fit, *, majority: float, people: int, folds: int, seed: int
) -> Prediction:
    """Of one person's answers some are held out, of several people's whole scenes, whoever answered about them."""
    try:
        if people > 1:
            new = predict_in_new_scenes(preferences, fit, folds=folds, seed=seed)
            return Prediction(new.answers, f"{folds}_folds_of_scenes", majority, new.accuracy, new.low, new.high)
        held = held_out_accuracy(preferences, fit, folds=folds, seed=seed)
        return Prediction(held.n, held.method, majority, held.accuracy, held.low, held.high)
    except TooFewAnswers:
        return Prediction(len(preferences), "none", majority)
