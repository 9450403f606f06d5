"""Is a policy better than the usual one for this very person? By their own posterior, in scenes that chose nothing.

What of it decides, together with how it drives for anybody, is `gate.py`'s.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from desirepath.learning.alignment.gate import CLEARLY, SURE, surely_better
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.sureness import LEAST_GAIN, Sureness
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Outcome

SCENES = 200  # ours; half a second of a core
JUDGING_SEED = 10_000  # of the gate's scenes, beyond those that any gate has


@dataclass(frozen=True)
class PersonalVerdict:
    """probability_better: that this person prefers its rollouts to the base policy's, on average over the scenes in
    which both arrive; probability_clearly_better: by `least_gain` typical differences. needed, clearly_needed: what was
    asked of these. scenes: how many these were; something_else: probability that what the answers are about is not
    among the nine objectives."""

    passed: bool
    probability_better: float
    needed: float
    scenes: int
    something_else: float
    probability_clearly_better: float
    clearly_needed: float = CLEARLY
    least_gain: float = LEAST_GAIN

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def better_for_person(
    posterior: FreePosterior,
    own: DrivingPolicy,
    base: DrivingPolicy,
    *,
    seed: int,
    needed: float = SURE,
    scenes: int = SCENES,
) -> PersonalVerdict:
    """Both policies roll out in the same scenes. Raises SetupError where setups differ."""
    setup = get_setup(require_same(own=own.setup, base=base.setup, answers=posterior.setup))
    drawn = scene_set(setup.name, scenes, purpose=Purpose.GATE, seed=JUDGING_SEED + seed)
    rolled_out = [rollout(setup, policy.rollout_policy, drawn) for policy in (own, base)]
    both = [
        pair
        for pair in zip(*rolled_out, strict=True)
        if all(trajectory.outcome == Outcome.SUCCESS for trajectory in pair)
    ]
    moved = [pair for pair in both if not np.array_equal(pair[0].poses, pair[1].poses)]
    symmetry = posterior.config.posterior.left_right_symmetry
    differences = PairDifferences.of(setup.name, both, left_right_symmetry=symmetry) if moved else None
    sure = Sureness.of(posterior, differences)
    something_else = posterior.something_else()
    return PersonalVerdict(surely_better(sure, needed), sure.better, needed, len(both), something_else, sure.clearly)
