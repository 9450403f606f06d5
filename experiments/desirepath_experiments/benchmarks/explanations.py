"""Which explanations are true enough to be shown: deletion and insertion per method and command, and their seconds."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from desirepath.explain.attribution import explain
from desirepath.explain.methods import COMMANDS, METHODS
from desirepath.explain.sight import sight_of
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.faithfulness import faithfulness, gain_over_chance

STEPS = 100  # what the milliseconds are scaled to


def benchmark_explanations(policy: Policy, name: str, *, scenes: int, seed: int) -> dict[str, Any]:
    """One trajectory per scene, each method and command.

    Gains over random orders in units of the command in [-1, 1], mean with 95 % interval over scenes. `may_be_shown`:
    both curves' intervals lie above 0. Milliseconds: processor time for 100 steps, what is seen included.
    """
    use_one_thread()
    setup, actor = get_setup(policy.setup), actor_of(policy)
    drawn = scene_set(policy.setup, scenes, purpose=Purpose.REPORT, seed=seed)
    trajectories = rollout(setup, policy.rollout_policy, drawn)
    explain(actor, sight_of(trajectories[0]))  # compiled, imported
    rows = []
    for command in COMMANDS:
        for method in METHODS:
            measured, seconds = [], []
            for trajectory in trajectories:
                began = time.process_time()
                sight = sight_of(trajectory)
                explained = explain(actor, sight, method=method, command=command, seed=seed)
                seconds.append((time.process_time() - began) / len(trajectory.actions))
                measured.append(faithfulness(actor, sight, explained, seed=seed))
            judged = [one for one in measured if one is not None]
            gains = gain_over_chance(judged, seed=seed)
            rows.append(
                {
                    "command": command,
                    "method": method,
                    **{f"{curve}_gain": gains[curve]["mean"] for curve in gains},
                    **{f"{curve}_interval_95": gains[curve]["interval_95"] for curve in gains},
                    "may_be_shown": all(gains[curve]["interval_95"][0] > 0 for curve in ("deletion", "insertion")),
                    "ms_per_100_steps": round(float(np.median(seconds)) * STEPS * 1000, 1),
                    "trajectories": len(judged),
                    "moments": sum(one.moments for one in judged),
                }
            )
    return {
        "policy": name,
        "setup": policy.setup,
        "scenes": describe(Purpose.REPORT, scenes, seed),
        "explanations": rows,
    }
