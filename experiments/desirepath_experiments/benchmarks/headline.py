"""The headline of personalisation: of what can be attained of a preference, how much does the own policy get?

Every seed draws query scenes, answers and reporting scenes of its own. What can be attained is planned in
`attainable.py`, jointly with arriving. All simulated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import Course, MeasuredRollouts
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import gains
from desirepath.learning.preferences.oracles import JUDGING_CROWDS, ORACLE_PREFERENCES, make_oracle, preference_of
from desirepath.learning.preferences.setup_settings import longest_simulated_s
from desirepath.learning.queries.queries import Query, QueryConfig
from desirepath.learning.queries.varied_queries import VariedConfig, generate_varied_queries
from desirepath.learning.rewards.weights import fit_weights
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.alignment import FIRST_QUERY_SEED
from desirepath_experiments.benchmarks.attainable import NOT_ARRIVED, PlannerConfig, plan_rollouts
from desirepath_experiments.benchmarks.results import Progress

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
FIRST_REPORT_SEED = 900  # reporting scenes that nothing else uses; seed s draws set FIRST_REPORT_SEED + s
MADE_OF_OBJECTIVES = tuple(
    name for name, oracle in ORACLE_PREFERENCES.items() if oracle.weights is not None and oracle.later is None
)
"""The 13 preferences that are weighted sums of objectives, so that what is attained of them can be planned."""


@pydantic.dataclasses.dataclass(frozen=True)
class HeadlineConfig:
    """Which preferences answer how often, and where their policies are measured."""

    setup: Annotated[str, Field(description="study_room, open_field or crowd_hall.")] = "study_room"
    preferences: Annotated[
        tuple[str, ...], Field(min_length=1, description="Whose answers; default all that are made of objectives.")
    ] = MADE_OF_OBJECTIVES
    seeds: Annotated[
        tuple[int, ...],
        Field(min_length=1, description="FIRST-LAST; each draws queries, answers and scenes of its own."),
    ] = (0, 1, 2, 3, 4)
    noises: Annotated[tuple[float, ...], Field(description="Shares of wrong answers, comma-separated.")] = (0.0, 0.1)
    conditioned: Annotated[str, Field(description="A conditioned policy; default the shipped one.")] = ""
    answers: Annotated[int, Field(ge=2, description="Of each preference and seed.")] = 15
    scenes: Annotated[int, Field(ge=1, description="Of each seed, in which success is counted.")] = 500
    planned: Annotated[int, Field(ge=1, description="Of these, in which the best rollouts are planned.")] = 50


@dataclass(frozen=True)
class _Reported:
    """What one seed reports on: its scenes, the base policy in them, and what was attained of each preference."""

    course: Course
    base: MeasuredRollouts
    attained: dict[str, Doubles]


def benchmark_headline(
    config: HeadlineConfig, progress: Progress, planner: PlannerConfig | None = None
) -> dict[str, Any]:
    """Every preference answers `answers` varied queries per seed; its policy is measured in the seed's own scenes.

    Result: {"simulated": True, "setup", "config", "scenes", "summary",
    "preferences", "rows"}. A row holds what the base policy, the policy of the answers, the policy of the true weights
    and the attained rollouts gain by the preference (mean over the planned scenes in which all arrive, typical
    differences), `share` and `share_true` of the way from base to attained, the success rates in all scenes, and what
    the policy was conditioned on. Raises LearningError for preferences that are not made of objectives, or no seeds.
    """
    setup = config.setup
    known = JUDGING_CROWDS if get_setup(setup).pedestrians else MADE_OF_OBJECTIVES
    if config.preferences == MADE_OF_OBJECTIVES:
        config = replace(config, preferences=known)
    unknown = [name for name in config.preferences if name not in known]
    if unknown or config.planned > config.scenes:
        raise LearningError(
            f"preferences = {list(config.preferences)}, planned = {config.planned} of {config.scenes} scenes: known "
            f"preferences are {', '.join(known)}"
        )
    policy = load_conditioned(config.conditioned or f"{setup}/conditioned")
    base = load_policy(f"{setup}/base")
    rows: list[dict[str, Any]] = []
    for place, seed in enumerate(config.seeds):
        scenes = scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=FIRST_REPORT_SEED + seed)
        queries = draw_queries(setup, config.answers, seed)
        course = Course(scenes)
        reported = _Reported(course, course.rollout(base), {})
        few = scenes[: config.planned]
        guides = [trajectory.poses for trajectory in rollout(get_setup(setup), base.rollout_policy, few)]
        for n, name in enumerate(config.preferences):
            reported.attained[name] = plan_rollouts(few, true_weights(name), planner, guides)[0]
            rows += _measure(policy, queries, reported, name, seed, config)
            progress.tell(f"{(place + (n + 1) / len(config.preferences)) / len(config.seeds):.0%}")
    return {
        "simulated": True,
        "setup": setup,
        "config": asdict(config),
        "scenes": [describe(Purpose.REPORT, config.scenes, FIRST_REPORT_SEED + seed) for seed in config.seeds],
        **summarise(rows),
        "rows": rows,
    }


def true_weights(name: str) -> Doubles:
    """(9,) what the preference of that name weighs, summing to 1."""
    weights = preference_of(name).weights
    if weights is None:
        raise LearningError(f"preference {name!r} is not made of objectives; those are {', '.join(MADE_OF_OBJECTIVES)}")
    return weights


def draw_queries(setup: str, answers: int, seed: int) -> Sequence[Query]:
    """Fresh queries that no shipped set holds, by the policy that the shipped varied queries were made with."""
    query_config = QueryConfig(count=answers, seed=FIRST_QUERY_SEED + seed, max_duration_s=longest_simulated_s(setup))
    return generate_varied_queries(load_conditioned(f"{setup}/conditioned"), VariedConfig(query_config)).queries


def _measure(
    policy: ConditionedPolicy,
    queries: Sequence[Query],
    reported: _Reported,
    name: str,
    seed: int,
    config: HeadlineConfig,
) -> list[dict[str, Any]]:
    true = true_weights(name)
    conditioned = _roll_out(policy, (true / true.max()).astype(np.float32), reported.course)
    rows = []
    for lapse_rate in config.noises:
        answers = make_oracle(name, lapse_rate=lapse_rate, seed=seed).answer(queries)
        weights = fit_weights(answers).preference_weights()
        own = _roll_out(policy, weights, reported.course)
        rows.append(
            {
                "preference": name,
                "lapse_rate": lapse_rate,
                "seed": seed,
                "conditioned_on": {k: float(w) for k, w in zip(policy.objectives, weights, strict=True) if w > 0},
                "foremost_found": int(weights.argmax()) == int(true.argmax()),
                **compare_with_attained(own, conditioned, reported.base, reported.attained[name], true, policy.setup),
            }
        )
    return rows


def _roll_out(policy: ConditionedPolicy, weights: Floats, course: Course) -> MeasuredRollouts:
    return course.rollout(policy.at(weights).without_critic())


def compare_with_attained(
    own: MeasuredRollouts,
    conditioned: MeasuredRollouts,
    base: MeasuredRollouts,
    planned: Doubles,
    true: Doubles,
    setup: str,
) -> dict[str, Any]:
    """Worths and shares in the first len(planned) scenes in which own, conditioned and base arrive and a plan does,
    and the success rates and crossings in all.

    What a policy attained itself counts as attained, where the planner found nothing as good.
    """
    few = len(planned)
    typical = typical_differences(setup)
    gained = [gains(rollouts.measured[:few] / typical) @ true for rollouts in (base, own, conditioned)]
    both = base.success[:few] & own.success[:few] & conditioned.success[:few] & (planned > NOT_ARRIVED)
    at_base, at_own, at_conditioned = (of_policy[both] for of_policy in gained)
    best = np.max([planned[both], at_base, at_own, at_conditioned], axis=0)
    possible = float((best - at_base).mean())
    return {
        "base": float(at_base.mean()),
        "own": float(at_own.mean()),
        "true_weights": float(at_conditioned.mean()),
        "attained": float(best.mean()),
        "share": float((at_own - at_base).mean()) / possible,
        "share_true": float((at_conditioned - at_base).mean()) / possible,
        "compared_in": int(both.sum()),
        "success": float(own.success.mean()),
        "success_true": float(conditioned.success.mean()),
        "success_base": float(base.success.mean()),
        "self_intersections": float(own.self_intersections.mean()),
        "self_intersections_base": float(base.self_intersections.mean()),
    }


def summarise(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """`preferences`: per preference and lapse rate, medians over seeds with the lowest and highest; `summary`: per
    lapse rate the median over all runs, the worst preference (its median over seeds), the worst single run."""
    lines: list[dict[str, Any]] = []
    summary: list[dict[str, Any]] = []
    rates = list(dict.fromkeys(row["lapse_rate"] for row in rows))
    for lapse_rate, name in product(rates, dict.fromkeys(row["preference"] for row in rows)):
        of = [row for row in rows if (row["lapse_rate"], row["preference"]) == (lapse_rate, name)]
        shares = [row["share"] for row in of]
        lines.append(
            {
                "preference": name,
                "lapse_rate": lapse_rate,
                "share": float(np.median(shares)),
                "share_lowest": min(shares),
                "share_highest": max(shares),
                "share_true": float(np.median([row["share_true"] for row in of])),
                **{
                    key: float(np.mean([row[key] for row in of])) for key in ("base", "own", "true_weights", "attained")
                },
                "foremost_found": float(np.mean([row["foremost_found"] for row in of])),
                "success": float(np.mean([row["success"] for row in of])),
                "success_lowest": min(row["success"] for row in of),
                "success_base": float(np.mean([row["success_base"] for row in of])),
                "self_intersections": float(np.mean([row["self_intersections"] for row in of])),
            }
        )
    for lapse_rate in rates:
        of = [row for row in rows if row["lapse_rate"] == lapse_rate]
        by_preference = [line for line in lines if line["lapse_rate"] == lapse_rate]
        worst = min(by_preference, key=lambda line: line["share"])
        every = np.array([row["share"] for row in of])
        summary.append(
            {
                "lapse_rate": lapse_rate,
                "runs": len(of),
                "median_share": float(np.median(every)),
                "quartiles": [float(q) for q in np.quantile(every, (0.25, 0.75))],
                "worst_preference": worst["preference"],
                "worst_share": worst["share"],
                "worst_run": float(every.min()),
                "median_share_true": float(np.median([row["share_true"] for row in of])),
                "success": float(np.mean([row["success"] for row in of])),
                "success_lowest_preference": min(line["success"] for line in by_preference),
                "success_base": float(np.mean([row["success_base"] for row in of])),
            }
        )
    return {"summary": summary, "preferences": lines}
