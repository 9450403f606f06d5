"""The shipped policy with attention, with its card: `ours` of `reproduce pedestrians --budget small`.

Its training is `learning/pedestrians/imitation.py`'s.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from desirepath.installed import DATASETS
from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from desirepath.learning.pedestrians.crowd_networks import VARIANTS, actor_acts
from desirepath.learning.pedestrians.crowd_planners import PLANNERS
from desirepath.learning.policies.attention import VARIANT, AttentionPolicy
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath_experiments.reproduction.pedestrians.computing import FUNCTIONS, Floats, actor_of
from desirepath_experiments.reproduction.pedestrians.plan import BUDGETS, imitated
from desirepath_experiments.reproduction.tasks import results_of
from desirepath_experiments.training.imitation import ImitationConfig

REPORT_SCENES = 1_000
NAME = "attention"


def ship_attention(seed: int = 0, folder: Path = DATASETS, work: Path | None = None) -> Card:
    """Train, measure and store the policy. work: the `work` folder of such a reproduction, whose finished training is
    used and not computed again."""
    training = imitated(BUDGETS["small"], VARIANT, seed)
    (made,) = results_of([training], FUNCTIONS, work)
    policy = in_half_precision(actor_of(made))
    path = folder / policy.setup / f"{NAME}.npz"
    policy.save(path)
    card = Card(
        kind="attention_policy",
        name=f"{policy.setup}/{NAME}",
        setup=policy.setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship {NAME} {policy.setup} --seed {seed}",
        seed=seed,
        commit=made.meta["made"]["commit"],
        config=ImitationConfig(**training.params["config"]).as_dict(),
        scenes={"report": [describe(Purpose.REPORT, REPORT_SCENES, seed)]},
        results=measured(AttentionPolicy.load(path), seed),
        departures=[
            "Learned by imitation of a search that is told the building and how everybody moves, from what the robot "
            "senses; the thesis trains its networks by DDPG. Reward and curriculum of chapter 4 have no part in it. "
            "Its network ends in the costs of 24 commands instead of one action, and begins with weights drawn as "
            "He et al. (2015).",
        ],
        notes=[
            "Numbers in half precision.",
            "Rates in % in the published setting: two at 0.6 m/s who avoid nobody, one stands.",
        ],
    )
    card.save(card_path(path))
    return card


def in_half_precision(actor: dict[str, Floats]) -> AttentionPolicy:
    """An actor's numbers as a policy."""
    return AttentionPolicy(TRAINED_SETUPS[0], {name: value.astype(np.float16) for name, value in actor.items()})


def measured(policy: AttentionPolicy, seed: int) -> dict[str, dict[str, float]]:
    """Rates and social metrics of the policy and of whom it imitates, in the same scenes."""
    scenes = crowd_scene_set(REPORT_SCENES, PUBLISHED, purpose=Purpose.REPORT, seed=seed)
    given, act = VARIANTS[VARIANT].given, actor_acts(policy.actor())
    search = "constant_velocity"
    return {
        name: table.rates() | table.means()
        for name, table in (
            ("policy", evaluate_crowds(act, given, scenes)),
            (search, evaluate_crowds(None, given, scenes, plan=PLANNERS[search])),
        )
    }
