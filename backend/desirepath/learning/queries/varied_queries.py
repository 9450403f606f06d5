"""Queries that differ in everything people may prefer: trajectories of a conditioned policy at drawn preference
weights.

An ensemble's pairs hardly differ in speed near the person, and what they differ in goes together (the longer trajectory
is the later and the curvier one). Here pairs come from different preference weights, and are chosen so that no measure
can stand for another. Filters and storage are those of `queries.py`. Ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.cards import stored_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.preferences.measures import measures, table_of, typical_differences
from desirepath.learning.preferences.objectives import OPPOSITES, SIZE, names_of, preference_weights
from desirepath.learning.queries.queries import (
    Query,
    QueryConfig,
    QuerySet,
    flaw,
    look_alike,
    round_observations,
    scene_rounds,
)
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
OnProgress = Callable[[float, dict[str, float]], None]

LARGEST_DIFFERENCE = 1.5  # standard deviations: a larger one is no clearer, so it counts no more when pairs are chosen
SPREAD_WORTH = 0.05
EXCHANGE_ROUNDS = 2
FEWEST_IN_ORDER = 3


@dataclass(frozen=True)
class VariedConfig:
    """Ours. settings: how many settings of the preference weights are rolled out per scene: each objective alone at
    full strength, the rest drawn. scenes_per_query: of so many scenes one gives a query.
    """

    queries: QueryConfig = field(default_factory=QueryConfig)
    settings: int = 14
    pairs_per_scene: int = 20
    scenes_per_query: int = 2

    def as_dict(self) -> dict[str, Any]:
        return stored_config(self)


def draw_weights(count: int, seed: int, setup: str = "study_room") -> list[Floats]:
    """`count` settings (9,): each objective alone, then two or three together, each at 0.4 to 1."""
    random = np.random.default_rng([seed, 31])
    settings = [preference_weights({name: 1.0}) for name in names_of(setup)[:count]]
    while len(settings) < count:
        chosen = random.choice(SIZE, int(random.integers(2, 4)), replace=False)
        if not any(a in chosen and b in chosen for a, b in OPPOSITES):
            strengths = random.uniform(0.4, 1.0, len(chosen))
            named = {names_of(setup)[k]: float(s) for k, s in zip(chosen, strengths, strict=True)}
            settings.append(preference_weights(named))
    return settings


def generate_varied_queries(
    conditioned: ConditionedPolicy, config: VariedConfig | None = None, on_progress: OnProgress | None = None
) -> QuerySet:
    """As many queries as asked for, each from another scene; a query's `members` are places in `drawn_wants`.

    Raises LearningError if `max_scenes` scenes do not give that many.
    """
    config = config or VariedConfig()
    asked, setup = config.queries, get_setup(conditioned.setup)
    random = np.random.default_rng([asked.seed, 32])
    trained = conditioned.as_trained()
    policies = [trained.at(weights) for weights in draw_weights(config.settings, asked.seed, setup.name)]
    reasons = ("collision", "timeout", "self_intersection", "too_long", "too_short", "look_alike", "one_drive_left")
    filtered = dict.fromkeys(reasons, 0) | {"drives": 0, "scenes": 0}
    candidates: list[Query] = []
    places: list[int] = []
    needed = asked.count * config.scenes_per_query
    first = 0
    for round_scenes in scene_rounds(setup.name, asked):
        trajectories = [rollout(setup, policy.rollout_policy, round_scenes) for policy in policies]
        for row in range(len(round_scenes)):
            if len(set(places)) == needed:
                break
            filtered["scenes"] += 1
            good = []
            for k, of_policy in enumerate(trajectories):
                filtered["drives"] += 1
                reason = flaw(of_policy[row], asked)
                if reason is None:
                    good.append(k)
                else:
                    filtered[reason] += 1
            if len(good) < 2:
                filtered["one_drive_left"] += 1
                continue
            pairs = [(i, j) for i in good for j in good if i != j]
            found = 0
            for k in random.permutation(len(pairs)):
                a, b = (trajectories[member][row] for member in pairs[k])
                if look_alike(a, b, asked):
                    filtered["look_alike"] += 1
                    continue
                candidates.append(Query(a.scene, a, b, pairs[k]))
                places.append(first + row)
                found += 1
                if found == config.pairs_per_scene:
                    break
        first += len(round_scenes)
        scenes_found = len(set(places))
        if on_progress:
            on_progress(0.9 * min(1.0, scenes_found / needed), {"scenes": scenes_found})
        if scenes_found == needed:
            break
    if len(set(places)) < asked.count:
        raise LearningError(
            f"count = {asked.count}: {asked.max_scenes} scenes gave only {len(set(places))} with two trajectories to "
            f"show; dropped: {filtered}. Ask for fewer or allow longer trajectories (max_duration_s)."
        )
    chosen = balance(differences_of(candidates), places, asked.count)
    order = random.permutation(len(chosen))
    queries = [candidates[chosen[k]] for k in order]
    kept = [
        Query(q.scene, round_observations(q.trajectory_a), round_observations(q.trajectory_b), q.members)
        for q in queries
    ]
    return QuerySet(setup.name, tuple(kept), filtered)


def several_in_scene(
    conditioned: ConditionedPolicy, given: Sequence[Trajectory], count: int, rules: QueryConfig
) -> list[Trajectory]:
    """`count` trajectories of one scene that people can put in order: those given, and of the policy's at drawn
    preference weights one after the other that differs most from all so far, in typical differences. Fewer where the
    others have flaws, at least `FEWEST_IN_ORDER`.
    """
    chosen, setup = list(given)[:count], get_setup(conditioned.setup)
    typical = typical_differences(setup.name)
    drawn = draw_weights(VariedConfig().settings, 0, setup.name)
    others = [rollout(setup, conditioned.at(weights).rollout_policy, [chosen[0].scene])[0] for weights in drawn]
    bad = np.array([1.0 if flaw(one, rules) else 0.0 for one in others])
    of_others, seen = measures(others) / typical, measures(chosen) / typical
    while len(chosen) < count:
        gaps = np.minimum(np.abs(of_others[:, None] - seen[None]), LARGEST_DIFFERENCE).sum(axis=2).min(axis=1)
        best = int((gaps - 1e3 * bad).argmax())
        if bad[best] and len(chosen) >= FEWEST_IN_ORDER:
            break
        chosen.append(others[best])
        seen, bad[best] = np.vstack([seen, of_others[best]]), 2.0
    return chosen


def differences_of(queries: Sequence[Query]) -> Doubles:
    """(n, 7) measures of A minus those of B, in their units."""
    judged = measures([trajectory for query in queries for trajectory in (query.trajectory_a, query.trajectory_b)])
    differences: Doubles = judged[0::2] - judged[1::2]
    return differences


def balance(differences: Doubles, places: Sequence[int], count: int) -> list[int]:
    """`count` rows of (n, 7) differences, no two of one place (scene).

    Measures shall vary, and vary independently: a greedy D-optimal choice, then rows are exchanged, one at a time,
    while that lowers the sum of fourth powers of the correlations minus SPREAD_WORTH times the sum of the logarithms of
    the variances.
    """
    rows = np.clip(differences / differences.std(axis=0), -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE)
    of_place = np.asarray(places)
    outer = np.einsum("ni,nj->nij", rows, rows)
    inverse = np.eye(rows.shape[1])
    taken = np.zeros(len(rows), dtype=np.bool_)
    chosen: list[int] = []
    for _ in range(count):
        adds = np.einsum("ij,jk,ik->i", rows, inverse, rows)
        adds[taken] = -1.0
        chosen.append(int(adds.argmax()))
        taken |= of_place == of_place[chosen[-1]]
        direction = inverse @ rows[chosen[-1]]
        inverse -= np.outer(direction, direction) / (1.0 + rows[chosen[-1]] @ direction)
    total = outer[chosen].sum(axis=0)
    least = float(_imbalance(total, count))
    for place in [k for _ in range(EXCHANGE_ROUNDS) for k in range(count)]:
        rest = total - outer[chosen[place]]
        costs = _imbalance(rest + outer, count)
        costs[taken & (of_place != of_place[chosen[place]])] = np.inf
        best = int(costs.argmin())
        if costs[best] < least - 1e-12:
            taken[of_place == of_place[chosen[place]]] = False
            taken[of_place == of_place[best]] = True
            chosen[place], total, least = best, rest + outer[best], float(costs[best])
    return chosen


def _imbalance(totals: Doubles, count: int) -> Doubles:
    """(...) what `balance` lowers, of sums of outer products (..., 7, 7)."""
    first, second = np.triu_indices(totals.shape[-1], 1)
    variances = np.diagonal(totals, axis1=-2, axis2=-1) / count + 1e-9
    correlations = totals[..., first, second] / count / np.sqrt(variances[..., first] * variances[..., second])
    cost: Doubles = (correlations**4).sum(axis=-1) - SPREAD_WORTH * np.log(variances).sum(axis=-1)
    return cost


def describe_differences(query_set: QuerySet) -> dict[str, Any]:
    """How the pairs of a set differ: per measure, and how measures go together.

    measures: {name: {sd, noticeable_difference, noticeable_share}}; correlations: of the differences, (7, 7) nested
    lists; largest_correlation: the largest off its diagonal by size, and between which.
    """
    differences = differences_of(query_set.queries)
    if len(differences) < 3:
        raise LearningError(f"queries = {len(differences)}: too few to describe how they differ")
    table = table_of(query_set.setup)
    spread = [float(column.std()) for column in differences.T]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlations: Doubles = np.nan_to_num(np.asarray(np.corrcoef(differences.T)))
    off = np.abs(correlations - np.diag(np.diag(correlations)))
    i, j = divmod(int(off.argmax()), len(table))
    between = float(correlations[i, j])
    return {
        "setup": query_set.setup,
        "queries": len(query_set),
        "measures": {
            measure.name: {
                "sd": spread[k],
                "noticeable_difference": measure.noticeable,
                "noticeable_share": float((np.abs(differences[:, k]) >= measure.noticeable).mean()),
            }
            for k, measure in enumerate(table)
        },
        "correlations": correlations.tolist(),
        "largest_correlation": {"between": [table[i].name, table[j].name], "value": between},
    }
