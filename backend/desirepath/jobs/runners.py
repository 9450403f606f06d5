"""Which function does which kind of job, and the two that need no room of their own. Imports torch and numba: only
training processes come here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from desirepath.jobs import aligning, comparing, demonstrating, kinds, policy_training, setup_training
from desirepath.jobs.alignment import AlignParams
from desirepath.jobs.answers import (
    describe_model,
    fit_of,
    keep_reward_model,
    prediction_of,
    preferences_of,
    snapshot_of,
)
from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import find_artefact
from desirepath.jobs.kinds import AskPersonParams, RewardModelParams
from desirepath.jobs.params import Params
from desirepath.learning.errors import TooFewAnswers
from desirepath.learning.people.asked_people import PeopleConfig, benchmark_people
from desirepath.learning.people.reward_file import reward_of_store
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.held_out import accuracy, held_out_accuracy
from desirepath.learning.rewards.reward_model import Fit

MEASURED_AFTER = (8, 15, 50, 200)  # answers of a reward model that is asked as a person
SHOWN_AFTER = 15


def run_kind(context: JobContext, params: Params) -> dict[str, Any]:
    """Do the work that the parameters ask for; returns the job's result."""
    match params:
        case AlignParams():
            return aligning.align(context, params)
        case kinds.RewardModelParams():
            return learn_reward_model(context, params)
        case kinds.EvaluateParams():
            return comparing.evaluate_policy(context, params)
        case kinds.CompareParams():
            return comparing.compare_two(context, params)
        case kinds.TrainBaseParams():
            return policy_training.train_base(context, params)
        case kinds.TrainSetupParams():
            return setup_training.make_setup_ready(context, params)
        case kinds.EnsembleParams():
            return policy_training.train_ensemble(context, params)
        case kinds.QueriesParams():
            return policy_training.make_query_set(context, params)
        case kinds.TrainDemonstrationsParams():
            return demonstrating.train_demonstrations(context, params)
        case kinds.AskPersonParams():
            return ask_person(context, params)
    raise TypeError(f"no runner for {type(params).__name__}")


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
        held_out.append({"participant": code, **_predict_held_out(preferences, fit, params)})
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
    artefact_id = keep_reward_model(
        context, params, answers, model, name=params.model, reduction=params.reduction, results=result
    )
    return {"reward_model": artefact_id, **result}


def _predict_held_out(preferences: Sequence[Preference], fit: Fit, params: RewardModelParams) -> dict[str, Any]:
    """How well models predict a participant's answers that they did not see; `reason` where nothing can be held out."""
    try:
        return asdict(held_out_accuracy(preferences, fit, folds=params.folds, seed=params.seed))
    except TooFewAnswers:
        return {"n": len(preferences), "reason": "too_few_answers"}


def ask_person(context: JobContext, params: AskPersonParams) -> dict[str, Any]:
    """The result of `benchmark_people`. Raises ArtefactError for a reward model that may not be used, LearningError for
    one that cannot be read."""
    with context.database.session() as s:
        artefact = find_artefact(s, params.reward, "reward_model")
        setup, name, content = artefact.setup, artefact.name, context.files.get(artefact.id)
    person = reward_of_store(content, setup)
    after = tuple(sorted({n for n in MEASURED_AFTER if n < params.answers} | {params.answers}))
    config = PeopleConfig(
        families=(),
        answers=after,
        shown_after=SHOWN_AFTER if SHOWN_AFTER in after else after[0],
        seeds=(params.seed,),
        response_model=params.response_model,
        choose=params.choose,
        queries="both",
    )
    context.progress(0.1)
    return benchmark_people(setup, config, {name: person}, lambda done: context.progress(0.1 + 0.9 * done))
