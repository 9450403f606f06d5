"""Ours beside CAPQL of `morl-baselines`, at the same transitions: hypervolume, expected utility, sparsity, CPU seconds.

python -m desirepath_experiments.benchmarks.morl_library --transitions 20000 --out FILE

The library is not among our dependencies: its own (moviepy) refuse the Pillow that the product needs. It is found where
`pip install --no-deps --target DIR morl-baselines pymoo autograd moocore cma wandb ...` put it, with DIR on PYTHONPATH.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.adaptable.objectives import DemonstrationReward, thesis_vectors
from desirepath.learning.adaptable.vector_env import AdaptableEnv, shipped_demonstration
from desirepath.learning.cards import source_commit
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.setups import get_setup
from desirepath_experiments.training.adaptable.rollouts import PreferenceAct, roll_out_preferences
from desirepath_experiments.training.adaptable.training import AdaptableConfig, AdaptableTraining
from desirepath_experiments.training.adaptable.vector_td3 import with_core

ADAPTABLE = get_setup("adaptable")

Floats = NDArray[np.float32]
SCALE = 0.01
WORST = np.array([-20.0, -30.0, -30.0, -30.0])  # reference point: 300 steps of every penalty, two collisions; scaled


def ours(transitions: int, seed: int, demonstration: DemonstrationReward) -> PreferenceAct:
    """MO-TD3-HER with that many transitions, a tenth of them random, one update per transition; no clone helps."""
    first = transitions // 10
    config = AdaptableConfig(
        seed=seed,
        updates=transitions - first,
        heads=(256, 256),
        n_envs=24,
        updates_per_step=24,
        random_transitions=first,
        buffer_size=transitions,
        solutions_every=max(24, transitions // 10 // 24 * 24),
    )
    training = AdaptableTraining(config, demonstration)
    while training.vector_step() < config.updates:
        pass
    return training.averaged().act


def capql(transitions: int, seed: int, demonstration: DemonstrationReward) -> PreferenceAct:
    """The library's CAPQL with its own settings but batch, discount and as many random transitions. Raises ImportError
    that says how the library is got."""
    try:
        import torch
        from morl_baselines.multi_policy.capql.capql import CAPQL
    except ImportError as missing:
        raise ImportError(f"{missing}: install morl-baselines beside the product, as this module's text says") from None
    env = AdaptableEnv(seed=seed, demonstration=demonstration, scale=SCALE, time_limit="terminated")
    agent = CAPQL(
        env, gamma=AdaptableConfig().gamma, batch_size=AdaptableConfig().batch_size, buffer_size=transitions,
        learning_starts=transitions // 10, log=False, seed=seed, device="cpu",
    )  # fmt: skip
    agent.train(total_timesteps=transitions, eval_env=env, ref_point=WORST)

    def act(observations: Floats, preferences: Floats) -> Floats:
        weights = with_core(preferences) / 2  # sums to 1, as the library has it
        with torch.no_grad():
            actions: Floats = agent.policy.get_action(torch.tensor(observations), torch.tensor(weights)).numpy()
        return actions

    return act


def fronts(returns: NDArray[np.float64]) -> dict[str, float]:
    """The library's own indicators of mean returns (vectors, 4), under the weights (1, preference) / 2."""
    from morl_baselines.common.pareto import filter_pareto_dominated
    from morl_baselines.common.performance_indicators import expected_utility, hypervolume, sparsity

    front = list(filter_pareto_dominated(list(returns)))
    weights = list(with_core(thesis_vectors()) / 2)
    return {
        "hypervolume": float(hypervolume(WORST, front)),
        "expected_utility": float(expected_utility(front, weights)),
        "sparsity": float(sparsity(front)),
        "front": len(front),
    }


def compare(transitions: int, seed: int, rollouts: int) -> dict[str, Any]:
    """Both trained and rolled out in the same reporting scenes; CPU seconds are of training alone."""
    use_one_thread()
    demonstration = shipped_demonstration()
    scenes = scene_set(ADAPTABLE.name, rollouts, purpose=Purpose.REPORT, seed=seed)
    vectors = thesis_vectors()
    found: dict[str, Any] = {}
    for name, train in {"ours": ours, "capql": capql}.items():
        began = time.process_time()
        act = train(transitions, seed, demonstration)
        spent = time.process_time() - began
        rolled = roll_out_preferences(act, scenes * len(vectors), np.repeat(vectors, rollouts, axis=0), demonstration)
        means = SCALE * rolled.returns.reshape(len(vectors), rollouts, -1).mean(axis=1, dtype=np.float64)
        found[name] = fronts(means) | {
            "cpu_seconds": spent,
            "success": 100 * float(rolled.success.mean()),
            "utility_at_each": float((means * with_core(vectors)).sum(axis=1).mean() / 2),
        }
    return {"transitions": transitions, "seed": seed, "rollouts": rollouts, "commit": source_commit(), **found}


def main() -> None:
    parser = argparse.ArgumentParser(description="MO-TD3-HER beside CAPQL of morl-baselines.")
    parser.add_argument("--transitions", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rollouts", type=int, default=20)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    found = json.dumps(compare(arguments.transitions, arguments.seed, arguments.rollouts), indent=1)
    print(found)
    if arguments.out:
        arguments.out.write_text(found + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
