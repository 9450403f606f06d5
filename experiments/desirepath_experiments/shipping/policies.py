"""Shipped policies with their cards, where they are more than `desirepath.learning.shipping.policies` makes of any
setup: chapter 8's base policy is told what it slows down for, the field's conditioned one is given what
`after_training.py` adds.
"""

from __future__ import annotations

from dataclasses import replace

from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.shipping import policies as every
from desirepath.learning.shipping.storing import Request
from desirepath.learning.td3.base import base_config, train_base
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.explanations.slowing import slowing
from desirepath_experiments.shipping.after_training import ADDED, FIRST_ADDED_SEED, add_after_training

EXPLAINED = "explained_room"  # chapter 8's, whose policy is told beside it what it slows down for
SLOWING_SCENES = 500
ship_ensemble = every.ship_ensemble


def ship_base(request: Request) -> Card:
    """As of every setup; chapter 8's without critic, as nothing goes on from it."""
    if request.setup != EXPLAINED:
        return every.ship_base(request)
    config = base_config(request.setup, request.seed)
    result = train_base(config, request.on_progress)
    policy = result.policy.without_critic()
    drawn = scene_set(EXPLAINED, SLOWING_SCENES, purpose=Purpose.REPORT, seed=0)
    found = slowing(actor_of(policy), rollout(get_setup(EXPLAINED), policy.rollout_policy, drawn))
    notes = [
        "Chapter 8: 15 pooled rays, goal, one network of 256, 128 and 64 units. Room, limits and goal radius are "
        "ours; with more than 0.6 rad/s no policy slowed down.",
        "slowing: of the first report scenes; for what is the thing without which the policy would drive fastest "
        "where it drives slowest.",
    ]
    departures = [one for one in every.BASE_DEPARTURES if one != "heads"]
    return every.store_base(
        request, config, result, policy, results={"slowing": found}, departures=departures, notes=notes
    )


def ship_conditioned(request: Request) -> Card:
    """As of every setup, with what is added there after training."""
    card = every.ship_conditioned(request)
    return ship_added(request) if request.setup in ADDED else card


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
        results=every.measure_steerability(
            added.policy,
            Policy.load(request.path("base")),
            every.FIRST_CONDITIONED_REPORT_SEED + card.seed,
            request.report_scenes,
        )
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
