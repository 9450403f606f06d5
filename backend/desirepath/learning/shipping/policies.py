"""The policies that a study in a setup needs, with their cards: base, ensemble, conditioned. Training itself lives in
`desirepath.learning.td3`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from desirepath.learning.cards import Card
from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.evaluate import evaluate_policy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import steerability_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.shipping.storing import Request
from desirepath.learning.td3.base import BaseConfig, BaseResult, base_config, train_base
from desirepath.learning.td3.conditioned_training import ConditionedConfig, conditioned_config, train_conditioned
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig, train_ensemble
from desirepath.learning.td3.interrupted import TrainingFile

REPORT_SEEDS = (0, 1, 2, 3, 4)
BASE_DEPARTURES = ("progress", "smoothness", "heads", "environments", "average")
BASE_NOTES = ("The file also holds the critic, from which ensembles and alignment go on.",)
WITHOUT_CRITIC = ("crowd_hall",)  # two thirds of a conditioned policy's file, and nothing goes on from this one
FIRST_CONDITIONED_REPORT_SEED = 320  # reporting scenes that nothing else uses and no setting was chosen on


def ship_base(request: Request, config: BaseConfig | None = None) -> Card:
    """Train, measure and store one base policy, critic included: alignment starts from it."""
    config = config or base_config(request.setup, request.seed)
    file = request.training_file("base", config.as_dict())
    result = train_base(config, request.on_progress, file)
    card = store_base(request, config, result, result.policy)
    _forget(file)
    return card


def store_base(
    request: Request,
    config: BaseConfig,
    result: BaseResult,
    policy: Policy,
    *,
    results: dict[str, Any] | None = None,
    departures: Sequence[str] = BASE_DEPARTURES,
    notes: Sequence[str] = BASE_NOTES,
) -> Card:
    """The policy, measured. results: more of them."""
    found = {"selection_success_rate": result.selection_success, **(results or {})}
    if result.restarts:
        found["begun_anew"] = result.restarts
    departures = [*departures, *(["guide"] if config.guided_share or result.restarts else [])]
    departures += ["randomised"] if config.randomise else []
    return _store(request, policy, "base", config, results=found, departures=departures, notes=list(notes))


def ship_ensemble(request: Request, config: PolicyEnsembleConfig | None = None) -> list[Card]:
    """Train, measure and store the four members that start from the base policy in the same folder."""
    config = config or PolicyEnsembleConfig(seed=request.seed)
    result = train_ensemble(Policy.load(request.path("base")), config, request.on_progress)
    return [
        _store(
            request,
            member,
            f"ensemble/{k}",
            config,
            results={"ensemble_action_diversity": result.diversity, "selection_success_rate": result.success_rates[k]},
            parents=request.parents("base") | {"regenerated base buffer": result.base_buffer_sha256},
            departures=("heads", "environments", "ensemble_start", "ensemble_choice"),
            notes=[f"Member {k} of {len(result.members)}; averaged weights around step {result.steps[k]}."],
        )
        for k, member in enumerate(result.members)
    ]


def _store(
    request: Request,
    policy: Policy,
    name: str,
    config: BaseConfig | PolicyEnsembleConfig,
    *,
    results: dict[str, Any],
    **fields: Any,
) -> Card:
    """A policy that is measured on every set of reporting scenes: the first in full, of the others the success rates.
    results: more of them."""
    seeds = REPORT_SEEDS[: request.report_sets]
    reported = [evaluate_policy(policy, n=request.report_scenes, seed=seed) for seed in seeds]
    rates = [one["success_rate"] for one in reported]
    scenes = {
        "select": describe(Purpose.SELECT, config.selection_scenes, config.seed),
        "report": [describe(Purpose.REPORT, request.report_scenes, seed) for seed in seeds],
    }
    measured = {"first": reported[0], "success_rate_per_seed": rates, "worst_success_rate": min(rates)}
    fields |= {"config": config.as_dict(), "scenes": scenes, "results": measured | results}
    return request.store("policy", name, policy.save, f"{name.split('/')[0]} {request.setup}", **fields)


def ship_conditioned(request: Request, config: ConditionedConfig | None = None) -> Card:
    """Train, measure and store the conditioned policy that starts from the base policy in the same folder."""
    setup, base = request.setup, Policy.load(request.path("base"))
    config = config or conditioned_config(base, request.seed)
    file = request.training_file("conditioned", config.as_dict() | request.parents("base"))
    result = train_conditioned(base, config, request.on_progress, file)
    policy = replace(result.policy, critic=()) if setup in WITHOUT_CRITIC else result.policy
    reporting = FIRST_CONDITIONED_REPORT_SEED + config.seed
    parts = {"recovery": config.recovery, "randomised": config.randomise, "guide": config.guidance > 0}
    further = [name for name, there in parts.items() if there]
    card = request.store(
        "conditioned_policy",
        "conditioned",
        policy.save,
        f"conditioned {setup}",
        config=config.as_dict(),
        scenes={
            "select": describe(Purpose.SELECT, max(config.selection_scenes, config.strong_scenes), config.seed),
            "report": [describe(Purpose.REPORT, request.report_scenes, reporting)],
        },
        results=measure_steerability(policy, base, reporting, request.report_scenes)
        | {"selection": result.selection.summary(), "strength": result.strength},
        parents=request.parents("base"),
        departures=("conditioned", "progress_conditioned", "environments", "average", *further),
        notes=["`told` and `moved`: each objective alone at full strength; `neutral`: all weights zero."],
    )
    _forget(file)
    return card


def _forget(file: TrainingFile | None) -> None:
    if file is not None:
        file.forget()


def measure_steerability(policy: ConditionedPolicy, base: Policy, seed: int, scenes: int) -> dict[str, Any]:
    """What each objective at full strength moves, and how surely, in reporting scenes."""
    drawn = scene_set(policy.setup, scenes, purpose=Purpose.REPORT, seed=seed)
    conditioned = {name: policy.at(weights) for name, weights in settings(setup=policy.setup).items()}
    return steerability_of(conditioned, base, drawn).report()
