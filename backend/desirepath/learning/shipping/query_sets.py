"""Shipped query sets with their cards. How pairs are found lives in `desirepath.learning.queries`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from desirepath.learning.cards import Card
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.setup_settings import longest_shown_s
from desirepath.learning.queries.manner_queries import MannerConfig, generate_manner_queries
from desirepath.learning.queries.queries import QueryConfig, QuerySet, generate_queries, path_gap_m
from desirepath.learning.queries.varied_queries import VariedConfig, describe_differences, generate_varied_queries
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.shipping.storing import Request

Config = QueryConfig | VariedConfig | MannerConfig
"""Of a varied query; the field's robot is slow."""


def ship_queries(request: Request, trajectories: int = 2) -> Card:
    """Make, describe and store queries by the ensemble in the same folder."""
    config = replace(_shown_config(request), trajectories=trajectories)
    members = _ensemble(request)
    queries = generate_queries([Policy.load(request.path(member)) for member in members], config, request.on_progress)
    command, stem = ("triples", "queries_triples") if trajectories == 3 else ("queries", "queries")
    return _store(request, queries, stem, command, config, members)


def ship_triples(request: Request) -> Card:
    """Three trajectories in each scene, every pair of them a query."""
    return ship_queries(request, trajectories=3)


def ship_varied_queries(request: Request) -> Card:
    """Make, describe and store queries by the conditioned policy in the same folder, balanced over the measures."""
    config = VariedConfig(_shown_config(request))
    driver = ConditionedPolicy.load(request.path("conditioned"))
    queries = generate_varied_queries(driver, config, request.on_progress)
    return _store(request, queries, "queries_varied", "varied-queries", config, ["conditioned"], "varied")


def ship_manner_queries(request: Request) -> Card:
    """Make, describe and store queries of policies in many manners in the same folder."""
    config = MannerConfig(_shown_config(request))
    queries = generate_manner_queries(request.setup, config, request.on_progress)
    parents = [*_ensemble(request), "base", "conditioned"]
    return _store(request, queries, "queries_manners", "manner-queries", config, parents, "manners")


def _shown_config(request: Request) -> QueryConfig:
    most = min(QueryConfig.max_scenes, 50 * request.count)
    return QueryConfig(request.count, seed=request.seed, max_duration_s=longest_shown_s(request.setup), max_scenes=most)


def _ensemble(request: Request) -> list[str]:
    return [f"ensemble/{path.stem}" for path in sorted(request.path("ensemble/0").parent.glob("*.npz"))]


def _store(
    request: Request, queries: QuerySet, stem: str, what: str, config: Config, parents: list[str], departure: str = ""
) -> Card:
    """what: the subcommand that makes it. departure: of sets whose pairs differ in every measure, which is told."""
    count = (config if isinstance(config, QueryConfig) else config.queries).count
    more = {"differences": describe_differences(queries)} if departure else {}
    return request.store(
        "query_set",
        f"{stem}_{count}",
        queries.save,
        f"{what} {request.setup} --count {count}",
        config=config.as_dict(),
        scenes={"drawn": describe(Purpose.QUERIES, queries.filtered["scenes"], request.seed)},
        results=describe_queries(queries) | more,
        parents=request.parents(*parents),
        departures=["pair_filters", *([departure] if departure else [])],
        notes=["Observations are stored rounded to float16 and were rounded before anything was made from them."],
    )


def describe_queries(queries: QuerySet) -> dict[str, Any]:
    """Numbers of a query set for its card."""
    shown = [trajectory for query in queries.queries for trajectory in (query.trajectory_a, query.trajectory_b)]
    durations = np.array([trajectory.duration_s for trajectory in shown])
    gaps = np.array([path_gap_m(query.trajectory_a, query.trajectory_b) for query in queries.queries])
    return {
        "queries": len(queries),
        "filtered": queries.filtered,
        "duration_s": {"min": float(durations.min()), "mean": float(durations.mean()), "max": float(durations.max())},
        "path_gap_m": {"min": float(gaps.min()), "median": float(np.median(gaps)), "max": float(gaps.max())},
    }
