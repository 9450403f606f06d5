"""The policy of somebody whom the nine objectives do not describe: at once the best of a library, then fine-tuned.

Fine-tuning alone goes astray where fifteen answers say the reward badly, so it begins at the library's best and takes
over only where both posteriors, of which one was not trained on, expect more of it in scenes that chose nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backend.learning.alignment.library_measures import measured_against
from backend.learning.alignment.own_reward import OwnRewardConfig, OwnRewardResult, tune_to_reward
from backend.learning.alignment.policy_library import PolicyLibrary, gains_by_posterior
from backend.learning.measures.step_basis import StepBasis
from backend.learning.policies.policy import Policy
from backend.learning.preferences.free_posterior import FreePosterior
from backend.learning.preferences.step_posterior import StepPosterior
from backend.learning.rewards.step_weights import StepWeightsRewardModel
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.td3.base import OnProgress, no_progress

JUDGING_SEED = 7_300  # of scenes that neither a library nor a training has
SCENES = 100
CANDIDATES = ("start", "halfway", "tuned")


@dataclass(frozen=True)
class OwnPolicy:
    """policy: without critic. chosen: of CANDIDATES; expected: what each is expected to gain, as `expected_gains`."""

    policy: Policy
    chosen: str
    expected: dict[str, float]
    tuned: OwnRewardResult


def fine_tuned(
    library: PolicyLibrary,
    start: Policy,
    base: Policy,
    basis: StepBasis,
    posteriors: tuple[FreePosterior, StepPosterior],
    config: OwnRewardConfig,
    on_progress: OnProgress = no_progress,
) -> OwnPolicy:
    """Train on from `start`, of the library, by the reward that the answers speak for; the policy that is expected to
    gain most of the start, the trained one and one halfway between, of those that arrive as often and as soon as asked.
    """
    believed, steps = posteriors
    model = StepWeightsRewardModel(base.setup, basis, steps.mean.astype(np.float32))
    tuned = tune_to_reward(base, model, config, on_progress, start=start)
    halfway = tuple(np.float32(0.5) * (one + other) for one, other in zip(start.actor, tuned.policy.actor, strict=True))
    candidates = [start.without_critic(), replace(tuned.policy, actor=halfway), tuned.policy]
    scenes = scene_set(base.setup, SCENES, purpose=Purpose.ALIGN_SELECT, seed=JUDGING_SEED + config.seed)
    measures = measured_against(base, candidates, basis, scenes)
    by_posterior = gains_by_posterior(measures, believed, steps)
    expected = by_posterior.sum(axis=0)
    enough = min(config.min_success, float(measures.success[0])) - config.max_selection_loss
    allowed = (measures.success >= enough) & (measures.longer_s <= max(library.longest_s, measures.longer_s[0]))
    allowed &= (by_posterior >= by_posterior[:, :1]).all(axis=0)  # neither expects less of it than of the start
    best = int(np.where(allowed, expected, -np.inf).argmax())
    by_name = dict(zip(CANDIDATES, (round(float(one), 4) for one in expected), strict=True))
    return OwnPolicy(candidates[best], CANDIDATES[best], by_name, tuned)
