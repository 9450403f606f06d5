"""The ranking set among pedestrians: whom a policy with attention attends to where it halts, with its card.

The weights are `learning/pedestrians/attended.py`'s; what a ranking set is, `desirepath.explain`'s.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from desirepath.explain.in_sight import halts_in_sight
from desirepath.explain.ranking_sets import DRIVE_S, ExplainedRollout, RankingSet
from desirepath.explain.shown_explanation import people_of
from desirepath.installed import DATASETS
from desirepath.learning.cards import Card, card_path
from desirepath.learning.errors import LearningError
from desirepath.learning.pedestrians.attended import as_trajectory, attention_to_people, until
from desirepath.learning.pedestrians.crowd_networks import attention_weights
from desirepath.learning.policies.attention import AttentionPolicy
from desirepath.learning.scene_sets import Purpose, first_seed
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_experiments.shipping.ranking_set_files import store_ranking_set

CROWD_CORRIDOR = get_setup("crowd_corridor")

SCENARIOS, PRACTICE = 24, 2  # ours: half of chapter 8's
FIVE = CrowdConditions(moving=(3, 3), standing=(2, 2))  # ours: as many as there are objects in chapter 8
LEAST_SEEN = 4  # ours, as in chapter 8: of the five, at the halt; who is not seen gets no attention
POLICY, NAME = f"{CROWD_CORRIDOR.name}/attention", f"{CROWD_CORRIDOR.name}/scenarios_{SCENARIOS}"


def explained_among_people(policy: AttentionPolicy, scene: Scene, *, practice: bool = False) -> ExplainedRollout | None:
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
    running = np.zeros(steps, np.bool_)
    trajectory = replace(
        as_trajectory(replace(halted, states=halted.states[:steps])),
        observations=unseen,
        next_observations=unseen,
        dones=running,
    )
    attention = (spatial.astype(np.float32), temporal.astype(np.float32))
    return ExplainedRollout(trajectory, people_of(halted.scene), scores, practice, attention)


def attended_set(policy: AttentionPolicy, name: str, scenarios: int, practice: int) -> tuple[RankingSet, int]:
    """So many rollouts, the first that halt in sight of the person where four of five people get attention; and how
    many scenes were left out."""
    kept: list[ExplainedRollout] = []
    seed = first = first_seed(Purpose.QUERIES, 0)
    while len(kept) < scenarios + practice:
        scene = draw_crowd_scene(policy.setup, seed, FIVE)
        seed += 1
        one = explained_among_people(policy, scene, practice=len(kept) >= scenarios)
        if one is not None and (one.scores[-1] > 0).sum() >= LEAST_SEEN and halts_in_sight(one.trajectory):
            kept.append(one)
    return RankingSet(policy.setup, tuple(kept), name, "attention", "all"), seed - first - len(kept)


def ship_attended(folder: Path = DATASETS, scenarios: int = SCENARIOS) -> Card:
    """Roll the shipped policy with attention out and store whom it attends to. Raises LearningError without it."""
    path = folder / f"{POLICY}.npz"
    if not path.is_file():
        made = f"desirepath ship attention {CROWD_CORRIDOR.name}"
        raise LearningError(f"{path.name} of {CROWD_CORRIDOR.name} is missing: make it first with `{made}`")
    made_of, left_out = attended_set(AttentionPolicy.load(path), POLICY, scenarios, PRACTICE)
    return store_ranking_set(
        made_of,
        NAME,
        folder,
        config={"method": "attention", "people": list(made_of.rollouts[0].things)},
        most_key="most_attended",
        without_key="people_without_score",
        parent=(POLICY, path),
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
