"""Which function does which kind of job. Imports torch and numba: only training processes come here."""

from __future__ import annotations

from typing import Any

from desirepath.jobs import aligning, asking_person, comparing, demonstrating, kinds, policy_training, reward_models
from desirepath.jobs.alignment import AlignParams
from desirepath.jobs.context import JobContext
from desirepath.jobs.params import Params


def run_kind(context: JobContext, params: Params) -> dict[str, Any]:
    """Do the work that the parameters ask for; returns the job's result."""
    match params:
        case AlignParams():
            return aligning.align(context, params)
        case kinds.RewardModelParams():
            return reward_models.learn_reward_model(context, params)
        case kinds.EvaluateParams():
            return comparing.evaluate_policy(context, params)
        case kinds.CompareParams():
            return comparing.compare_two(context, params)
        case kinds.TrainBaseParams():
            return policy_training.train_base(context, params)
        case kinds.EnsembleParams():
            return policy_training.train_ensemble(context, params)
        case kinds.QueriesParams():
            return policy_training.make_query_set(context, params)
        case kinds.TrainDemonstrationsParams():
            return demonstrating.train_demonstrations(context, params)
        case kinds.AskPersonParams():
            return asking_person.ask_person(context, params)
    raise TypeError(f"no runner for {type(params).__name__}")
