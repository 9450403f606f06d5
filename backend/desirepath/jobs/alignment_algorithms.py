"""The four ways to turn a reward model into a policy, as jobs ask them: parameters in, an aligned policy with what its
card says out. The algorithms are `desirepath.learning.alignment`'s; what is kept of them is `aligning.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import Parent, load_conditioned
from desirepath.jobs.kinds import (
    AlignParams,
    ConditionedAlignParams,
    ConditioningSearchParams,
    FineTuningParams,
    InstantParams,
    ThesisParams,
)
from desirepath.learning.alignment.conditioning_search import PLACES, ConditioningSearchConfig, search_conditioning
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import Gate, GateRule, at_gate
from desirepath.learning.alignment.relabelling import RelabellingConfig
from desirepath.learning.alignment.relabelling import align as learn_policy
from desirepath.learning.alignment.thesis import ThesisConfig
from desirepath.learning.cards import DEPARTURES
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.objectives import names_of
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.rewards.weights import WeightsRewardModel
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.simulation.setups import require_same
from desirepath.store.models import Artefact


@dataclass(frozen=True)
class Aligned:
    """An aligned policy, whether it may be shown, and what its card says. beside: what the job's result says, too."""

    policy: Policy
    gate: Gate
    may_be_shown: bool
    config: dict[str, Any]
    results: dict[str, Any] = field(default_factory=dict)
    parents: list[Parent] = field(default_factory=list)
    scenes: dict[str, Any] = field(default_factory=dict)
    departures: list[str] = field(default_factory=list)
    beside: dict[str, Any] = field(default_factory=dict)


def aligned(context: JobContext, params: AlignParams, base: Policy, model: RewardModel) -> Aligned:
    """By the algorithm that the parameters are of."""
    match params:
        case InstantParams():
            return _instant(context, params, base, model)
        case ConditioningSearchParams():
            return _search(context, params, base, model)
        case FineTuningParams() | ThesisParams():
            return _train(context, params, base, model)
    raise TypeError(f"no alignment for {type(params).__name__}")


def gate_rule(params: AlignParams) -> GateRule:
    """What the parameters ask of the policy before anybody is shown it."""
    return GateRule(params.gate_scenes, params.gate_min_success, params.gate_max_loss)


def training_config(params: FineTuningParams | ThesisParams) -> RelabellingConfig:
    """The algorithm's configuration with what the parameters change."""
    config: RelabellingConfig = ThesisConfig() if isinstance(params, ThesisParams) else FineTuningConfig()
    if params.updates != config.updates:
        config = config.shortened(params.updates)
    return replace(config, seed=params.seed, gate=gate_rule(params), reward_weight=params.reward_weight)


def search_config(params: ConditioningSearchParams) -> ConditioningSearchConfig:
    """How the policy's conditioning is searched, with what the parameters change."""
    return ConditioningSearchConfig(seed=params.seed, tried=params.tried, gate=gate_rule(params))


def _instant(context: JobContext, params: InstantParams, base: Policy, model: RewardModel) -> Aligned:
    artefact, conditioned, weights = _conditioned(context, params, base, model)
    policy = conditioned.at(weights).without_critic()
    gate = at_gate(policy, base, gate_rule(params), seed=params.seed)
    return Aligned(
        policy=policy,
        gate=gate,
        may_be_shown=gate.passed,
        config={"recipe": params.recipe, "preference_weights": _by_name(weights, base.setup)},
        parents=[(artefact, "conditioned")],
        departures=_departures(conditioned, "instant"),
    )


def _search(context: JobContext, params: ConditioningSearchParams, base: Policy, model: RewardModel) -> Aligned:
    """Shown only where it is better than the instant policy."""
    artefact, conditioned, weights = _conditioned(context, params, base, model)
    config = search_config(params)
    found = search_conditioning(conditioned, weights, base, config, context.progress.part(0.03, 0.9))
    judged = {
        "better_than_instant": found.score.as_dict(),
        "preferred_better_than_instant": found.preferred.as_dict(),
        "takes_over": found.takes_over,
    }
    return Aligned(
        policy=found.policy,
        gate=found.gate,
        may_be_shown=found.takes_over,
        config={"recipe": params.recipe, **config.as_dict(), "preference_weights": _by_name(weights, base.setup)},
        results={
            **judged,
            "offsets": {place: _by_name(row, base.setup) for place, row in zip(PLACES, found.offsets, strict=True)},
            "chosen": found.chosen,
            "history": found.history,
        },
        parents=[(artefact, "conditioned")],
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=_departures(conditioned, "instant", "conditioning_search"),
        # On its card, too; but where nothing better was found, the policy and its card are the instant one's.
        beside=judged,
    )


def _train(context: JobContext, params: FineTuningParams | ThesisParams, base: Policy, model: RewardModel) -> Aligned:
    config = training_config(params)
    learned = learn_policy(base, model, config, context.progress.part(0.03, 0.9))
    return Aligned(
        policy=learned.policy,
        gate=learned.gate,
        may_be_shown=learned.gate.passed,
        config={**config.as_dict(), "replay_sha256": learned.replay_sha256},
        results={"chosen_checkpoint": learned.chosen, "history": learned.history},
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=[DEPARTURES["fine_tuning"]] if isinstance(params, FineTuningParams) else [],
    )


def _conditioned(
    context: JobContext, params: ConditionedAlignParams, base: Policy, model: RewardModel
) -> tuple[Artefact, ConditionedPolicy, NDArray[np.float32]]:
    """The conditioned policy with its artefact, and the weights that the answers speak for."""
    if not isinstance(model, WeightsRewardModel):
        raise LearningError(f"model = {params.model!r}: a conditioned policy needs preference weights: model = weights")
    reference = params.conditioned or f"{base.setup}/conditioned"
    artefact, conditioned = load_conditioned(context, reference)
    require_same(base=base.setup, conditioned=conditioned.setup)
    return artefact, conditioned, model.preference_weights()


def _departures(conditioned: ConditionedPolicy, *keys: str) -> list[str]:
    """Of a policy made from the conditioned one: its robots recover, and slow down by a rule, where that one's do."""
    added = conditioned.strengths or conditioned.slowing
    further = (*(("recovery",) if conditioned.base else ()), *(("added",) if added else ()))
    return [DEPARTURES[key] for key in (*keys, *further)]


def _by_name(weights: NDArray[np.float32], setup: str) -> dict[str, float]:
    return {name: round(float(weight), 3) for name, weight in zip(names_of(setup), weights, strict=True) if weight}
