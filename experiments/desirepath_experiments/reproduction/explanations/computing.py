"""What each task of chapter 8 computes: the policy, what it explains in the 48 scenarios, simulated people who rank.

Rankers see what a person would: with outlines the scores, through their own noise, and in any case what lies near and
ahead. How far they go by either is put in, below; what comes of it is the study's own analysis.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product
from typing import Any

import numpy as np

from desirepath.analysis.metrics import collision_rate, success_rate, timeout_rate
from desirepath.explain.ranking_sets import RankingSet, ranking_set
from desirepath.explain.shown_explanation import simulate_ranking
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import base_config, train_base
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.explanation_findings import Explained, analyse_rankings
from desirepath.report.rating_findings import measures
from desirepath.report.simulated_rankers import Effect, RankerCohort, condition_name, item_texts, simulate_ratings
from desirepath.report.study_data import ImportanceRanking, ParticipantRow, StudyData
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.explanations.scenarios import PRACTICE, SCENARIOS, practice_rooms, rooms
from desirepath_experiments.reproduction.explanations.slowing import slowing
from desirepath_experiments.reproduction.tasks import Function, TaskResult, as_bytes

EXPLAINED_ROOM = get_setup("explained_room")

SHIPPED = f"{EXPLAINED_ROOM.name}/base"
CELLS = tuple(product((False, True), repeat=2))  # outline, lidar
ORDERS = tuple(permutations(range(len(CELLS))))  # all 24
SLOWING_SCENES = 100
NOISE_PLACES = (0.6, 2.2)
"""Ours: how unsure a ranker is, in places; each one's own, drawn evenly in between."""
TRUST = (0.0, 0.6)
"""Ours: how far a ranker who has outlines goes by them rather than by what lies near and ahead; drawn evenly."""
RATED: dict[str, Effect] = {"awareness": (0.55, 0.55, -0.5), "plausibility": (0.0, 0.9, 0.0)}
"""Ours: what outlines, lidar and both beyond their sum add to opinions (standard deviations), near what was printed."""


def policy(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The policy, trained anew (seed) or as shipped (None), in fresh report scenes. meta: rates, how often it slows
    down and for what. arrays: content, its bytes."""
    del needs
    if params["seed"] is None:
        chosen, selection = load_policy(SHIPPED), None
    else:
        trained = train_base(base_config(EXPLAINED_ROOM.name, params["seed"]))
        chosen, selection = trained.policy.without_critic(), trained.selection_success
    drawn = scene_set(EXPLAINED_ROOM.name, params["scenes"], purpose=Purpose.REPORT, seed=1)
    rolled_out = rollout(EXPLAINED_ROOM, chosen.rollout_policy, drawn)
    outcomes = [trajectory.outcome for trajectory in rolled_out]
    meta = {
        "success": success_rate(outcomes),
        "collision": collision_rate(outcomes),
        "timeout": timeout_rate(outcomes),
        "selection_success": selection,
        "slowing": slowing(actor_of(chosen), rolled_out[:SLOWING_SCENES]),
    }
    return TaskResult(meta, {"content": as_bytes(chosen.to_bytes())})


def explained_scenarios(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """What the policy is explained by in the 48 scenarios and in practice, up to the halt. arrays: content, a ranking
    set. meta: scores of 0 and ties."""
    chosen = Policy.from_bytes(needs[0].content("content"))
    ranked = ranking_set(
        actor_of(chosen), chosen.rollout_policy, rooms(), practice_rooms(), count=SCENARIOS, practised=PRACTICE,
        policy=SHIPPED, method=params["method"], command="speed",
    )  # fmt: skip
    regular = [explained.at_halt for explained in ranked.rollouts if not explained.practice]
    meta = {
        "scenarios": len(regular),
        "with_tied_scores": sum(len(set(scores.values())) < len(scores) for scores in regular),
        "objects_without_score": sum(score == 0 for scores in regular for score in scores.values()),
    }
    return TaskResult(meta, {"content": as_bytes(ranked.to_bytes())})


def rankers(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Studies of `participants` simulated people; the first one's tables, and how often each effect is found in all of
    them. meta: tau, tables, found (effect -> share of `studies`)."""
    shown = RankingSet.from_bytes(needs[0].content("content"))
    plan = AnalysisPlan()
    studies = [
        analysed(simulated_study(shown, params["participants"], params["seed"], k), plan)
        for k in range(params["studies"])
    ]
    names = [test.about for test in studies[0].tests]
    hits = [[test.p <= plan.alpha for test in study.tests] for study in studies]
    meta = {
        "tests": {test.about: {"F": test.statistic, "p": test.p, "effect": test.effect} for test in studies[0].tests},
        "means": {
            outcome.key: {name: [m.mean, m.sd] for name, m in outcome.means.items()} for outcome in studies[0].outcomes
        },
        "tau": {str(on): _tau(studies[0], on) for on in (True, False)},
        "found": dict(zip(names, np.mean(hits, axis=0).tolist(), strict=True)),
        "studies": len(studies),
        "rankings": len(studies[0].trials),
    }
    return TaskResult(meta, {})


def simulated_study(shown: RankingSet, participants: int, seed: int, number: int) -> StudyData:
    """One study as chapter 8's: within subjects, all 24 orders in turn, 12 scenarios in each of four blocks, every
    scenario once per person."""
    regular = [explained for explained in shown.rollouts if not explained.practice]
    people, rankings, ratings = [], [], []
    names = [condition_name(outline=outline, lidar=lidar) for outline, lidar in CELLS]
    for k in range(participants):
        code = f"S{k + 1:03d}"
        random = np.random.default_rng([seed, number, k])
        order = ORDERS[k % len(ORDERS)]
        people.append(ParticipantRow(code, True, None, False, "completed", tuple(names[cell] for cell in order)))
        noise, trust = random.uniform(*NOISE_PLACES), random.uniform(*TRUST)
        blocks = np.array_split(random.permutation(len(regular)), len(CELLS))
        for cell, block in zip(order, blocks, strict=True):
            outline, lidar = CELLS[cell]
            for scenario in block:
                scenario_shown = regular[scenario]
                seen = scenario_shown.at_halt if outline else None  # nobody else has access to what outlines say
                order_given = simulate_ranking(
                    scenario_shown.trajectory,
                    scenario_shown.things,
                    seen,
                    random,
                    noise=float(noise),
                    trust=float(trust),
                )
                rankings.append(
                    ImportanceRanking(
                        code, names[cell], f"scenario-{scenario}", "regular", ranking=tuple(order_given),
                        scores=scenario_shown.at_halt, outline=outline, lidar=lidar,
                    )
                )  # fmt: skip
        cohort = RankerCohort(ratings=RATED, seed=seed + 1000 * number)
        ratings += simulate_ratings(cohort, code, k)
    protocol = {"protocol": "reproduced", "version": 1}
    return StudyData(
        "chapter 8", "simulated", protocol, "", item_texts(), people, [], ratings, [], importance=rankings
    )  # fmt: skip


def analysed(data: StudyData, plan: AnalysisPlan) -> Explained:
    """The report's own analysis."""
    explained = analyse_rankings(data.importance, measures(data, plan, []), plan, intervals=False)
    assert explained is not None  # noqa: S101 - everybody ranked
    return explained


def _tau(study: Explained, outline: bool) -> list[float]:
    """Mean and standard deviation over people of tau with or without outlines."""
    own: dict[str, list[float]] = {}
    for trial in study.trials:
        if trial.of.outline == outline and np.isfinite(trial.tau):
            own.setdefault(trial.of.person, []).append(trial.tau)
    means = [float(np.mean(taus)) for taus in own.values()]
    return [float(np.mean(means)), float(np.std(means, ddof=1))]


FUNCTIONS: dict[str, Function] = {function.__name__: function for function in (policy, explained_scenarios, rankers)}
