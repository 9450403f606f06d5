"""As `each_scene`, and one policy more to choose from: trained, in half a minute, on what answers say of every step.

It runs behind `each_scene` and takes its place where the participant has not come to the comparison before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from desirepath.jobs.alignment import Aligned, Alignment
from desirepath.jobs.alignments.each_scene import ChoiceParams, choose
from desirepath.jobs.params import from_source

if TYPE_CHECKING:
    from desirepath.jobs.context import JobContext
    from desirepath.learning.policies.choosing import Answers
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel


class EachSceneTrainedParams(ChoiceParams):
    """A choice per scene, one policy of which is trained on the answers.

    updates: of its critic.
    """

    recipe: Literal["each_scene_trained"] = from_source("ours_behind_each_scene", "each_scene_trained")
    updates: int = from_source("ours", 13_500, ge=1, le=200_000)


def align(context: JobContext, params: EachSceneTrainedParams, base: Policy, model: RewardModel) -> Aligned:
    """Raises as `choose`, and LearningError for a base policy without critic."""
    from desirepath.learning.alignment.own_reward import OwnRewardConfig, OwnRewardResult, train_on_answers
    from desirepath.learning.policies.shipped import load_step_basis

    del model  # both posteriors are this one's own

    def train(answers: Answers) -> OwnRewardResult:
        basis = load_step_basis(base.setup)
        assert basis is not None  # noqa: S101 - there are no answers by it else
        config = OwnRewardConfig.of(params.updates, params.seed)
        return train_on_answers(base, basis, answers.believed[1], config, context.progress.part(0.03, 0.8))

    return choose(context, params, base, train)


ALIGNMENT = Alignment(EachSceneTrainedParams, "policy per scene, one trained", align, asks_directly=True)
