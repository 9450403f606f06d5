"""Queries of policies that differ in more than the nine objectives: the conditioned policy at drawn weights, the
ensemble, the base policy, and all of these in drawn manners (`policies/manners.py`).

Chosen so that answers tell different people of `population_prior.py` apart. Filters and storage are those of
`queries.py`. All ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.cards import stored_config
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.policies.manners import Manner, MannerPolicy
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.preferences.population_prior import columns_of, shipped_priors
from desirepath.learning.queries.queries import Query, QueryConfig, QuerySet, flaw, look_alike, round_observations
from desirepath.learning.queries.varied_queries import draw_weights
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.acting import ActFunction, EpisodicPolicy
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
OnProgress = Callable[[float, dict[str, float]], None]
TRIES = 3  # drawings of a pair for each that is wanted
LENGTH = 1.5  # typical differences: a larger pair is no clearer, so it counts no more when pairs are chosen


@dataclass(frozen=True)
class MannerConfig:
    """Ours. settings: drawn weights of the conditioned policy; manners: policies in a manner; pairs_per_scene: at most;
    scenes_per_query: of so many scenes one gives a query."""

    queries: QueryConfig = field(default_factory=QueryConfig)
    settings: int = 20
    manners: int = 30
    pairs_per_scene: int = 8
    scenes_per_query: int = 2

    def as_dict(self) -> dict[str, Any]:
        return stored_config(self)


def varied_policies(setup: str, config: MannerConfig) -> list[ActFunction | EpisodicPolicy]:
    """What rolls out; the same for the same seed."""
    seed = config.queries.seed
    random = np.random.default_rng([seed, 5])
    conditioned, base, ensemble = (
        load_conditioned(f"{setup}/conditioned").as_trained(),
        load_policy(f"{setup}/base"),
        load_ensemble(setup),
    )
    own = [conditioned.at(weights) for weights in draw_weights(config.settings, seed)]
    others = [conditioned.at(weights) for weights in draw_weights(config.settings, seed + 1)]
    usual = [base, *ensemble, *others]
    found = [policy.rollout_policy for policy in (*own, *ensemble, base)]
    for _ in range(config.manners):
        act = usual[int(random.integers(len(usual)))].act
        found.append(MannerPolicy(get_setup(setup), act, Manner.drawn(random)))
    return found


def manner_pairs(setup: str, scenes: Sequence[Scene], config: MannerConfig) -> list[tuple[Trajectory, Trajectory]]:
    """Pairs without a flaw that look different, scene by scene; both letters by chance."""
    rolled_out = [rollout(get_setup(setup), policy, list(scenes)) for policy in varied_policies(setup, config)]
    random = np.random.default_rng([config.queries.seed, 6])
    pairs: list[tuple[Trajectory, Trajectory]] = []
    for of_scene in zip(*rolled_out, strict=True):
        good = [one for one in of_scene if flaw(one, config.queries) is None]
        found = 0
        for _ in range(TRIES * config.pairs_per_scene if len(good) > 1 else 0):
            i, j = random.choice(len(good), 2, replace=False)
            if found < config.pairs_per_scene and not look_alike(good[i], good[j], config.queries):
                pairs.append((good[i], good[j]))
                found += 1
    return pairs


def generate_manner_queries(
    setup: str, config: MannerConfig | None = None, on_progress: OnProgress | None = None
) -> QuerySet:
    """As many queries as asked for, each from another scene. Raises LearningError where scenes do not give so many."""
    config = config or MannerConfig()
    count = config.queries.count
    scenes = scene_set(setup, count * config.scenes_per_query, purpose=Purpose.QUERIES, seed=config.queries.seed)
    pairs: list[tuple[Trajectory, Trajectory]] = []
    for first in range(0, len(scenes), config.queries.scenes_per_round):
        pairs += manner_pairs(setup, scenes[first : first + config.queries.scenes_per_round], config)
        if on_progress:
            on_progress(0.9 * min(1.0, (first + config.queries.scenes_per_round) / len(scenes)), {"pairs": len(pairs)})
    places = [pair[0].scene.seed for pair in pairs]
    if len(set(places)) < count:
        raise LearningError(f"count = {count}: {len(scenes)} scenes gave only {len(set(places))} with a pair to show")
    chosen = separating(PairDifferences.of(setup, pairs), places, count)
    order = np.random.default_rng([config.queries.seed, 7]).permutation(chosen)
    queries = [
        Query(pairs[k][0].scene, round_observations(pairs[k][0]), round_observations(pairs[k][1]), (0, 1))
        for k in order
    ]
    return QuerySet(setup, tuple(queries), {"pairs": len(pairs), "scenes": len(scenes)})


def separating(differences: PairDifferences, places: Sequence[int], count: int) -> list[int]:
    """`count` pairs, no two of one place (scene), whose answers tell most about people of the shipped priors before
    anybody answered: a greedy D-optimal choice over what such people differ by."""
    columns = columns_of(differences)
    rows = np.concatenate([columns @ prior.factor for prior in shipped_priors(differences.setup)] or [columns], axis=1)
    rows /= np.maximum(
        1.0, np.linalg.norm(rows, axis=1, keepdims=True) / (LENGTH * np.sqrt(np.square(rows).sum(1).mean()))
    )
    of_place, taken = np.asarray(places), np.zeros(len(rows), dtype=np.bool_)
    inverse = np.eye(rows.shape[1])
    chosen: list[int] = []
    for _ in range(count):
        adds = np.einsum("ij,ij->i", rows @ inverse, rows)
        adds[taken] = -1.0
        chosen.append(int(adds.argmax()))
        taken |= of_place == of_place[chosen[-1]]
        direction = inverse @ rows[chosen[-1]]
        inverse -= np.outer(direction, direction) / (1.0 + rows[chosen[-1]] @ direction)
    return chosen
