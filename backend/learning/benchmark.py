"""How long base training takes on this machine, and what it reaches. Ratios come from one run.

Clocks live here and in `benchmark_align.py`, nowhere else in this room.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise

from backend.analysis.metrics import success_rate
from backend.learning.base import BaseConfig, BaseTraining
from backend.learning.errors import LearningError
from backend.learning.networks import use_one_thread
from backend.learning.policy import Policy
from backend.learning.sb3 import policy_of_sb3, sb3_td3
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.td3 import Td3Config
from backend.simulation.environments import FastVecEnv, NavigationEnv
from backend.simulation.fast import evaluate
from backend.simulation.setups import Setup, get_setup

TARGET = 0.94
ARMS = ("fast", "sb3_fast", "sb3_pybullet")
CHECK_SCENES, CONFIRM_SCENES = 500, 2_000
FIRST_CONFIRM_SEED = 100  # reporting scenes that no card uses


@dataclass(frozen=True)
class TrainBenchmarkConfig:
    """Base training's own hyper-parameters, checked often; a training gives up after `max_updates`."""

    updates_per_check: int = 1_200
    max_updates: int = 40_000
    pybullet_steps: int = 600


@dataclass(frozen=True)
class Reached:
    """One training: seconds (evaluations excluded), updates and transitions until the confirmed 94 %, or None."""

    seconds: float | None
    updates: int
    transitions: int
    held_out_success: float | None
    seconds_per_update: float


def _train_until_target(
    setup: Setup, seed: int, chunk: Callable[[], tuple[Policy, int, int]], config: TrainBenchmarkConfig
) -> Reached:
    """Alternate training chunks (timed) and checks (not timed) until 94 % is confirmed on untouched scenes.

    chunk: trains on and returns the policy, and updates and transitions so far.
    """
    check = scene_set(setup.name, CHECK_SCENES, purpose=Purpose.BENCHMARK, seed=seed)
    confirm = scene_set(setup.name, CONFIRM_SCENES, purpose=Purpose.REPORT, seed=FIRST_CONFIRM_SEED + seed)
    seconds, updates, transitions = 0.0, 0, 0
    while updates < config.max_updates:
        began = time.perf_counter()
        policy, updates, transitions = chunk()
        seconds += time.perf_counter() - began
        if success_rate(evaluate(policy.act, setup, check).outcome) < TARGET:
            continue
        confirmed = success_rate(evaluate(policy.act, setup, confirm).outcome)
        if confirmed >= TARGET:
            return Reached(seconds, updates, transitions, confirmed, seconds / updates)
    return Reached(None, updates, transitions, None, seconds / updates)


def _fast_arm(base: BaseConfig, config: TrainBenchmarkConfig) -> Reached:
    training = BaseTraining(base)

    def chunk() -> tuple[Policy, int, int]:
        goal = training.agent.updates + config.updates_per_check
        while training.agent.updates < goal:
            training.vector_step()
        return training.policy(averaged=True), training.agent.updates, training.transitions

    return _train_until_target(training.setup, base.seed, chunk, config)


def _sb3_arm(base: BaseConfig, config: TrainBenchmarkConfig) -> Reached:
    """Stable-Baselines3 with the same network, shaping, environments, noise and updates per step."""
    use_one_thread()
    setup = get_setup(base.setup)
    td3 = Td3Config(setup.gamma, base.batch_size, base.learning_rate, base.tau)
    model = sb3_td3(
        FastVecEnv(setup, base.n_envs, seed=base.seed, progress_weight=base.progress_weight),
        setup,
        td3,
        heads=base.heads,
        seed=base.seed,
        buffer_size=base.buffer_size,
        updates_per_step=base.updates_per_step,
        learning_starts=base.random_transitions,
    )
    noise = VectorizedActionNoise(NormalActionNoise(np.zeros(2), np.ones(2)), base.n_envs)
    noise.noises = [
        NormalActionNoise(np.zeros(2), np.full(2, sigma)) for sigma in np.geomspace(*base.exploration, base.n_envs)
    ]
    model.action_noise = noise
    vector_steps = -(-config.updates_per_check // base.updates_per_step)

    def chunk() -> tuple[Policy, int, int]:
        first = model.num_timesteps == 0
        steps = vector_steps * base.n_envs + (base.random_transitions if first else 0)
        model.learn(steps, reset_num_timesteps=first)
        return policy_of_sb3(model, setup, base.heads), model._n_updates, model.num_timesteps

    return _train_until_target(setup, base.seed, chunk, config)


def _pybullet_seconds_per_step(setup: Setup, steps: int) -> float:
    env = NavigationEnv(setup, engine="pybullet", progress_weight=1.0)
    random = np.random.default_rng(0)
    env.reset(seed=0)
    began = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, _, _ = env.step(random.uniform(-1, 1, 2).astype(np.float32))
        if terminated:
            env.reset()
    seconds = (time.perf_counter() - began) / steps
    env.close()
    return seconds


def benchmark_train(
    *,
    setup: str = "open_field",
    seeds: int = 1,
    arms: Sequence[str] = ARMS,
    config: TrainBenchmarkConfig | None = None,
    base: BaseConfig | None = None,
) -> dict[str, Any]:
    """Seconds of training until a base policy reaches 94 %, ours (`fast`) against SB3 on the same fast engine and on
    PyBullet. One thread each, one after the other, evaluations not counted.

    `seconds_to_94` and `held_out_success` are medians of the first arm named (null if a training never got there).
    The PyBullet arm is not trained: steps to 94 % of SB3 on the fast engine (of ours, where that arm did not run)
    times measured seconds per PyBullet step, plus its updates; `sb3_pybullet_note` says so.
    """
    unknown = [arm for arm in arms if arm not in ARMS]
    if unknown or not arms or seeds < 1:
        raise LearningError(f"arms = {list(arms)}, seeds = {seeds}: known arms are {', '.join(ARMS)}; at least 1 seed")
    config = config or TrainBenchmarkConfig()
    chosen = base or BaseConfig(setup=setup)
    if chosen.setup != setup:
        raise LearningError(f"base.setup = {chosen.setup!r} but setup = {setup!r}")
    runs: dict[str, list[Reached]] = {}
    trained = [arm for arm in arms if arm != "sb3_pybullet"] or ["fast"]
    for arm in trained:
        run = _fast_arm if arm == "fast" else _sb3_arm
        runs[arm] = [run(replace(chosen, seed=seed), config) for seed in range(seeds)]
    medians = {arm: _median([r.seconds for r in results]) for arm, results in runs.items()}
    note = None
    if "sb3_pybullet" in arms:
        steps_of = "sb3_fast" if "sb3_fast" in runs else "fast"
        per_step = _pybullet_seconds_per_step(get_setup(setup), config.pybullet_steps)
        medians["sb3_pybullet"] = _median(
            [
                None if r.seconds is None else r.transitions * per_step + r.updates * r.seconds_per_update
                for r in runs[steps_of]
            ]
        )
        note = (
            f"not trained: steps to 94 % of arm {steps_of} times {per_step * 1e3:.2f} ms per PyBullet step "
            f"(measured over {config.pybullet_steps} steps), plus that arm's time for updates"
        )
    first = arms[0] if arms[0] in runs else trained[0]
    return {
        "setup": setup,
        "seeds": seeds,
        "seconds_to_94": medians[first],
        "held_out_success": _median([r.held_out_success for r in runs[first]]),
        "seconds_to_94_per_arm": medians,
        "per_seed": [
            {
                "arm": arm,
                "seed": seed,
                "seconds_to_94": r.seconds,
                "updates": r.updates,
                "transitions": r.transitions,
                "held_out_success": r.held_out_success,
                "ms_per_update_with_steps": r.seconds_per_update * 1e3,
            }
            for arm, results in runs.items()
            for seed, r in enumerate(results)
        ],
        "ratio_vs_sb3_fast": _ratio(medians.get("sb3_fast"), medians.get("fast")),
        "ratio_vs_sb3_pybullet": _ratio(medians.get("sb3_pybullet"), medians.get("fast")),
        "sb3_pybullet_note": note,
        "network_heads": list(chosen.heads),
        "scenes": {"check": CHECK_SCENES, "confirm": CONFIRM_SCENES},
    }


def _median(values: Sequence[float | None]) -> float | None:
    """The median, where a training that never got there counts as infinitely long."""
    middle = statistics.median(float("inf") if value is None else value for value in values)
    return None if middle == float("inf") else middle


def _ratio(slow: float | None, fast: float | None) -> float | None:
    return None if slow is None or fast is None else slow / fast
