"""A policy for somebody whom the nine objectives do not describe: the best of the setup's library by what their answers
say.

Only where the answers are more probably about something else, and only what is surely better for this very person: the
verdict is given in scenes of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from desirepath.jobs.aligned import gate_rule
from desirepath.jobs.alignment import Aligned, AlignParams
from desirepath.jobs.context import JobContext
from desirepath.learning.alignment.gate import at_gate
from desirepath.learning.alignment.never_worse import PersonalVerdict, better_for_person
from desirepath.learning.alignment.policy_library import best_of
from desirepath.learning.cards import DEPARTURES
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy_library, load_step_basis
from desirepath.learning.preferences.free_posterior import SOMETHING_ELSE, FreePosterior
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.step_weights import step_posterior_of

STANDS_IN_FOR = ("instant", "conditioning_search")
FEWEST_ANSWERS = 8


def free_form(
    context: JobContext, params: AlignParams, base: Policy, believed: FreePosterior, preferences: Sequence[Preference]
) -> tuple[Aligned, PersonalVerdict] | None:
    """The policy with its verdict; None where the nine describe the answers, there are few, or the setup has no step
    basis or library."""
    if (
        params.algorithm not in STANDS_IN_FOR
        or len(preferences) < FEWEST_ANSWERS
        or believed.something_else() < SOMETHING_ELSE
    ):
        return None
    basis, library = load_step_basis(base.setup), load_policy_library(base.setup)
    if basis is None or library is None:
        return None
    steps = step_posterior_of(preferences, basis)
    place = best_of(library, believed, steps)
    policy = library.policy(place, load_conditioned(f"{base.setup}/conditioned"), base).without_critic()
    gate = at_gate(policy, base, gate_rule(params), seed=params.seed)
    verdict = better_for_person(believed, policy, base, seed=params.seed, needed=params.surely_better)
    aligned = Aligned(
        policy=policy,
        gate=gate,
        config={"recipe": "own_policy_library", "place": place},
        results={"step_weights": [round(float(weight), 4) for weight in steps.mean]},
        departures=[DEPARTURES["free_form"], DEPARTURES["policy_library"]],
        beside={"free_form": True},
    )
    return aligned, verdict
