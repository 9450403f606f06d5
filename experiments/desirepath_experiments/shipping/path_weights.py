"""Makes the shipped candidates that drawn paths are compared with: what the conditioned policy measures at many weights
in the scenes that are drawn in, with their card.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.preferences.from_paths import NOISE, WeightsOfPaths
from desirepath.learning.preferences.measures import measures
from desirepath.learning.preferences.posterior import Posterior, weights_of_shares
from desirepath.learning.td3.base import OnProgress
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome

CANDIDATES = 600  # as in the comparison of ways of telling (docs/numbers.md)


def ship_path_weights(setup: str, seed: int, folder: Path, on_progress: OnProgress, count: int = CANDIDATES) -> Card:
    """Roll out and store `SETUP/path_weights.npz`; a few minutes of one core."""
    conditioned = load_conditioned(f"{setup}/conditioned")
    scenes = demonstration_scenes(setup)
    shares = Posterior.prior(setup).sample(count).weights.astype(np.float64)
    np.random.default_rng([seed, 163]).shuffle(shares)
    measured, arrived = [], 0
    for number, candidate in enumerate(shares, 1):
        policy = conditioned.at(weights_of_shares(candidate))
        rolled_out = rollout(get_setup(setup), policy.rollout_policy, scenes)
        measured.append(measures(rolled_out))
        arrived += sum(one.outcome == Outcome.SUCCESS for one in rolled_out)
        if number % 20 == 0:
            on_progress(number / count, {"candidates": number})
    path = folder / setup / "path_weights.npz"
    WeightsOfPaths(setup, shares, np.array(measured), np.full(count, 1 / count)).save(path)
    card = Card(
        kind="path_weights",
        name=f"{setup}/path_weights",
        setup=setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship path-weights {setup} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        config={"candidates": count, "noise": NOISE},
        scenes={"drawn_in": [scene.seed for scene in scenes]},
        results={"arrived": round(arrived / (count * len(scenes)), 4)},
        parents={f"{setup}/conditioned": file_sha256(folder / setup / "conditioned.npz")},
        departures=[DEPARTURES["path_weights"]],
        notes=[
            "A hand's path differs from any rollout of the policy: `desirepath benchmark telling` says how far off the "
            "weights of drawn paths are (experiments/results/study_room/telling.json)."
        ],
    )
    card.save(card_path(path))
    return card
