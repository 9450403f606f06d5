"""The policy of somebody whom the nine objectives do not describe: at once the best of a library, then a search among
what the library can be mixed to.

Training by a reward that fifteen answers say badly goes astray (experiments/notebook), and a search can, too; so what
is found takes over only where neither of two posteriors expects less of it in scenes that chose nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.learning.alignment.library_measures import measure_against
from desirepath.learning.alignment.mix_search import ENOUGH_SUCCESS, MixSearchConfig, search_mixes
from desirepath.learning.alignment.policy_library import PolicyLibrary, expected_gains, gains_by_posterior
from desirepath.learning.measures.step_basis import Doubles, StepBasis
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.simulation.scene import Scene

JUDGING_SEED = 7_300  # of scenes that neither a library nor a search has
SCENES = 200
FINAL = 4  # of the best that a search found, judged again


@dataclass(frozen=True)
class SearchedPolicy:
    """policy: without critic. chosen: "start" or "searched"; expected: what the library's policy, and the best that was
    found, are expected to gain, as `expected_gains`."""

    policy: Policy
    chosen: str
    expected: dict[str, float]


def search_policy(
    library: PolicyLibrary,
    place: int,
    policies: tuple[ConditionedPolicy, Policy],
    basis: StepBasis,
    posteriors: tuple[FreePosterior, StepPosterior],
    config: MixSearchConfig,
    on_progress: OnProgress = no_progress,
) -> SearchedPolicy:
    """Search by what the answers speak for; begin with the library's best, of which the one at `place` is what there is
    already. policies: the conditioned and the base policy."""
    conditioned, base = policies

    def judge(candidates: Sequence[Policy], scenes: Sequence[Scene]) -> Doubles:
        measures = measure_against(base, candidates, basis, scenes)
        total: Doubles = gains_by_posterior(measures, *posteriors, among=library.measures).sum(axis=0)
        return total

    expected = expected_gains(library.measures, *posteriors)
    known = search_mixes(library, conditioned, base, expected, judge, config, on_progress)
    start = library.policy(place, conditioned, base).without_critic()
    searched = [
        candidate.policy(library, conditioned.as_trained(), base).without_critic() for candidate, _ in known[:FINAL]
    ]
    scenes = scene_set(base.setup, SCENES, purpose=Purpose.ALIGN_SELECT, seed=JUDGING_SEED + config.seed)
    measures = measure_against(base, [start, *searched], basis, scenes)
    by_posterior = gains_by_posterior(measures, *posteriors, among=library.measures)
    allowed = (by_posterior >= by_posterior[:, :1]).all(axis=0)  # neither expects less of it than of the start
    allowed &= measures.success >= min(ENOUGH_SUCCESS, float(measures.success[0]))
    allowed &= measures.longer_s <= max(library.longest_s, float(measures.longer_s[0]))
    together = by_posterior.sum(axis=0)
    best = int(np.where(allowed, together, -np.inf).argmax())
    by_name = {"start": round(float(together[0]), 4), "searched": round(float(together[1:].max()), 4)}
    return SearchedPolicy([start, *searched][best], "searched" if best else "start", by_name)
