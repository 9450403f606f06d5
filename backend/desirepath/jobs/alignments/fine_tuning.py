"""Goes on training the base policy on its core reward and the learned one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from desirepath.jobs.alignment import Aligned, Alignment, AlignParams
from desirepath.jobs.params import ModelName, from_source

if TYPE_CHECKING:
    from desirepath.jobs.context import JobContext
    from desirepath.learning.alignment.relabelling import RelabellingConfig
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel


class FineTuningParams(AlignParams):
    """Goes on training the base policy on its core reward and the learned one (recipe B).

    reward_weight: of the learned reward; None: found while training, by success. updates: of the critic.
    """

    recipe: Literal["fine_tuning"] = from_source("ours_in_session", "fine_tuning")
    model: ModelName = from_source("ours_few_answers", "linear", advanced=True)
    reward_weight: float | None = from_source("follows_success", None, gt=0, le=10)
    updates: int = from_source("ours", 8_000, ge=1, le=200_000)


def training_config(params: FineTuningParams) -> RelabellingConfig:
    """The algorithm's configuration with what the parameters change."""
    from desirepath.jobs.aligned import with_params
    from desirepath.learning.alignment.fine_tuning import FineTuningConfig

    return with_params(FineTuningConfig(), params, updates=params.updates, reward_weight=params.reward_weight)


def align(context: JobContext, params: FineTuningParams, base: Policy, model: RewardModel) -> Aligned:
    from desirepath.jobs.aligned import train
    from desirepath.learning.cards import DEPARTURES

    return train(context, params, training_config(params), base, model, [DEPARTURES["fine_tuning"]])


ALIGNMENT = Alignment(FineTuningParams, "fine-tuned policy", align)
