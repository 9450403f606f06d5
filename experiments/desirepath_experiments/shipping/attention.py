"""The shipped policy with attention: `ours` of `reproduce pedestrians --budget small`.

Its training is `training/pedestrians/imitation.py`'s.
"""

from __future__ import annotations

import numpy as np

from desirepath.learning.cards import Card
from desirepath.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from desirepath.learning.pedestrians.crowd_networks import VARIANTS, actor_acts
from desirepath.learning.policies.attention import VARIANT, AttentionPolicy
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.shipping.storing import Request
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath_experiments.reproduction.pedestrians.computing import FUNCTIONS, Floats, actor_of
from desirepath_experiments.reproduction.pedestrians.plan import BUDGETS, imitated
from desirepath_experiments.reproduction.tasks import results_of
from desirepath_experiments.training.pedestrians.crowd_planners import PLANNERS
from desirepath_experiments.training.pedestrians.imitation import ImitationConfig

REPORT_SCENES = 1_000
NAME = "attention"
DEPARTURE = (
    "Learned by imitation of a search that is told the building and how everybody moves, from what the robot senses; "
    "the thesis trains its networks by DDPG. Reward and curriculum of chapter 4 have no part in it. Its network ends "
    "in the costs of 24 commands instead of one action, and begins with weights drawn as He et al. (2015)."
)


def ship_attention(request: Request) -> Card:
    """Train, measure and store the policy; a training that is finished in the request's `work` is used."""
    training = imitated(BUDGETS["small"], VARIANT, request.seed)
    (training_result,) = results_of([training], FUNCTIONS, request.work)
    policy = in_half_precision(actor_of(training_result))
    return request.store(
        "attention_policy",
        NAME,
        policy.save,
        f"{NAME} {policy.setup}",
        commit=training_result.meta["made"]["commit"],
        config=ImitationConfig(**training.params["config"]).as_dict(),
        scenes={"report": [describe(Purpose.REPORT, REPORT_SCENES, request.seed)]},
        results=measure(policy, request.seed),
        departures=[DEPARTURE],
        notes=[
            "Numbers in half precision.",
            "Rates in % in the published setting: two at 0.6 m/s who avoid nobody, one stands.",
        ],
    )


def in_half_precision(actor: dict[str, Floats]) -> AttentionPolicy:
    """An actor's numbers as a policy."""
    return AttentionPolicy(TRAINED_SETUPS[0], {name: value.astype(np.float16) for name, value in actor.items()})


def measure(policy: AttentionPolicy, seed: int) -> dict[str, dict[str, float]]:
    """Rates and social metrics of the policy and of whom it imitates, in the same scenes."""
    scenes = crowd_scene_set(REPORT_SCENES, PUBLISHED, purpose=Purpose.REPORT, seed=seed)
    given, search = VARIANTS[VARIANT].given, "constant_velocity"
    tables = {
        "policy": evaluate_crowds(actor_acts(policy.actor()), given, scenes),
        search: evaluate_crowds(None, given, scenes, plan=PLANNERS[search]),
    }
    return {name: table.rates() | table.means() for name, table in tables.items()}
