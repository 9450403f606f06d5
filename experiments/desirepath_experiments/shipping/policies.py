"""Shipped policies with their cards: base, ensemble, conditioned, what is added to it. Training itself lives in
`desirepath.learning.td3`, what is added in `after_training.py`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.evaluate import evaluate_policy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import steerability_of
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.td3.base import BaseConfig, base_config, train_base
from desirepath.learning.td3.conditioned_training import conditioned_config, train_conditioned
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig, train_ensemble
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.explanations.slowing import slowing
from desirepath_experiments.shipping.after_training import ADDED, FIRST_ADDED_SEED, add_after_training
from desirepath_experiments.shipping.storing import Request

REPORT_SCENES = 2_000
REPORT_SEEDS = (0, 1, 2, 3, 4)
EXPLAINED = "explained_room"  # chapter 8's, whose policy is told beside it what it slows down for
SLOWING_SCENES = 500
WITHOUT_CRITIC = ("crowd_hall",)  # two thirds of a conditioned policy's file, and nothing goes on from this one
FIRST_CONDITIONED_REPORT_SEED = 320  # reporting scenes that nothing else uses and no setting was chosen on


def ship_base(request: Request) -> Card:
    """Train, measure and store one base policy, critic included: alignment starts from it. Chapter 8's without critic,
    as nothing goes on from it."""
    config = base_config(request.setup, request.seed)
    result = train_base(config, request.on_progress)
    results: dict[str, Any] = {"selection_success_rate": result.selection_success}
    departures = ["progress", "smoothness", "heads", "environments", "average"]
    if request.setup != EXPLAINED:
        notes = ["The file also holds the critic, from which ensembles and alignment go on."]
        return _store(request, result.policy, "base", config, results=results, departures=departures, notes=notes)
    policy = result.policy.without_critic()
    drawn = scene_set(EXPLAINED, SLOWING_SCENES, purpose=Purpose.REPORT, seed=0)
    results["slowing"] = slowing(actor_of(policy), rollout(get_setup(EXPLAINED), policy.rollout_policy, drawn))
    notes = [
        "Chapter 8: 15 pooled rays, goal, one network of 256, 128 and 64 units. Room, limits and goal radius are "
        "ours; with more than 0.6 rad/s no policy slowed down.",
        "slowing: of the first report scenes; for what is the thing without which the policy would drive fastest "
        "where it drives slowest.",
    ]
    departures.remove("heads")
    return _store(request, policy, "base", config, results=results, departures=departures, notes=notes)


def ship_ensemble(request: Request) -> list[Card]:
    """Train, measure and store the four members that start from the base policy in the same folder."""
    config = PolicyEnsembleConfig(seed=request.seed)
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
    reported = [evaluate_policy(policy, n=REPORT_SCENES, seed=seed) for seed in REPORT_SEEDS]
    rates = [row["success_rate"] for row in reported]
    scenes = {
        "select": describe(Purpose.SELECT, config.selection_scenes, config.seed),
        "report": [describe(Purpose.REPORT, REPORT_SCENES, seed) for seed in REPORT_SEEDS],
    }
    measured = {"first": reported[0], "success_rate_per_seed": rates, "worst_success_rate": min(rates)}
    fields |= {"config": config.as_dict(), "scenes": scenes, "results": measured | results}
    return request.store("policy", name, policy.save, f"{name.split('/')[0]} {request.setup}", **fields)


def ship_conditioned(request: Request) -> Card:
    """Train, measure and store the conditioned policy that starts from the base policy in the same folder."""
    setup, base = request.setup, Policy.load(request.path("base"))
    config = conditioned_config(base, request.seed)
    result = train_conditioned(base, config, request.on_progress)
    policy = replace(result.policy, critic=()) if setup in WITHOUT_CRITIC else result.policy
    reporting = FIRST_CONDITIONED_REPORT_SEED + config.seed
    recovery = ("recovery",) if config.recovery else ()
    card = request.store(
        "conditioned_policy",
        "conditioned",
        policy.save,
        f"conditioned {setup}",
        config=config.as_dict(),
        scenes={
            "select": describe(Purpose.SELECT, max(config.selection_scenes, config.strong_scenes), config.seed),
            "report": [describe(Purpose.REPORT, REPORT_SCENES, reporting)],
        },
        results=_steer(policy, base, reporting)
        | {"selection": result.selection.summary(), "strength": result.strength},
        parents=request.parents("base"),
        departures=("conditioned", "progress_conditioned", "environments", "average", *recovery),
        notes=["`told` and `moved`: each objective alone at full strength; `neutral`: all weights zero."],
    )
    return ship_added(request) if setup in ADDED else card


def _steer(policy: ConditionedPolicy, base: Policy, seed: int) -> dict[str, Any]:
    """What each objective at full strength moves, and how surely, in reporting scenes."""
    scenes = scene_set(policy.setup, REPORT_SCENES, purpose=Purpose.REPORT, seed=seed)
    conditioned = {name: policy.at(weights) for name, weights in settings(setup=policy.setup).items()}
    return steerability_of(conditioned, base, scenes).report()


def ship_added(request: Request) -> Card:
    """Give the conditioned policy of the folder what is added after training, and measure it anew; its card keeps what
    it says of the training. Raises LearningError for a setup for which nothing is added.
    """
    setup, seed, path = request.setup, request.seed, request.path("conditioned")
    if setup not in ADDED:
        raise LearningError(f"setup = {setup!r}: nothing is added after training there; it is in {', '.join(ADDED)}")
    trained, card = ConditionedPolicy.load(path).as_trained(), Card.load(card_path(path))
    config = replace(ADDED[setup], seed=seed)
    added = add_after_training(trained, config)
    request.on_progress(0.8, {"strength": max(added.policy.strengths.values(), default=1.0)})
    added.policy.save(path)
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
        results=_steer(added.policy, Policy.load(request.path("base")), FIRST_CONDITIONED_REPORT_SEED + card.seed)
        | of_training
        | {
            "as_trained_sha256": trained.digest(),
            "added": {"config": config.as_dict(), "kept": added.kept(), "tried": added.report()},
        },
        departures=[
            *(departure for departure in card.departures if departure != DEPARTURES["added"]),
            DEPARTURES["added"],
        ],
        notes=notes,
    )
    whole.save(card_path(path))
    return whole
