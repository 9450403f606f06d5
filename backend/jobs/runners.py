"""Which function does which kind of job. Imports torch and numba: only training processes come here."""

from __future__ import annotations

from typing import Any

from backend.jobs import aligning, asking_person, comparing, demonstrating, kinds, policy_training, reward_models
from backend.jobs.context import JobContext
from backend.jobs.kinds import Params

TASKS = "backend.experiments.reproduction.on_workers"


def run_kind(context: JobContext, params: Params) -> dict[str, Any]:
    """Do the work that the parameters ask for; returns the job's result."""
    match params:
        case kinds.AlignParams():
            return aligning.align(context, params)
        case kinds.RewardModelParams():
            return reward_models.learn_reward_model(context, params)
        case kinds.EvaluateParams():
            return comparing.evaluate_one(context, params)
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
        case kinds.TaskParams():
            return _task(context, params)
    raise TypeError(f"no runner for {type(params).__name__}")


def _task(context: JobContext, params: kinds.TaskParams) -> dict[str, Any]:
    """A task of a chapter: what it computes stands above this room, and is found by name."""
    from importlib import import_module

    done: dict[str, Any] = import_module(TASKS).do_task(context, params)
    return done
