"""A policy for somebody whom the nine objectives do not describe: trained on the reward that their answers speak for.

Only where the answers are more probably about something else, and only what is surely better for this very person: the
verdict is given by the posterior that nothing here was trained on.
"""

from __future__ import annotations

from collections.abc import Sequence

from backend.jobs.alignment_algorithms import Aligned, gate_rule
from backend.jobs.context import JobContext
from backend.jobs.kinds import AlignParams
from backend.learning.alignment.never_worse import PersonalVerdict, better_for_person
from backend.learning.alignment.own_reward import OwnRewardConfig, tune_to_reward
from backend.learning.cards import DEPARTURES
from backend.learning.policies.policy import Policy
from backend.learning.policies.shipped import load_step_basis
from backend.learning.preferences.free_posterior import FreePosterior
from backend.learning.preferences.preferences import Preference
from backend.learning.rewards.step_weights import fit_step_weights
from backend.learning.scene_sets import Purpose, describe

SOMETHING_ELSE = 0.5
"""From this probability on, answers count as being about something that is not among the nine objectives."""
UPDATES = {"instant": 1_500, "conditioning_search": 6_000}
"""By what it stands in for: a few seconds of a core while somebody waits; half a minute of a shared one behind it."""
FEWEST_ANSWERS = 8


def free_form(
    context: JobContext, params: AlignParams, base: Policy, believed: FreePosterior, preferences: Sequence[Preference]
) -> tuple[Aligned, PersonalVerdict] | None:
    """The policy with its verdict; None where the nine describe the answers, there are few, or the setup has no step
    basis."""
    updates = UPDATES.get(params.algorithm)
    if updates is None or len(preferences) < FEWEST_ANSWERS or believed.something_else() < SOMETHING_ELSE:
        return None
    basis = load_step_basis(base.setup)
    if basis is None:
        return None
    model = fit_step_weights(preferences, basis)
    config = OwnRewardConfig(
        seed=params.seed, updates=updates, checkpoints=max(3, updates // 1_000), gate=gate_rule(params)
    )
    tuned = tune_to_reward(base, model, config, context.progress.part(0.3, 0.9))
    verdict = better_for_person(believed, tuned.policy, base, seed=params.seed, needed=params.surely_better)
    made = Aligned(
        policy=tuned.policy,
        gate=tuned.gate,
        may_be_shown=tuned.gate.passed,
        config={**config.as_dict(), "replay_sha256": tuned.replay_sha256},
        results={
            "step_weights": [round(float(weight), 4) for weight in model.weights],
            "chosen_checkpoint": tuned.chosen,
            "gained": tuned.gained,
            "history": tuned.history,
        },
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=[DEPARTURES["free_form"]],
        beside={"free_form": True},
    )
    return made, verdict
