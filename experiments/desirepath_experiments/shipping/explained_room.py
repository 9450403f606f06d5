"""The shipped policy of chapter 8 and the ranking set of its 48 scenarios, each with its card.

Training is `learning/td3/base.py`'s, explaining `desirepath.explain`'s.
"""

from __future__ import annotations

from pathlib import Path

from desirepath.explain.methods import Command, Method
from desirepath.explain.ranking_sets import ranking_set
from desirepath.installed import DATASETS
from desirepath.learning.cards import DEPARTURES, Card
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, base_config, no_progress, train_base
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.explanations.scenarios import PRACTICE, SCENARIOS, practice_rooms, rooms
from desirepath_experiments.reproduction.explanations.slowing import slowing
from desirepath_experiments.shipping.policies import store_policy
from desirepath_experiments.shipping.ranking_set_files import store_ranking_set

EXPLAINED_ROOM = get_setup("explained_room")

SLOWING_SCENES = 500
SET_NAME = f"{EXPLAINED_ROOM.name}/scenarios_{SCENARIOS}"


def ship_explained(seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Train, measure and store the policy of chapter 8, without its critic: nothing goes on from it."""
    config = base_config(EXPLAINED_ROOM.name, seed)
    result = train_base(config, on_progress)
    policy = result.policy.without_critic()
    return store_explained(policy, seed, result.selection_success, folder)


def store_explained(policy: Policy, seed: int, selection_success: float, folder: Path) -> Card:
    """Write the trained policy with its card: how surely it arrives, how often it slows down, and for what."""
    drawn = scene_set(EXPLAINED_ROOM.name, SLOWING_SCENES, purpose=Purpose.REPORT, seed=0)
    slowed = slowing(actor_of(policy), rollout(EXPLAINED_ROOM, policy.rollout_policy, drawn))
    return store_policy(
        policy,
        f"{EXPLAINED_ROOM.name}/base",
        base_config(EXPLAINED_ROOM.name, seed),
        folder,
        results={"selection_success_rate": selection_success, "slowing": slowed},
        departures=[DEPARTURES[key] for key in ("progress", "smoothness", "environments", "average")],
        notes=[
            "Chapter 8: 15 pooled rays, goal, one network of 256, 128 and 64 units. Room, limits and goal radius are "
            "ours; with more than 0.6 rad/s no policy slowed down.",
            "slowing: of the first report scenes; for what is the thing without which the policy would drive fastest "
            "where it drives slowest.",
        ],
    )


def ship_ranking_set(folder: Path = DATASETS, method: Method = "saliency", command: Command = "speed") -> Card:
    """Roll the shipped policy out in the scenarios, explain what it did until it halts, store it as a ranking set."""
    parent = f"{EXPLAINED_ROOM.name}/base"
    path = folder / f"{parent}.npz"
    policy = Policy.load(path)
    made = ranking_set(
        actor_of(policy), policy.rollout_policy, rooms(), practice_rooms(), count=SCENARIOS, practised=PRACTICE,
        policy=parent, method=method, command=command,
    )  # fmt: skip
    return store_ranking_set(
        made,
        SET_NAME,
        folder,
        config={"method": method, "command": command, "objects": list(made.rollouts[0].things)},
        most_key="most_important",
        without_key="objects_without_score",
        parent=(parent, path),
    )
