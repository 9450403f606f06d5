"""The conditioned policy at the preference weights that the answers speak for; there at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from desirepath.jobs.alignment import Aligned, Alignment, ConditionedAlignParams
from desirepath.jobs.params import from_source

if TYPE_CHECKING:
    from desirepath.jobs.context import JobContext
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel


class InstantParams(ConditionedAlignParams):
    """The conditioned policy at the preference weights that the answers speak for; there at once (recipe A)."""

    recipe: Literal["instant"] = from_source("ours_at_once", "instant")


def align(context: JobContext, params: InstantParams, base: Policy, model: RewardModel) -> Aligned:
    from desirepath.jobs.aligned import by_name, conditioned_by, departures_of, gate_rule
    from desirepath.learning.alignment.gate import at_gate

    artefact, conditioned, weights = conditioned_by(context, params, base, model)
    policy = conditioned.at(weights).without_critic()
    gate = at_gate(policy, base, gate_rule(params), seed=params.seed)
    return Aligned(
        policy=policy,
        gate=gate,
        config={"recipe": params.recipe, "preference_weights": by_name(weights, base.setup)},
        parents=[(artefact, "conditioned")],
        departures=departures_of(conditioned, "instant"),
    )


ALIGNMENT = Alignment(InstantParams, "instant policy", align)
