"""How far success on the fast engine carries over to rigid bodies: one policy, the same scenes, both engines."""

from __future__ import annotations

from typing import Any

import numpy as np

from desirepath.analysis.estimates import mean_estimate
from desirepath.analysis.metrics import collision_rate, success_rate, timeout_rate
from desirepath.learning.policies.evaluate import compare_tables
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import EpisodeTable, evaluate
from desirepath.simulation.reference import evaluate_reference
from desirepath.simulation.setups import get_setup

FIRST_PARITY_SEED = 9_000  # reporting scenes that no card uses


def benchmark_parity(*, policy: str = "open_field/base", scenes: int = 1_000, seed: int = 0) -> dict[str, Any]:
    """A policy (shipped name or path) on the fast engine and in PyBullet with wheel motors, in the same fresh scenes.

    `success_gap_points`: success on the fast engine minus that in PyBullet, in percentage points, with its 95 %
    bootstrap interval over scenes (paired). `paired`: the other numbers, PyBullet against fast, over the scenes in
    which both succeed. Takes minutes: PyBullet makes a few hundred steps per second.
    """
    rolled_out = load_policy(policy)
    setup = get_setup(rolled_out.setup)
    drawn = scene_set(setup.name, scenes, purpose=Purpose.REPORT, seed=FIRST_PARITY_SEED + seed)
    fast = evaluate(rolled_out.rollout_policy, setup, drawn)
    pybullet = evaluate_reference(rolled_out.rollout_policy, setup, drawn, drive_mode="wheels")
    gap = mean_estimate(100 * (fast.success.astype(np.float64) - pybullet.success))
    compared = compare_tables(fast, pybullet)
    return {
        "policy": policy,
        "setup": setup.name,
        "n": scenes,
        "seed": seed,
        "pybullet_drive_mode": "wheels",
        "fast": _rates(fast),
        "pybullet": _rates(pybullet),
        "success_gap_points": gap.as_dict(),
        "only_fast_succeeds": int((fast.success & ~pybullet.success).sum()),
        "only_pybullet_succeeds": int((pybullet.success & ~fast.success).sum()),
        "both_succeed": compared["both_succeed"],
        "paired": compared["paired"],
    }


def _rates(table: EpisodeTable) -> dict[str, float]:
    return {
        "success_rate": success_rate(table.outcome),
        "collision_rate": collision_rate(table.outcome),
        "timeout_rate": timeout_rate(table.outcome),
    }
