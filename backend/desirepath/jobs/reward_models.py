"""The job that learns a reward model from a snapshot's answers and says how well such models predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from desirepath.jobs.answers import (
    describe_model,
    fit_of,
    keep_reward_model,
    prediction_of,
    preferences_of,
    snapshot_of,
)
from desirepath.jobs.context import JobContext
from desirepath.jobs.kinds import RewardModelParams
from desirepath.learning.errors import TooFewAnswers
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.held_out import accuracy, held_out_accuracy
from desirepath.learning.rewards.reward_model import Fit


def learn_reward_model(context: JobContext, params: RewardModelParams) -> dict[str, Any]:
    """A reward model of all answers, and per participant how well such models predict answers they did not see."""
    answers = snapshot_of(context, params.snapshot)
    of_participant = preferences_of(context, answers[1])
    everything = [preference for preferences in of_participant.values() for preference in preferences]
    fit = fit_of(params.model, params.reduction, params.seed)
    context.progress(0.1)
    model = fit(everything)
    held_out: list[dict[str, Any]] = []
    for number, (code, preferences) in enumerate(of_participant.items()):
        held_out.append({"participant": code, **_held_out(preferences, fit, params)})
        context.progress(0.2 + 0.7 * (number + 1) / len(of_participant))
    result = {
        "training_accuracy": accuracy(model, everything),
        "answers": len(everything),
        "held_out": held_out,
        "predicted": prediction_of(
            answers, of_participant, params.model, reduction=params.reduction, seed=params.seed
        ).as_dict(),
        **describe_model(model),
    }
    kept = keep_reward_model(
        context, params, answers, model, name=params.model, reduction=params.reduction, results=result
    )
    return {"reward_model": kept, **result}


def _held_out(preferences: Sequence[Preference], fit: Fit, params: RewardModelParams) -> dict[str, Any]:
    """How well models predict a participant's answers that they did not see; `reason` where nothing can be held out."""
    try:
        return asdict(held_out_accuracy(preferences, fit, folds=params.folds, seed=params.seed))
    except TooFewAnswers:
        return {"n": len(preferences), "reason": "too_few_answers"}
