"""Shipped policies with their cards: base, ensemble, conditioned, what is added to it, sharpened. Training itself
lives in `desirepath.learning.td3` and `desirepath_experiments.training`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from desirepath.installed import DATASETS
from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.evaluate import evaluate_policy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import steerability_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.td3.base import BaseConfig, OnProgress, base_config, no_progress, train_base
from desirepath.learning.td3.conditioned_training import (
    CONFIGS,
    ConditionedConfig,
    ConditionedResult,
    train_conditioned,
)
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig, train_ensemble
from desirepath_experiments.shipping.after_training import ADDED, FIRST_ADDED_SEED, add_after_training
from desirepath_experiments.training.through_simulation.sharpening import FIRST_SELECTION_SEED, sharpen
from desirepath_experiments.training.through_simulation.uphill import SHARPENING

REPORT_SCENES = 2_000
REPORT_SEEDS = (0, 1, 2, 3, 4)
WITHOUT_CRITIC = ("crowd_hall",)  # two thirds of a conditioned policy's file, and nothing goes on from this one
FIRST_CONDITIONED_REPORT_SEED = 320  # reporting scenes that nothing else uses and no setting was chosen on


def report(policy: Policy) -> dict[str, Any]:
    """The policy on every set of reporting scenes: the first in full, of the others the success rates."""
    results = [evaluate_policy(policy, n=REPORT_SCENES, seed=seed) for seed in REPORT_SEEDS]
    rates = [result["success_rate"] for result in results]
    return {"first": results[0], "success_rate_per_seed": rates, "worst_success_rate": min(rates)}


def report_scenes() -> dict[str, Any]:
    """The reporting scenes in words, for a card."""
    return {"report": [describe(Purpose.REPORT, REPORT_SCENES, seed) for seed in REPORT_SEEDS]}


def store_policy(
    policy: Policy, name: str, config: BaseConfig | PolicyEnsembleConfig, folder: Path, **fields: Any
) -> Card:
    """Write a trained policy, measured on the reporting scenes, with its card.

    name: `SETUP/base` or `SETUP/ensemble/K`. fields: more of the card; its `results` join the measured ones.
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
        command=f"desirepath ship {what} {setup} --seed {config.seed}",
        seed=config.seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={"select": describe(Purpose.SELECT, config.selection_scenes, config.seed)} | report_scenes(),
        results=report(policy) | fields.pop("results"),
        **fields,
    )
    card.save(card_path(path))
    return card


def ship_base(setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Train, measure and store one base policy, critic included: alignment starts from it."""
    config = base_config(setup, seed)
    result = train_base(config, on_progress)
    return store_policy(
        result.policy,
        f"{setup}/base",
        config,
        folder,
        results={"selection_success_rate": result.selection_success},
        departures=[DEPARTURES[key] for key in ("progress", "smoothness", "heads", "environments", "average")],
        notes=["The file also holds the critic, from which ensembles and alignment go on."],
    )


def ship_ensemble(
    setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress
) -> list[Card]:
    """Train, measure and store the four members that start from the base policy in the same folder."""
    base_path = folder / setup / "base.npz"
    config = PolicyEnsembleConfig(seed=seed)
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
    if setup in WITHOUT_CRITIC:
        result = replace(result, policy=replace(result.policy, critic=()))
    card = store_conditioned(result, config, base_path, folder)
    return ship_added(setup, seed, folder, on_progress) if setup in ADDED else card


def ship_added(setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Give the conditioned policy of the folder what is added after training, and measure it anew; its card keeps what
    it says of the training. Raises LearningError for a setup for which nothing is added.
    """
    if setup not in ADDED:
        raise LearningError(f"setup = {setup!r}: nothing is added after training there; it is in {', '.join(ADDED)}")
    base_path, path = folder / setup / "base.npz", folder / setup / "conditioned.npz"
    trained, card = ConditionedPolicy.load(path).as_trained(), Card.load(card_path(path))
    config = replace(ADDED[setup], seed=seed)
    added = add_after_training(trained, config)
    on_progress(0.8, {"strength": max(added.policy.strengths.values(), default=1.0)})
    added.policy.save(path)
    scenes = scene_set(setup, REPORT_SCENES, purpose=Purpose.REPORT, seed=FIRST_CONDITIONED_REPORT_SEED + card.seed)
    conditioned = {name: added.policy.at(weights) for name, weights in settings(setup=setup).items()}
    of_training = {key: value for key, value in card.results.items() if key in ("selection", "strength")}
    command = f"desirepath ship added {setup} --seed {seed}"
    notes = [
        *(note for note in card.notes if not note.startswith("Added after training")),
        f"Added after training, by `{command}` at {source_commit()}; as trained its sha256 was {trained.digest()}.",
    ]
    whole = replace(
        card,
        sha256=file_sha256(path),
        scenes=card.scenes | {"added": describe(Purpose.SELECT, config.scenes, FIRST_ADDED_SEED + seed)},
        results=steerability_of(conditioned, Policy.load(base_path), scenes).report()
        | of_training
        | {
            "as_trained_sha256": trained.digest(),
            "added": {"config": config.as_dict(), "kept": added.kept(), "tried": added.report()},
        },
        departures=[*(said for said in card.departures if said != DEPARTURES["added"]), DEPARTURES["added"]],
        notes=notes,
    )
    whole.save(card_path(path))
    return whole


def store_conditioned(result: ConditionedResult, config: ConditionedConfig, base_path: Path, folder: Path) -> Card:
    """Write a trained conditioned policy with its card: what each objective at full strength moves, and how surely."""
    path = folder / config.setup / "conditioned.npz"
    result.policy.save(path)
    reporting = FIRST_CONDITIONED_REPORT_SEED + config.seed
    scenes = scene_set(config.setup, REPORT_SCENES, purpose=Purpose.REPORT, seed=reporting)
    conditioned = {name: result.policy.at(weights) for name, weights in settings(setup=config.setup).items()}
    card = Card(
        kind="conditioned_policy",
        name=f"{config.setup}/conditioned",
        setup=config.setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship conditioned {config.setup} --seed {config.seed}",
        seed=config.seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={
            "select": describe(Purpose.SELECT, max(config.selection_scenes, config.strong_scenes), config.seed),
            "report": [describe(Purpose.REPORT, REPORT_SCENES, reporting)],
        },
        results=steerability_of(conditioned, Policy.load(base_path), scenes).report()
        | {"selection": result.selection.summary(), "strength": result.strength},
        parents={f"{config.setup}/base": file_sha256(base_path)},
        departures=[
            DEPARTURES[key]
            for key in ("conditioned", "progress_conditioned", "environments", "average")
            + (("recovery",) if config.recovery else ())
        ],
        notes=["`told` and `moved`: each objective alone at full strength; `neutral`: all weights zero."],
    )
    card.save(card_path(path))
    return card


def ship_sharpened(setup: str, seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Sharpen, measure and store the conditioned policy of the same folder."""
    base_path, start_path = folder / setup / "base.npz", folder / setup / "conditioned.npz"
    base, start = Policy.load(base_path), ConditionedPolicy.load(start_path)
    config = replace(SHARPENING[setup], seed=seed)
    made = sharpen(start, base, config, on_progress)
    path = folder / setup / "sharpened.npz"
    made.policy.save(path)
    reporting = FIRST_CONDITIONED_REPORT_SEED + seed  # the same scenes as on the card of the one it began with
    scenes = scene_set(setup, REPORT_SCENES, purpose=Purpose.REPORT, seed=reporting)
    conditioned = {name: made.policy.at(weights) for name, weights in settings(setup=setup).items()}
    card = Card(
        kind="conditioned_policy",
        name=f"{setup}/sharpened",
        setup=setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship sharpened {setup} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={
            "select": describe(Purpose.SELECT, config.selection_scenes, FIRST_SELECTION_SEED + seed),
            "report": [describe(Purpose.REPORT, REPORT_SCENES, reporting)],
        },
        results=steerability_of(conditioned, base, scenes).report()
        | {"share": made.share, "before": made.before, "selection": made.selection, "history": made.history},
        parents={f"{setup}/conditioned": file_sha256(start_path), f"{setup}/base": file_sha256(base_path)},
        departures=[
            DEPARTURES[key]
            for key in ("conditioned", "sharpened", "environments") + (("recovery",) if start.base else ())
        ],
        notes=["`told` and `moved`: each objective alone at full strength; `neutral`: nothing wanted."],
    )
    card.save(card_path(path))
    return card
