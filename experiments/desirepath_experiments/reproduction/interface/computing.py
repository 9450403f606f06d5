"""What each task of chapter 7 computes: everybody's answers in three views, a policy per view, its rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.metrics import collision_rate, measure, success_rate, timeout_rate
from desirepath.learning.alignment.relabelling import align
from desirepath.learning.alignment.thesis import ThesisConfig
from desirepath.learning.people.card import people_card
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy, load_queries
from desirepath.learning.preferences.oracles import Oracle, ResponseModel
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import Query
from desirepath.learning.rewards.held_out import accuracy
from desirepath.learning.rewards.interface import InterfaceConfig, fit_interface
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.report.simulated_cohorts import Cohort
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.tasks import Function, TaskResult, as_bytes

SETUP = "study_room"
QUERY_SET = "study_room/queries_500"
PER_VIEW = 25
REPEATED = 5
FIRST_MEMBER = 3_000  # numbers that nobody else is measured with
LAMBDA = 0.2  # 7.4.5
VIEWS = {"immersive": "VR", "top_down": "2D-TD", "first_person": "2D-FPV"}
"""View -> as the tables print it."""
PAIRS = tuple(combinations(VIEWS, 2))
RANKINGS = {"usefulness": "R1 usefulness", "ease_of_use": "R2 ease of use", "intention": "R3 intention to use"}
"""Table 7.1: what people rank the three views by."""
RESPONSE_MODELS = {
    "immersive": ResponseModel(lapse_rate=0.05),
    "top_down": ResponseModel(lapse_rate=0.10, indifference=0.10),
    "first_person": ResponseModel(lapse_rate=0.15, indifference=0.25),
}
"""Ours: how answers stray in each view. The preference itself is the same in all three."""
FIRST_CHOICE = {
    "usefulness": {"immersive": 0.8, "first_person": 0.05},
    "intention": {"immersive": 0.9, "first_person": 0.01},
}
"""Ours: what is put into rankings, near what was printed."""


@lru_cache(maxsize=1)
def queries() -> tuple[Query, ...]:
    return load_queries(QUERY_SET).queries


def people(participants: int, seed: int) -> list[str]:
    """Names of simulated people, of every family of the card in turn."""
    families, first = list(people_card().families), FIRST_MEMBER + 100 * seed
    return [f"{families[k % len(families)]}:{first + k // len(families)}" for k in range(participants)]


def answers(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Everybody answers the same 25 pairs of their own in all views, five of them once more in each. meta: agreement
    between views and with oneself (%, by person), rankings. arrays: asked (people, 25); chosen_VIEW (people, 25), 0 for
    the first trajectory."""
    del needs
    names = people(params["participants"], params["seed"])
    query_rows = np.empty((len(names), PER_VIEW), dtype=np.int64)
    chosen = {view: np.empty((len(names), PER_VIEW), dtype=np.int8) for view in VIEWS}
    steady: dict[str, list[float]] = {view: [] for view in VIEWS}
    for row, name in enumerate(names):
        random = np.random.default_rng([params["seed"], 71, row])
        query_rows[row] = random.choice(len(queries()), PER_VIEW, replace=False)
        own = [queries()[k] for k in query_rows[row]]
        advantages: dict[bool, NDArray[np.float64]] = {}
        for place, view in enumerate(VIEWS):
            oracle = Oracle(name, RESPONSE_MODELS[view], np.random.default_rng([params["seed"], 72, row, place]))
            oracle.answered = PER_VIEW  # whoever changes their mind has done so in practice
            if not advantages:
                advantages[True] = oracle.advantages(own)
            chosen[view][row] = oracle.decide(advantages[True])
            again = random.choice(PER_VIEW, REPEATED, replace=False)
            steady[view].append(float(np.mean(chosen[view][row][again] == oracle.decide(advantages[True][again]))))
    agreement = {
        "/".join(pair): [float(share) for share in (chosen[pair[0]] == chosen[pair[1]]).mean(1)] for pair in PAIRS
    }
    cohort = Cohort(first_choice=FIRST_CHOICE, seed=params["seed"])
    first = {
        ranking: [cohort.person(row).rank(ranking, tuple(VIEWS))[0] for row in range(len(names))]
        for ranking in RANKINGS
    }
    return TaskResult(
        {"people": names, "agreement": agreement, "consistency": steady, "first_choice": first},
        {"asked": query_rows, **{f"chosen_{view}": of for view, of in chosen.items()}},
    )


def aligned(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """One view's answers of all people: reward model, policy."""
    query_rows, chosen = needs[0].arrays["asked"], needs[0].arrays[f"chosen_{params['view']}"]
    preferences = [
        Preference.of(queries()[k], int(choice), source="simulated")
        for k, choice in zip(query_rows.ravel(), chosen.ravel(), strict=True)
    ]
    model = fit_interface(preferences, InterfaceConfig(seed=params["seed"], epochs=params["epochs"]))
    config = ThesisConfig(
        seed=params["seed"],
        updates=params["updates"],
        checkpoints=min(5, params["updates"]),
        reward_weight=LAMBDA,
        online_share=0.5,
        replay_transitions=params["transitions"],
    )
    result = align(load_policy(f"{SETUP}/base"), model, config)
    return TaskResult(
        {"answers": len(preferences), "training_accuracy": accuracy(model, preferences), "history": result.history},
        {"policy": as_bytes(result.policy.to_bytes())},
    )


def rolled_out(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Table 7.3's numbers of a policy, or of the base policy, in fresh scenes; with standard errors."""
    policy = Policy.from_bytes(needs[0].content("policy")) if needs else load_policy(f"{SETUP}/base")
    scenes = scene_set(SETUP, params["scenes"], purpose=Purpose.REPORT, seed=params["seed"])
    metrics = measure(rollout(get_setup(SETUP), policy.rollout_policy, scenes))
    means = {
        "steps": metrics.steps,
        "path_length_m": metrics.path_length,
        "time_s": metrics.time,
        "accumulated_angle_rad": metrics.accumulated_angle,
        "path_area_m2": metrics.path_area,
        "min_human_distance_m": metrics.min_human_distance,
        "mean_speed_m_s": metrics.mean_speed,
    }
    shares = {
        "collision_percent": collision_rate(metrics.outcome),
        "success_percent": success_rate(metrics.outcome),
        "timeout_percent": timeout_rate(metrics.outcome),
    }
    values = {name: 100 * float(rate) for name, rate in shares.items()}
    values |= {name: float(np.nanmean(of)) for name, of in means.items()}
    errors = {name: float(np.nanstd(of) / np.sqrt(len(scenes))) for name, of in means.items()}
    return TaskResult({"values": values, "standard_errors": errors, "scenes": len(scenes)}, {})


FUNCTIONS: dict[str, Function] = {"answers": answers, "aligned": aligned, "rolled_out": rolled_out}
