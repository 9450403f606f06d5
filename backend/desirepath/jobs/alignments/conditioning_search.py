"""Searches what else to condition the policy on; shown only where it is better than the instant one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from desirepath.jobs.alignment import Aligned, Alignment, ConditionedAlignParams
from desirepath.jobs.params import from_source

if TYPE_CHECKING:
    from desirepath.jobs.context import JobContext
    from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel


class ConditioningSearchParams(ConditionedAlignParams):
    """Searches what else to condition the policy on, and where; shown only where it is better than the instant one.

    tried: candidates that the search rolls out, in rounds of 16.
    """

    recipe: Literal["conditioning_search"] = from_source("ours_conditioning_search", "conditioning_search")
    gate_scenes: int = from_source("ours_search_gate", 1_500, ge=1_500, le=5_000, advanced=True)
    tried: int = from_source("ours_tried", 144, ge=1, le=10_000)


def search_config(params: ConditioningSearchParams) -> ConditioningSearchConfig:
    """How the policy's conditioning is searched, with what the parameters change."""
    from desirepath.jobs.aligned import gate_rule
    from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig

    return ConditioningSearchConfig(seed=params.seed, tried=params.tried, gate=gate_rule(params))


def align(context: JobContext, params: ConditioningSearchParams, base: Policy, model: RewardModel) -> Aligned:
    """Shown only where it is better than the instant policy."""
    from desirepath.jobs.aligned import by_name, conditioned_by, departures_of
    from desirepath.learning.alignment.conditioning_search import PLACES, search_conditioning
    from desirepath.learning.scene_sets import Purpose, describe

    artefact, conditioned, weights = conditioned_by(context, params, base, model)
    config = search_config(params)
    result = search_conditioning(conditioned, weights, base, config, context.progress.part(0.03, 0.9))
    judged = {
        "better_than_instant": result.beside_instant.score.as_dict(),
        "preferred_better_than_instant": result.beside_instant.preferred.as_dict(),
        "takes_over": result.takes_over,
    }
    return Aligned(
        policy=result.policy,
        gate=result.gate,
        beside_instant=result.beside_instant,
        config={"recipe": params.recipe, **config.as_dict(), "preference_weights": by_name(weights, base.setup)},
        results={
            **judged,
            "offsets": {place: by_name(row, base.setup) for place, row in zip(PLACES, result.offsets, strict=True)},
            "chosen": result.chosen,
            "history": result.history,
        },
        parents=[(artefact, "conditioned")],
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=departures_of(conditioned, "instant", "conditioning_search"),
        # On its card, too; but where nothing better was found, the policy and its card are the instant one's.
        beside=judged,
    )


ALIGNMENT = Alignment(ConditioningSearchParams, "conditioning-searched policy", align)
