"""Benchmark: how long the batched work takes that people wait for, episodes of an evaluation and a flow-field plot.

Policies and scenes are shipped ones; nothing is stored.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from backend.explain.flow_files import flow_files
from backend.learning.scene_sets import Purpose, first_seed, scene_set
from backend.learning.shipped import load_policy
from backend.simulation.fast import evaluate
from backend.simulation.scenes import draw_scene
from backend.simulation.setups import get_setup

SEED = 9_500  # of reporting scenes that no card uses
ROUNDS = 3


def benchmark_evaluate(*, setup: str = "open_field", episodes: int = 2_000) -> dict[str, Any]:
    """The setup's base policy: `evaluate` drives that many episodes to their end, `flow_field` computes and draws the
    plot of one scene (PNG, SVG, CSV).

    Each with seconds of the processor and by the wall clock, the fastest of three rounds.
    """
    chosen, policy = get_setup(setup), load_policy(f"{setup}/base")
    drawn = scene_set(setup, episodes, purpose=Purpose.REPORT, seed=SEED)
    shown = draw_scene(chosen, first_seed(Purpose.FIGURE, 0))
    return {
        "setup": setup,
        "episodes": episodes,
        "evaluate": _fastest(lambda: evaluate(policy.driver, chosen, drawn)),
        "flow_field": _fastest(lambda: flow_files([(f"{setup}/base", policy.driver)], chosen, shown)),
        "flow_field_scene_seed": shown.seed,
        "threads": 1,
    }


def _fastest(work: Callable[[], object]) -> dict[str, float]:
    """The round that cost least processor time."""
    rounds = []
    for _ in range(ROUNDS):
        began, began_wall = time.process_time(), time.perf_counter()
        work()
        rounds.append((time.process_time() - began, time.perf_counter() - began_wall))
    seconds, wall = min(rounds)
    return {"seconds": seconds, "wall_seconds": wall}
