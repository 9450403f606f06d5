"""Making the shipped artefacts and their cards.

`python -m backend.experiments.ship base|ensemble|conditioned|queries|varied-queries|triples SETUP --seed N`.
The science lives in the algorithms' files; finding what was shipped lives in `shipped.py`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from backend.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from backend.learning.policies.conditioned import ConditionedPolicy, settings
from backend.learning.policies.evaluate import evaluate_policy
from backend.learning.policies.movement import movement_of
from backend.learning.policies.policy import Policy
from backend.learning.policies.shipped import DATASETS
from backend.learning.queries.queries import QueryConfig, QuerySet, generate_queries, path_gap_m
from backend.learning.queries.varied_queries import VariedConfig, describe_differences, generate_varied_queries
from backend.learning.scene_sets import Purpose, describe, scene_set
from backend.learning.td3.base import BaseConfig, OnProgress, no_progress, train_base
from backend.learning.td3.conditioned_training import CONFIGS, ConditionedConfig, ConditionedResult, train_conditioned
from backend.learning.td3.ensemble import EnsembleConfig, train_ensemble
from backend.simulation.setups import SETUPS

REPORT_SCENES = 2_000
REPORT_SEEDS = (0, 1, 2, 3, 4)
SHIPPED_QUERIES = 200
LONGEST_SHOWN_S = {"study_room": 12.0, "open_field": 20.0}  # of a drive in a varied query; the field's robot is slow
FIRST_CONDITIONED_REPORT_SEED = 320  # reporting scenes that nothing else uses and no setting was chosen on


def report(policy: Policy) -> dict[str, Any]:
    """The policy on every set of reporting scenes: the first in full, of the others the success rates."""
    results = [evaluate_policy(policy, n=REPORT_SCENES, seed=seed) for seed in REPORT_SEEDS]
    rates = [result["success_rate"] for result in results]
    return {"first": results[0], "success_rate_per_seed": rates, "worst_success_rate": min(rates)}


def report_scenes() -> dict[str, Any]:
    """The reporting scenes in words, for a card."""
    return {"report": [describe(Purpose.REPORT, REPORT_SCENES, seed) for seed in REPORT_SEEDS]}


def store_policy(policy: Policy, name: str, config: BaseConfig | EnsembleConfig, folder: Path, **told: Any) -> Card:
    """Write a trained policy, measured on the reporting scenes, with its card.

    name: `SETUP/base` or `SETUP/ensemble/K`. told: further fields of the card; its `results` join the measured ones.
    """
    setup, what = name.split("/")[:2]
    path = folder / f"{name}.npz"
    policy.save(path)
    card = Card(
        kind="policy",
        name=name,
        setup=setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"python -m backend.experiments.ship {what} {setup} --seed {config.seed}",
        seed=config.seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={"select": describe(Purpose.SELECT, config.selection_scenes, config.seed)} | report_scenes(),
        results=report(policy) | told.pop("results"),
        **told,
    )
    card.save(card_path(path))
    return card


def ship_base(setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Train, measure and store one base policy, critic included: alignment starts from it."""
    config = BaseConfig(setup=setup, seed=seed)
    result = train_base(config, on_progress)
    return store_policy(
        result.policy,
        f"{setup}/base",
        config,
        folder,
        results={"selection_success_rate": result.selection_success},
        departures=[DEPARTURES[key] for key in ("progress", "calm", "heads", "environments", "average")],
        notes=["The file also holds the critic, from which ensembles and alignment go on."],
    )


def ship_ensemble(
    setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress
) -> list[Card]:
    """Train, measure and store the four members that start from the base policy in the same folder."""
    base_path = folder / setup / "base.npz"
    config = EnsembleConfig(seed=seed)
    result = train_ensemble(Policy.load(base_path), config, on_progress)
    parents = {f"{setup}/base": file_sha256(base_path), "regenerated base buffer": result.base_buffer_sha256}
    return [
        store_policy(
            member,
            f"{setup}/ensemble/{k}",
            config,
            folder,
            results={"ensemble_action_diversity": result.diversity, "selection_success_rate": result.success_rates[k]},
            parents=parents,
            departures=[DEPARTURES[key] for key in ("heads", "environments", "ensemble_start", "ensemble_choice")],
            notes=[f"Member {k} of {len(result.members)}; averaged weights around step {result.steps[k]}."],
        )
        for k, member in enumerate(result.members)
    ]


def ship_conditioned(setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Train, measure and store the conditioned policy that starts from the base policy in the same folder."""
    base_path = folder / setup / "base.npz"
    base = Policy.load(base_path)
    config = replace(CONFIGS[setup], seed=seed)
    result = train_conditioned(base, config, on_progress)
    return store_conditioned(result, config, base_path, folder)


def store_conditioned(result: ConditionedResult, config: ConditionedConfig, base_path: Path, folder: Path) -> Card:
    """Write a trained conditioned policy with its card: what each objective at full strength moves, and how surely."""
    path = folder / config.setup / "conditioned.npz"
    result.policy.save(path)
    reporting = FIRST_CONDITIONED_REPORT_SEED + config.seed
    scenes = scene_set(config.setup, REPORT_SCENES, purpose=Purpose.REPORT, seed=reporting)
    told = {name: result.policy.at(weights) for name, weights in settings().items()}
    card = Card(
        kind="conditioned_policy",
        name=f"{config.setup}/conditioned",
        setup=config.setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"python -m backend.experiments.ship conditioned {config.setup} --seed {config.seed}",
        seed=config.seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={
            "select": describe(Purpose.SELECT, max(config.selection_scenes, config.strong_scenes), config.seed),
            "report": [describe(Purpose.REPORT, REPORT_SCENES, reporting)],
        },
        results=movement_of(told, Policy.load(base_path), scenes).report()
        | {"selection": result.selection.summary(), "strength": result.strength},
        parents={f"{config.setup}/base": file_sha256(base_path)},
        departures=[
            DEPARTURES[key]
            for key in ("conditioned", "progress_conditioned", "environments", "average")
            + (("recovery",) if config.recovery else ())
        ],
        notes=["`told` and `moved`: each objective alone at full strength; `neutral`: nothing wanted."],
    )
    card.save(card_path(path))
    return card


def ship_queries(
    setup: str,
    seed: int = 0,
    folder: Path = DATASETS,
    on_progress: OnProgress = no_progress,
    count: int = SHIPPED_QUERIES,
    drives: int = 2,
) -> Card:
    """Make, describe and store queries by the ensemble in the same folder; of three drives each scene: triples."""
    config = QueryConfig(count=count, seed=seed, drives=drives)
    what, stem = ("triples", "queries_triples") if drives == 3 else ("queries", "queries")
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


def _store_queries(
    queries: QuerySet,
    path: Path,
    *,
    what: str,
    config: QueryConfig | VariedConfig,
    seed: int,
    parents: dict[str, str],
    departures: list[str],
    results: dict[str, Any] | None = None,
) -> Card:
    """Write a query set and its card. what: the subcommand that makes it; results: more than every set's numbers."""
    queries.save(path)
    count = (config.queries if isinstance(config, VariedConfig) else config).count
    card = Card(
        kind="query_set",
        name=f"{queries.setup}/{path.stem}",
        setup=queries.setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"python -m backend.experiments.ship {what} {queries.setup} --count {count} --seed {seed}",
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
    drives = [drive for query in queries.queries for drive in (query.trajectory_a, query.trajectory_b)]
    durations = np.array([drive.duration_s for drive in drives])
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


def main() -> None:
    parser = argparse.ArgumentParser(description="Make shipped artefacts with their cards.")
    parser.add_argument("what", choices=("base", "ensemble", "conditioned", "queries", "varied-queries", "triples"))
    parser.add_argument("setup", choices=tuple(SETUPS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=SHIPPED_QUERIES, help="of queries, or scenes of triples")
    parser.add_argument("--out", type=Path, default=DATASETS, help="folder that the setup's folder lies in")
    arguments = parser.parse_args()

    def show(fraction: float, metrics: dict[str, float]) -> None:
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
        print(f"{fraction:4.0%} {numbers}", file=sys.stderr, flush=True)

    given = (arguments.setup, arguments.seed, arguments.out, show)
    if arguments.what == "varied-queries":
        ship_varied_queries(*given, count=arguments.count)
    elif arguments.what in ("queries", "triples"):
        ship_queries(*given, count=arguments.count, drives=3 if arguments.what == "triples" else 2)
    else:
        {"base": ship_base, "ensemble": ship_ensemble, "conditioned": ship_conditioned}[arguments.what](*given)


if __name__ == "__main__":
    main()
