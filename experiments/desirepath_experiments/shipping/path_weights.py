"""The shipped candidates that drawn paths are compared with: what the conditioned policy measures at many weights in
the scenes that are drawn in.
"""

from __future__ import annotations

import numpy as np

from desirepath.learning.cards import Card
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.preferences.from_paths import NOISE, WeightsOfPaths
from desirepath.learning.preferences.measures import measures
from desirepath.learning.preferences.posterior import Posterior, weights_of_shares
from desirepath.learning.shipping.storing import Request
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome

CANDIDATES = 600  # as in the comparison of ways of telling (experiments/notebook)


def ship_path_weights(request: Request) -> Card:
    """Roll out and store `SETUP/path_weights.npz`; a few minutes of one core."""
    setup = request.setup
    conditioned, scenes = load_conditioned(f"{setup}/conditioned"), demonstration_scenes(setup)
    shares = Posterior.prior(setup).sample(CANDIDATES).weights.astype(np.float64)
    np.random.default_rng([request.seed, 163]).shuffle(shares)
    measured, arrived = [], 0
    for number, candidate in enumerate(shares, 1):
        policy = conditioned.at(weights_of_shares(candidate))
        rolled_out = rollout(get_setup(setup), policy.rollout_policy, scenes)
        measured.append(measures(rolled_out))
        arrived += sum(trajectory.outcome == Outcome.SUCCESS for trajectory in rolled_out)
        if number % 20 == 0:
            request.on_progress(number / CANDIDATES, {"candidates": number})
    weights = WeightsOfPaths(setup, shares, np.array(measured), np.full(CANDIDATES, 1 / CANDIDATES))
    return request.store(
        "path_weights",
        "path_weights",
        weights.save,
        f"path-weights {setup}",
        config={"candidates": CANDIDATES, "noise": NOISE},
        scenes={"drawn_in": [scene.seed for scene in scenes]},
        results={"arrived": round(arrived / (CANDIDATES * len(scenes)), 4)},
        parents=request.parents("conditioned"),
        departures=["path_weights"],
        notes=[
            "A hand's path differs from any rollout of the policy: experiments/results/study_room/telling.json says "
            "how far off the weights of drawn paths are."
        ],
    )
