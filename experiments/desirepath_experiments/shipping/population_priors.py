"""Priors over what people weigh, fitted to simulated people of the families that may be tuned on, and stored beside the
code that uses them. Nobody who is measured by `benchmark people` is among them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.people.card import member, people_card
from desirepath.learning.preferences.population_prior import FOLDER, columns_of, fit_prior, to_bytes
from desirepath.learning.preferences.setup_settings import longest_shown_s
from desirepath.learning.queries.manner_queries import MannerConfig, manner_pairs
from desirepath.learning.queries.queries import QueryConfig
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.shipping.storing import Request

FAMILIES = ("network", "mixture", "thresholds", "lexicographic")  # `changing` is people of `network`, one after another
FIRST_MEMBER = 2_000  # numbers below are for measuring
MEMBERS = 300
SCENES = 700
PAIRS_PER_SCENE = 3
SEED = 921


def ship_population_priors(request: Request) -> Path:
    """Fit and store them where the code finds them; returns the file."""
    setup, folder = request.setup, FOLDER
    config = MannerConfig(
        QueryConfig(seed=SEED, max_duration_s=longest_shown_s(setup)), pairs_per_scene=PAIRS_PER_SCENE
    )
    pairs = manner_pairs(setup, scene_set(setup, SCENES, purpose=Purpose.QUERIES, seed=SEED), config)
    columns = columns_of(PairDifferences.of(setup, pairs))
    trajectories = [trajectory for pair in pairs for trajectory in pair]
    priors = []
    for place, family in enumerate(FAMILIES):
        scores = np.empty((MEMBERS, len(pairs)))
        for k in range(MEMBERS):
            person = member(f"{family}:{FIRST_MEMBER + k}", setup)
            valued = person.scores(trajectories) / person.unit(setup)
            scores[k] = valued[0::2] - valued[1::2]
            request.on_progress((place + (k + 1) / MEMBERS) / len(FAMILIES), {"people": place * MEMBERS + k + 1})
        priors.append(fit_prior(family, columns, scores))
    made_from = {"families": list(FAMILIES), "members": [FIRST_MEMBER, FIRST_MEMBER + MEMBERS - 1], "pairs": len(pairs)}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{setup}.npz"
    path.write_bytes(to_bytes(setup, tuple(priors), made_from | {"card_version": people_card().version, "seed": SEED}))
    return path
