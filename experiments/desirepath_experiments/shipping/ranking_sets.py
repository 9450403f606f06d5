"""Shipped ranking sets: rollouts that halt in sight of the person, with what an explanation says of each.

Of chapter 8's policy among objects, and of the policy with attention among people. What a ranking set is, and how
objects are scored, is `desirepath.explain`'s; attention's weights are `learning/pedestrians/attended.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from desirepath.explain.in_sight import halts_in_sight
from desirepath.explain.ranking_sets import DRIVE_S, ExplainedRollout, RankingSet, ranking_set
from desirepath.explain.shown_explanation import people_of
from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath.learning.errors import LearningError
from desirepath.learning.pedestrians.attended import as_trajectory, attention_to_people, until
from desirepath.learning.pedestrians.crowd_networks import attention_weights
from desirepath.learning.policies.attention import AttentionPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, first_seed
from desirepath.learning.shipping.storing import Request, store
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath_experiments.reproduction.explanations.scenarios import PRACTICE, SCENARIOS, practice_rooms, rooms

CROWD = "crowd_corridor"
CROWD_SCENARIOS, CROWD_PRACTICE = 24, 2  # ours: half of chapter 8's
FIVE = CrowdConditions(moving=(3, 3), standing=(2, 2))  # ours: as many as there are objects in chapter 8
LEAST_SEEN = 4  # ours, as in chapter 8: of the five, at the halt; who is not seen gets no attention


def ship_ranking_set(request: Request) -> Card:
    """Of the policy that lies in the setup's folder. Raises LearningError where it is missing."""
    return _ship_attended(request) if request.setup == CROWD else _ship_explained(request)


def _ship_explained(request: Request) -> Card:
    parent = f"{request.setup}/base"
    policy = Policy.load(request.path("base"))
    ranked = ranking_set(
        actor_of(policy), policy.rollout_policy, rooms(), practice_rooms(), count=SCENARIOS, practised=PRACTICE,
        policy=parent,
    )  # fmt: skip
    config = {"method": ranked.method, "command": ranked.command, "objects": list(ranked.rollouts[0].things)}
    keys = ("most_important", "objects_without_score")
    return _store(ranked, f"{request.setup}/scenarios_{SCENARIOS}", request.folder, keys, parent, config)


def _ship_attended(request: Request) -> Card:
    path = request.path("attention")
    if not path.is_file():
        command = f"desirepath ship attention {request.setup}"
        raise LearningError(f"{path.name} of {request.setup} is missing: make it first with `{command}`")
    name = f"{request.setup}/attention"
    ranked, left_out = find_attended(AttentionPolicy.load(path), name, CROWD_SCENARIOS, CROWD_PRACTICE)
    return _store(
        ranked,
        f"{request.setup}/scenarios_{CROWD_SCENARIOS}",
        request.folder,
        ("most_attended", "people_without_score"),
        name,
        {"method": "attention", "people": list(ranked.rollouts[0].things)},
        results={
            "scenes_left_out": left_out,
            "policy": Card.load(card_path(path)).results if card_path(path).is_file() else {},
        },
        notes=[
            "A score is how strongly the stage draws what the policy attends to at somebody: the mean of the strongest "
            "lidar sector and the strongest descriptor ray that meet them, each beside the moment's strongest.",
            "Left out: scenes that are over within three seconds, those where fewer than four get "
            "attention, and those where the person does not see the robot halt.",
        ],
    )


def find_attended(policy: AttentionPolicy, name: str, scenarios: int, practice: int) -> tuple[RankingSet, int]:
    """So many rollouts, the first that halt in sight of the person where four of five people get attention; and how
    many scenes were left out."""
    rollouts: list[ExplainedRollout] = []
    seed = first = first_seed(Purpose.QUERIES, 0)
    while len(rollouts) < scenarios + practice:
        scene = draw_crowd_scene(policy.setup, seed, FIVE)
        seed += 1
        rollout = _attend(policy, scene, practice=len(rollouts) >= scenarios)
        if rollout is not None and (rollout.scores[-1] > 0).sum() >= LEAST_SEEN and halts_in_sight(rollout.trajectory):
            rollouts.append(rollout)
    return RankingSet(policy.setup, tuple(rollouts), name, "attention", "all"), seed - first - len(rollouts)


def _attend(policy: AttentionPolicy, scene: Scene, *, practice: bool) -> ExplainedRollout | None:
    """The policy in that scene until it halts, with what it attended to; None where the rollout is over before."""
    steps = round(DRIVE_S / CONTROL_DT_S)
    whole = policy.rolled_out(scene)
    if len(whole.actions) <= steps:
        return None
    halted = until(whole, steps)
    weights = attention_weights(policy.actor(), torch.as_tensor(halted.states))
    spatial, temporal = (weights[stream].numpy().astype(np.float64) for stream in ("spatial", "temporal"))
    scores = attention_to_people(halted, spatial, temporal).round(4).astype(np.float32)
    unseen = np.zeros((steps, 0), np.float32)  # chapter 4's states are large, and the set explains them already
    trajectory = replace(
        as_trajectory(replace(halted, states=halted.states[:steps])),
        observations=unseen,
        next_observations=unseen,
        dones=np.zeros(steps, np.bool_),
    )
    attention = (spatial.astype(np.float32), temporal.astype(np.float32))
    return ExplainedRollout(trajectory, people_of(halted.scene), scores, practice, attention)


def _store(
    ranked: RankingSet,
    name: str,
    folder: Path,
    keys: tuple[str, str],
    parent: str,
    config: dict[str, Any],
    results: dict[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> Card:
    """keys: under which the card says what most often has the highest score, and how many have none; parent: the
    policy's name; results: more of them."""
    most, without = keys
    regular = [rollout for rollout in ranked.rollouts if not rollout.practice]
    best = [max(rollout.at_halt, key=lambda thing, scores=rollout.at_halt: scores[thing]) for rollout in regular]  # type: ignore[misc]
    return store(
        "ranking_set",
        name,
        ranked.save,
        folder,
        command=f"desirepath ship ranking-set {ranked.setup}",
        config=config,
        scenes={
            "regular": [rollout.trajectory.scene.seed for rollout in regular],
            "practice": [rollout.trajectory.scene.seed for rollout in ranked.rollouts if rollout.practice],
        },
        results={
            "scenarios": len(regular),
            "with_tied_scores": sum(len(set(rollout.at_halt.values())) < len(rollout.things) for rollout in regular),
            without: sum(score == 0 for rollout in regular for score in rollout.at_halt.values()),
            most: {thing: best.count(thing) for thing in regular[0].things},
            **(results or {}),
        },
        notes=list(notes),
        parents={parent: file_sha256(folder / f"{parent}.npz")},
    )
