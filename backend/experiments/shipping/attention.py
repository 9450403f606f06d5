"""The shipped policy with attention, with its card. Its training is `learning/pedestrians/imitation.py`'s."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from backend.learning.cards import Card, card_path, file_sha256, source_commit
from backend.learning.pedestrians.attention_policy import VARIANT, AttentionPolicy
from backend.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from backend.learning.pedestrians.crowd_networks import VARIANTS, actor_acts
from backend.learning.pedestrians.crowd_planners import PLANNERS
from backend.learning.pedestrians.crowd_training import actor_to_arrays
from backend.learning.pedestrians.imitation import ImitationConfig, imitate
from backend.learning.scene_sets import Purpose, describe
from backend.learning.shipped_files import DATASETS
from backend.learning.td3.base import OnProgress, no_progress
from backend.simulation.crowds.crowd_scenes import PUBLISHED
from backend.simulation.crowds.crowd_setups import TRAINED_SETUPS

REPORT_SCENES = 300
NAME = "attention"


def ship_attention(seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Train, measure and store the policy."""
    config = ImitationConfig(VARIANT, seed)
    policy = policy_by_imitation(config, on_progress)
    path = folder / policy.setup / f"{NAME}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(policy.to_bytes())
    card = Card(
        kind="attention_policy",
        name=f"{policy.setup}/{NAME}",
        setup=policy.setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"python -m backend.experiments.ship {NAME} {policy.setup} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        config=config.as_dict(),
        scenes={"report": [describe(Purpose.REPORT, REPORT_SCENES, seed)]},
        results=measured(AttentionPolicy.load(path), seed),
        departures=[
            "Learned by imitation of a search that is told how everybody moves, from what the robot senses; the thesis "
            "trains its networks by DDPG. Reward and curriculum of chapter 4 have no part in it. Its network ends in "
            "the costs of 24 commands instead of one action.",
        ],
        notes=["Rates in % in the published setting: two at 0.6 m/s who avoid nobody, one stands."],
    )
    card.save(card_path(path))
    return card


def policy_by_imitation(config: ImitationConfig, on_progress: OnProgress = no_progress) -> AttentionPolicy:
    """A policy with attention, its numbers in half precision."""
    made = imitate(config, on_progress)
    arrays = {name: value.astype(np.float16) for name, value in actor_to_arrays(made.actor).items()}
    return AttentionPolicy(TRAINED_SETUPS[0], arrays)


def measured(policy: AttentionPolicy, seed: int) -> dict[str, dict[str, float]]:
    """Rates of the policy and of whom it imitates, in the same scenes."""
    scenes = crowd_scene_set(REPORT_SCENES, PUBLISHED, purpose=Purpose.REPORT, seed=seed)
    given, act = VARIANTS[VARIANT].given, actor_acts(policy.actor())
    imitated = "constant_velocity"
    return {
        "policy": evaluate_crowds(act, given, scenes).rates(),
        imitated: evaluate_crowds(None, given, scenes, plan=PLANNERS[imitated]).rates(),
    }
