"""Benchmark: how long the batched work takes that people wait for, episodes of an evaluation and a flow-field plot.

And where the time goes, beside what the core could do. Policies and scenes are shipped ones; nothing is stored.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from desirepath.explain.flow_field import flow_field
from desirepath.explain.flow_files import flow_files
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.scene_sets import Purpose, first_seed, scene_set
from desirepath.learning.td3.backprop import Floats
from desirepath.simulation.fast import evaluate
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.limits import LARGE, matmul_gflops

SEED = 9_500  # of reporting scenes that no card uses
ROUNDS = 3


class _Counted:
    """A policy's `act` that adds up the states it is asked about and the processor seconds of its networks."""

    def __init__(self, policy: Policy) -> None:
        self._act, self._shape = policy.act, policy.shape
        self.states, self.seconds = 0, 0.0

    def __call__(self, observations: Floats) -> Floats:
        began = time.process_time()
        actions = self._act(observations)
        self.seconds += time.process_time() - began
        self.states += len(observations)
        return actions

    def gflop(self) -> float:
        """1e9 operations of all matrix products so far."""
        return 2e-9 * self.states * sum(inputs * outputs for inputs, outputs in self._shape.actor_layers())


def benchmark_evaluate(*, setup: str = "open_field", episodes: int = 2_000) -> dict[str, Any]:
    """The setup's base policy, as it acts without a recovery: `evaluate` rolls out that many episodes to their end,
    `flow_field` computes the plot of one scene and draws it (PNG, SVG, CSV), `flow_field_numbers` only computes it.

    Each with seconds of the processor and by the wall clock, the fastest of three rounds, one thread. `states`: how
    many the policy was asked about, one per robot and step. `networks`: seconds in its networks, and the rate of their
    matrix products as a share of that of large ones (`matmul_gflops`); the rest is the simulator's and ours.
    """
    chosen, policy = get_setup(setup), load_policy(f"{setup}/base")
    drawn = scene_set(setup, episodes, purpose=Purpose.REPORT, seed=SEED)
    shown = draw_scene(chosen, first_seed(Purpose.FIGURE, 0))
    peak = matmul_gflops(LARGE)

    def measured(work: Callable[[_Counted], object]) -> dict[str, Any]:
        seconds, wall, counted = min((_timed(work, _Counted(policy)) for _ in range(ROUNDS)), key=lambda one: one[0])
        gflops = counted.gflop() / counted.seconds
        return {
            "seconds": seconds,
            "wall_seconds": wall,
            "states": counted.states,
            "networks": {"seconds": counted.seconds, "gflops": gflops, "share_of_peak": gflops / peak},
            "rest_ns_per_state": 1e9 * (seconds - counted.seconds) / counted.states,
        }

    return {
        "setup": setup,
        "episodes": episodes,
        "evaluate": measured(lambda act: evaluate(act, chosen, drawn)),
        "flow_field": measured(lambda act: flow_files([(f"{setup}/base", act)], chosen, shown)),
        "flow_field_numbers": measured(lambda act: flow_field(act, chosen, shown)),
        "flow_field_scene_seed": shown.seed,
        "matmul_gflops": peak,
        "threads": 1,
    }


def _timed(work: Callable[[_Counted], object], act: _Counted) -> tuple[float, float, _Counted]:
    """Seconds of the processor and by the wall clock, and what was counted."""
    began, began_wall = time.process_time(), time.perf_counter()
    work(act)
    return time.process_time() - began, time.perf_counter() - began_wall, act
