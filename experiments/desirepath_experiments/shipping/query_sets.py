"""Shipped query sets with their cards. How pairs are found lives in `desirepath.learning.queries`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from desirepath.installed import DATASETS
from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.queries.manner_queries import MannerConfig, generate_manner_queries
from desirepath.learning.queries.queries import QueryConfig, QuerySet, generate_queries, path_gap_m
from desirepath.learning.queries.varied_queries import VariedConfig, describe_differences, generate_varied_queries
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.td3.base import OnProgress, no_progress

SHIPPED_QUERIES = 200
LONGEST_SHOWN_S = {
    "study_room": 12.0,
    "open_field": 20.0,
    "crowd_hall": 16.0,
}  # of a varied query; the field's robot is slow


def ship_queries(
    setup: str,
    seed: int = 0,
    folder: Path = DATASETS,
    on_progress: OnProgress = no_progress,
    count: int = SHIPPED_QUERIES,
    trajectories: int = 2,
) -> Card:
    """Make, describe and store queries by the ensemble in the same folder; of three trajectories each scene:
    triples.
    """
    config = QueryConfig(count=count, seed=seed, trajectories=trajectories)
    what, stem = ("triples", "queries_triples") if trajectories == 3 else ("queries", "queries")
    files = sorted((folder / setup / "ensemble").glob("*.npz"))
    queries = generate_queries([Policy.load(path) for path in files], config, on_progress)
    return _store_queries(
        queries,
        folder / setup / f"{stem}_{count}.npz",
        what=what,
        config=config,
        seed=seed,
        parents={f"{setup}/ensemble/{file.stem}": file_sha256(file) for file in files},
        departures=["pair_filters"],
    )


def ship_varied_queries(
    setup: str,
    seed: int = 0,
    folder: Path = DATASETS,
    on_progress: OnProgress = no_progress,
    count: int = SHIPPED_QUERIES,
) -> Card:
    """Make, describe and store queries by the conditioned policy in the same folder, balanced over the measures."""
    config = VariedConfig(QueryConfig(count=count, seed=seed, max_duration_s=LONGEST_SHOWN_S[setup]))
    driver = folder / setup / "conditioned.npz"
    queries = generate_varied_queries(ConditionedPolicy.load(driver), config, on_progress)
    return _store_queries(
        queries,
        folder / setup / f"queries_varied_{count}.npz",
        what="varied-queries",
        config=config,
        seed=seed,
        parents={f"{setup}/conditioned": file_sha256(driver)},
        departures=["pair_filters", "varied"],
        results={"differences": describe_differences(queries)},
    )


def ship_manner_queries(
    setup: str,
    seed: int = 0,
    folder: Path = DATASETS,
    on_progress: OnProgress = no_progress,
    count: int = SHIPPED_QUERIES,
) -> Card:
    """Make, describe and store queries of policies in many manners in the same folder."""
    config = MannerConfig(QueryConfig(count=count, seed=seed, max_duration_s=LONGEST_SHOWN_S[setup]))
    queries = generate_manner_queries(setup, config, on_progress)
    files = [*sorted((folder / setup / "ensemble").glob("*.npz")), folder / setup / "base.npz"]
    named = {f"{setup}/{file.relative_to(folder / setup).with_suffix('')}": file for file in files}
    return _store_queries(
        queries,
        folder / setup / f"queries_manners_{count}.npz",
        what="manner-queries",
        config=config,
        seed=seed,
        parents={
            name: file_sha256(file)
            for name, file in {**named, f"{setup}/conditioned": folder / setup / "conditioned.npz"}.items()
        },
        departures=["pair_filters", "manners"],
        results={"differences": describe_differences(queries)},
    )


def _store_queries(
    queries: QuerySet,
    path: Path,
    *,
    what: str,
    config: QueryConfig | VariedConfig | MannerConfig,
    seed: int,
    parents: dict[str, str],
    departures: list[str],
    results: dict[str, Any] | None = None,
) -> Card:
    """Write a query set and its card. what: the subcommand that makes it; results: more than every set's numbers."""
    queries.save(path)
    count = (config if isinstance(config, QueryConfig) else config.queries).count
    card = Card(
        kind="query_set",
        name=f"{queries.setup}/{path.stem}",
        setup=queries.setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship {what} {queries.setup} --count {count} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={"drawn": describe(Purpose.QUERIES, queries.filtered["scenes"], seed)},
        results=describe_queries(queries) | (results or {}),
        parents=parents,
        departures=[DEPARTURES[key] for key in departures],
        notes=["Observations are stored rounded to float16 and were rounded before anything was made from them."],
    )
    card.save(card_path(path))
    return card


def describe_queries(queries: QuerySet) -> dict[str, Any]:
    """Numbers of a query set for its card."""
    shown = [one for query in queries.queries for one in (query.trajectory_a, query.trajectory_b)]
    durations = np.array([one.duration_s for one in shown])
    gaps = np.array([path_gap_m(query.trajectory_a, query.trajectory_b) for query in queries.queries])
    return {
        "queries": len(queries),
        "filtered": queries.filtered,
        "duration_s": {
            "min": float(durations.min()),
            "mean": float(durations.mean()),
            "max": float(durations.max()),
        },
        "path_gap_m": {"min": float(gaps.min()), "median": float(np.median(gaps)), "max": float(gaps.max())},
    }
