"""The shipped policy with attention, with its card. Cloning is `learning/pedestrians/cloned_attention.py`'s."""

from __future__ import annotations

from pathlib import Path

from backend.learning.cards import Card, card_path, file_sha256, source_commit
from backend.learning.pedestrians.attention_policy import AttentionPolicy
from backend.learning.pedestrians.cloned_attention import CloneConfig, clone
from backend.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from backend.learning.pedestrians.crowd_networks import VARIANTS, actor_acts
from backend.learning.pedestrians.crowd_planners import PLANNERS
from backend.learning.scene_sets import Purpose, describe
from backend.learning.shipped_files import DATASETS
from backend.learning.td3.base import OnProgress, no_progress
from backend.simulation.crowds.crowd_scenes import PUBLISHED

REPORT_SCENES = 300
NAME = "attention"


def ship_attention(seed: int = 0, folder: Path = DATASETS, on_progress: OnProgress = no_progress) -> Card:
    """Clone, measure and store the policy."""
    config = CloneConfig(seed=seed)
    policy = clone(config, lambda words: on_progress(0.5, {}))
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
        results=measured(AttentionPolicy.load(path), config),
        departures=[
            "Cloned from the ORCA planner, which is told everybody's motion, by what the robot senses; the thesis "
            "trains its networks by DDPG. Curriculum, reward and 300,000 episodes of chapter 4 have no part in it.",
        ],
        notes=[
            "A tiny budget (minutes of a core), so that attention can be looked at; no number of chapter 4 is claimed.",
            "Rates in % in the published setting: two at 0.6 m/s who avoid nobody, one stands.",
        ],
    )
    card.save(card_path(path))
    return card


def measured(policy: AttentionPolicy, config: CloneConfig) -> dict[str, dict[str, float]]:
    """Rates of the clone and of whom it imitates, in the same scenes."""
    scenes = crowd_scene_set(REPORT_SCENES, PUBLISHED, purpose=Purpose.REPORT, seed=config.seed)
    given, act = VARIANTS["ours"].given, actor_acts(policy.actor())
    return {
        "clone": evaluate_crowds(act, given, scenes).rates(),
        config.planner: evaluate_crowds(None, given, scenes, plan=PLANNERS[config.planner]).rates(),
    }
