"""What the alignments have in common: their gate, the conditioned policy, training on with a learned reward.

The algorithms are `desirepath.learning.alignment`'s; what is kept of them is `aligning.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.jobs.alignment import Aligned, AlignParams, ConditionedAlignParams
from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import load_conditioned
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.relabelling import RelabellingConfig
from desirepath.learning.alignment.relabelling import align as learn_policy
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


def gate_rule(params: AlignParams) -> GateRule:
    """What the parameters ask of the policy before anybody is shown it."""
    return GateRule(params.gate_scenes, params.gate_min_success, params.gate_max_loss)


def conditioned_by(
    context: JobContext, params: ConditionedAlignParams, base: Policy, model: RewardModel
) -> tuple[Artefact, ConditionedPolicy, NDArray[np.float32]]:
    """The conditioned policy with its artefact, and the weights that the answers speak for."""
    if not isinstance(model, WeightsRewardModel):
        raise LearningError(f"model = {params.model!r}: a conditioned policy needs preference weights: model = weights")
    reference = params.conditioned or f"{base.setup}/conditioned"
    artefact, conditioned = load_conditioned(context, reference)
    require_same(base=base.setup, conditioned=conditioned.setup)
    return artefact, conditioned, model.preference_weights()


def departures_of(conditioned: ConditionedPolicy, *keys: str) -> list[str]:
    """Of a policy made from the conditioned one: its robots recover, and slow down by a rule, where that one's do."""
    added = conditioned.strengths or conditioned.slowing
    further = (*(("recovery",) if conditioned.base else ()), *(("added",) if added else ()))
    return [DEPARTURES[key] for key in (*keys, *further)]


def by_name(weights: NDArray[np.float32], setup: str) -> dict[str, float]:
    return {name: round(float(weight), 3) for name, weight in zip(names_of(setup), weights, strict=True) if weight}


def train(
    context: JobContext,
    params: AlignParams,
    config: RelabellingConfig,
    base: Policy,
    model: RewardModel,
    departures: Sequence[str] = (),
) -> Aligned:
    """The base policy, trained on with the learned reward."""
    learned = learn_policy(base, model, config, context.progress.part(0.03, 0.9))
    return Aligned(
        policy=learned.policy,
        gate=learned.gate,
        config={**config.as_dict(), "replay_sha256": learned.replay_sha256},
        results={"chosen_checkpoint": learned.chosen, "history": learned.history},
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=list(departures),
    )


def with_params(
    config: RelabellingConfig, params: AlignParams, *, updates: int, reward_weight: float | None
) -> RelabellingConfig:
    """The algorithm's configuration with what the parameters change."""
    if updates != config.updates:
        config = config.shortened(updates)
    return replace(config, seed=params.seed, gate=gate_rule(params), reward_weight=reward_weight)
