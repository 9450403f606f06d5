"""Evaluation of a policy on fresh scenes, and paired comparison of two: numbers with intervals.

What an episode's numbers are lives in the engines, hypothesis tests in `analysis`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.learning.errors import LearningError
from backend.learning.policy import Policy
from backend.learning.scene_sets import Purpose, scene_set
from backend.simulation.fast import EpisodeTable
from backend.simulation.fast import evaluate as evaluate_fast
from backend.simulation.scene import Scene
from backend.simulation.setups import get_setup, require_same
from backend.simulation.trajectory import Outcome

Doubles = NDArray[np.float64]
BOOTSTRAPS = 2_000
Z_95 = 1.959963984540054


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


def wilson(hits: int, n: int) -> Estimate:
    """A share with its 95 % Wilson score interval."""
    share = hits / n
    centre = (share + Z_95**2 / (2 * n)) / (1 + Z_95**2 / n)
    half = Z_95 * math.sqrt(share * (1 - share) / n + Z_95**2 / (4 * n * n)) / (1 + Z_95**2 / n)
    return Estimate(share, max(0.0, centre - half), min(1.0, centre + half))


def bootstrap(
    columns: Doubles, statistic: Callable[[Doubles], Doubles], *, seed: int = 0, resamples: int = BOOTSTRAPS
) -> Estimate:
    """Percentile bootstrap over rows. columns: (n, k). statistic: means (m, k) -> (m,) values."""
    if len(columns) == 0:
        return Estimate(math.nan, math.nan, math.nan)
    random = np.random.default_rng([seed, 95])
    n = len(columns)
    # Multinomial counts are the same resampling with replacement as drawing indices, in one matrix product.
    counts = random.multinomial(n, np.full(n, 1.0 / n), size=resamples)
    values = statistic(counts @ columns / n)
    low, high = np.quantile(values, [0.025, 0.975])
    return Estimate(float(statistic(columns.mean(0, keepdims=True))[0]), float(low), float(high))


def mean_estimate(values: NDArray[Any], *, seed: int = 0) -> Estimate:
    """Mean with its 95 % bootstrap interval."""
    return bootstrap(np.asarray(values, dtype=np.float64)[:, None], lambda means: means[:, 0], seed=seed)


def episodes(policy: Policy, scenes: list[Scene], engine: str = "fast") -> EpisodeTable:
    """Drive every scene once, on the fast engine or (slowly) on PyBullet. Raises LearningError for another engine."""
    setup = get_setup(require_same(policy=policy.setup, **{f"scene {k}": s.setup for k, s in enumerate(scenes)}))
    if engine == "fast":
        return evaluate_fast(policy.act, setup, scenes)
    if engine == "pybullet":
        from backend.simulation.reference import evaluate_reference  # PyBullet is imported only when asked for

        return evaluate_reference(policy.act, setup, scenes)
    raise LearningError(f"engine = {engine!r}: known are fast, pybullet")


def evaluate_policy(
    policy: Policy, *, n: int = 2_000, seed: int = 0, engine: str = "fast", purpose: Purpose = Purpose.REPORT
) -> dict[str, Any]:
    """The policy in n fresh scenes of its setup, SI units, keys as in DESIGN's table of commands.

    Rates and means are over all episodes. `intervals` holds [low, high] (95 %) of every number that has one: Wilson
    for rates, bootstrap over scenes for means. `ceiling_m` is the largest mean minimum human distance that any policy
    could reach in these scenes.
    """
    table = episodes(policy, scene_set(policy.setup, n, purpose=purpose, seed=seed), engine)
    return {**describe_table(policy.setup, table), "engine": engine, "seed": seed}


def describe_table(setup: str, table: EpisodeTable) -> dict[str, Any]:
    """What `evaluate_policy` says about episodes that were driven already, without engine and seed."""
    n = len(table)
    estimates = {
        "success_rate": wilson(int((table.outcome == Outcome.SUCCESS).sum()), n),
        "collision_rate": wilson(int((table.outcome == Outcome.COLLISION).sum()), n),
        "timeout_rate": wilson(int((table.outcome == Outcome.TIMEOUT).sum()), n),
    }
    estimates |= {name: mean_estimate(values) for name, values in episode_columns(table).items()}
    return {
        "setup": setup,
        "n": n,
        **{name: estimate.value for name, estimate in estimates.items()},
        "ceiling_m": float(table.ceiling.mean()),
        "intervals": {name: [estimate.low, estimate.high] for name, estimate in estimates.items()},
    }


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
    }


def compare_policies(
    first: Policy, second: Policy, *, n: int = 2_000, seed: int = 0, engine: str = "fast"
) -> dict[str, Any]:
    """`second` against `first` in the same n fresh scenes.

    `paired`: per number the mean `difference` (second - first) and `ratio` of the means (second / first), each with
    low and high, over the scenes in which both succeed. `success_difference`: over all scenes.
    """
    setup = require_same(first=first.setup, second=second.setup)
    scenes = scene_set(setup, n, purpose=Purpose.REPORT, seed=seed)
    tables = episodes(first, scenes, engine), episodes(second, scenes, engine)
    return {"setup": setup, "n": n, "seed": seed, "engine": engine, **compare_tables(*tables)}


def compare_tables(a: EpisodeTable, b: EpisodeTable) -> dict[str, Any]:
    """What `compare_policies` says about episodes of the same scenes that were driven already."""
    both = a.success & b.success
    paired: dict[str, Any] = {}
    columns_b = episode_columns(b)
    for name, values in episode_columns(a).items():
        columns = np.stack([values[both], columns_b[name][both]], axis=1).astype(np.float64)
        entry = {"difference": bootstrap(columns, lambda means: means[:, 1] - means[:, 0]).as_dict()}
        if both.any() and columns[:, 0].mean() > 0 and name != "self_intersections":
            entry["ratio"] = bootstrap(columns, lambda means: means[:, 1] / means[:, 0]).as_dict()
        paired[name] = entry
    success = np.stack([a.success, b.success], axis=1).astype(np.float64)
    return {
        "both_succeed": int(both.sum()),
        "success_difference": bootstrap(success, lambda means: means[:, 1] - means[:, 0]).as_dict(),
        "ceiling_m": float(a.ceiling.mean()),
        "ceiling_both_succeed_m": float(a.ceiling[both].mean()) if both.any() else None,
        "paired": paired,
    }
