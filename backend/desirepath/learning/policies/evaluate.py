"""Evaluation of a policy on fresh scenes, and paired comparison of two: numbers with intervals.

What an episode's numbers are lives in the engines, hypothesis tests in `analysis`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import NOTHING, interval, mean_estimate, mean_estimates, resample_means, wilson
from desirepath.learning.cards import SOCIAL
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import EpisodeTable
from desirepath.simulation.fast import evaluate as evaluate_fast
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Outcome


def episodes(policy: DrivingPolicy, scenes: list[Scene], engine: str = "fast") -> EpisodeTable:
    """Roll out in every scene once, on the fast engine or (slowly) on PyBullet. LearningError for another engine."""
    setup = get_setup(require_same(policy=policy.setup, **{f"scene {k}": s.setup for k, s in enumerate(scenes)}))
    if engine == "fast":
        return evaluate_fast(policy.rollout_policy, setup, scenes)
    if engine == "pybullet":
        from desirepath.simulation.reference import evaluate_reference  # PyBullet is imported only when asked for

        return evaluate_reference(policy.rollout_policy, setup, scenes)
    raise LearningError(f"engine = {engine!r}: known are fast, pybullet")


def evaluate_policy(
    policy: DrivingPolicy, *, n: int = 2_000, seed: int = 0, engine: str = "fast", purpose: Purpose = Purpose.REPORT
) -> dict[str, Any]:
    """The policy in n fresh scenes of its setup, SI units, keys as in DESIGN's table of commands.

    Rates and means are over all episodes. `intervals` holds [low, high] (95 %) of every number that has one: Wilson
    for rates, bootstrap over scenes for means. `ceiling_m` is the largest mean minimum human distance that any policy
    could reach in these scenes.
    """
    table = episodes(policy, scene_set(policy.setup, n, purpose=purpose, seed=seed), engine)
    return {**describe_table(policy.setup, table), "engine": engine, "seed": seed}


def describe_table(setup: str, table: EpisodeTable) -> dict[str, Any]:
    """What `evaluate_policy` says about episodes that were rolled out already, without engine and seed."""
    n = len(table)
    estimates = {
        "success_rate": wilson(int((table.outcome == Outcome.SUCCESS).sum()), n),
        "collision_rate": wilson(int((table.outcome == Outcome.COLLISION).sum()), n),
        "timeout_rate": wilson(int((table.outcome == Outcome.TIMEOUT).sum()), n),
    }
    estimates |= mean_estimates(episode_columns(table))
    return {
        "setup": setup,
        "n": n,
        **{name: estimate.value for name, estimate in estimates.items()},
        "ceiling_m": float(table.ceiling.mean()),
        "intervals": {name: [estimate.low, estimate.high] for name, estimate in estimates.items()},
    }


def social_means(table: EpisodeTable) -> dict[str, float]:
    """Means of SOCIAL over the episodes."""
    columns = episode_columns(table)
    return {name: float(np.mean(columns[name])) for name in SOCIAL}


def episode_columns(table: EpisodeTable) -> dict[str, NDArray[Any]]:
    """The numbers of an episode that are averaged, by their name in results: (episodes,) each, SI units."""
    return {
        "min_human_distance_m": table.min_human_distance,
        "path_length_m": table.path_length,
        "time_s": table.time,
        "mean_speed_m_s": table.path_length / np.maximum(table.time, table.dt),
        "accumulated_angle_rad": table.accumulated_angle,
        "path_area_m2": table.path_area,
        "min_obstacle_distance_m": table.min_clearance,
        "self_intersections": table.self_intersections,
        **table.social.columns(),
    }


def compare_policies(
    first: DrivingPolicy, second: DrivingPolicy, *, n: int = 2_000, seed: int = 0, engine: str = "fast"
) -> dict[str, Any]:
    """`second` against `first` in the same n fresh scenes.

    `paired`: per number the mean `difference` (second - first) and `ratio` of the means (second / first), each with
    low and high, over the scenes in which both succeed; no ratio where the first's mean may be 0 as far as these scenes
    tell (a resample of theirs with nothing in it). `success_difference`: over all scenes.
    """
    setup = require_same(first=first.setup, second=second.setup)
    scenes = scene_set(setup, n, purpose=Purpose.REPORT, seed=seed)
    tables = episodes(first, scenes, engine), episodes(second, scenes, engine)
    return {"setup": setup, "n": n, "seed": seed, "engine": engine, **compare_tables(*tables)}


def compare_tables(a: EpisodeTable, b: EpisodeTable) -> dict[str, Any]:
    """What `compare_policies` says about episodes of the same scenes that were rolled out already."""
    both = a.success & b.success
    of_a, of_b = episode_columns(a), episode_columns(b)
    first = np.stack([values[both] for values in of_a.values()], axis=1).astype(np.float64)
    second = np.stack([values[both] for values in of_b.values()], axis=1).astype(np.float64)
    paired: dict[str, Any] = {name: {"difference": NOTHING.as_dict()} for name in of_a}
    if both.any():
        means = np.split(resample_means(np.concatenate([first, second], axis=1)), 2, axis=1)
        for k, name in enumerate(of_a):
            was, is_now, before, after = first[:, k].mean(), second[:, k].mean(), means[0][:, k], means[1][:, k]
            paired[name] = {"difference": interval(float(is_now - was), after - before).as_dict()}
            if (before > 0).all() and name != "self_intersections":
                paired[name]["ratio"] = interval(float(is_now / was), after / before).as_dict()
    return {
        "both_succeed": int(both.sum()),
        "success_difference": mean_estimate(b.success.astype(np.float64) - a.success).as_dict(),
        "ceiling_m": float(a.ceiling.mean()),
        "ceiling_both_succeed_m": float(a.ceiling[both].mean()) if both.any() else None,
        "paired": paired,
    }
