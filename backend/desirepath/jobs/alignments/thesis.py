"""The thesis's recipe: relabels the base policy's replay buffer and learns from it alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from desirepath.jobs.alignment import Aligned, Alignment, AlignParams
from desirepath.jobs.params import ModelName, from_source

if TYPE_CHECKING:
    from desirepath.jobs.context import JobContext
    from desirepath.learning.alignment.relabelling import RelabellingConfig
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel


class ThesisParams(AlignParams):
    """The thesis's recipe: relabels the base policy's replay buffer and learns from it alone.

    reward_weight: lambda of equation 6.5, the learned reward's share. updates: of the critic, in three epochs.
    """

    recipe: Literal["thesis"] = from_source("thesis_6_4_5", "thesis")
    model: ModelName = from_source("thesis_6_4_4", "mlp", advanced=True)
    reward_weight: float = from_source("table_6_1", 0.06, gt=0, le=1)
    updates: int = from_source("thesis_6_4_5", 30_000, ge=1, le=200_000)


def training_config(params: ThesisParams) -> RelabellingConfig:
    """The algorithm's configuration with what the parameters change."""
    from desirepath.jobs.aligned import with_params
    from desirepath.learning.alignment.thesis import ThesisConfig

    return with_params(ThesisConfig(), params, updates=params.updates, reward_weight=params.reward_weight)


def align(context: JobContext, params: ThesisParams, base: Policy, model: RewardModel) -> Aligned:
    from desirepath.jobs.aligned import train

    return train(context, params, training_config(params), base, model)


ALIGNMENT = Alignment(ThesisParams, "relabelled policy", align)
