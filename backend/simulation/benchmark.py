"""How fast the two engines step, in one run: `desirepath benchmark simulate`."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.simulation.fast import FastEngine
from backend.simulation.reference import SUBSTEPS, ReferenceEngine
from backend.simulation.scenes import draw_scene
from backend.simulation.setups import get_setup

ROUNDS = 5


def _random_actions(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    """Any speed, turning at most 0.3 of the limit, so that the robots get somewhere and meet things."""
    return np.asarray(rng.uniform(-1, 1, (count, 2)) * [1.0, 0.3], dtype=np.float32)


def _steps_in(seconds: float, step: Callable[[], int]) -> tuple[int, float]:
    """Call `step` (returns the steps it made) for about that long: (steps, processor seconds)."""
    steps, begin = 0, time.process_time()
    while (spent := time.process_time() - begin) < seconds:
        steps += step()
    return steps, spent


def benchmark_simulate(
    setup: str = "open_field", *, n_envs: int = 256, seconds: float = 18.0, seed: int = 0
) -> dict[str, Any]:
    """Steps per second of the fast engine and of PyBullet on the same kind of work, one thread each.

    Both run the same setup with the same lidar, observation, collision and self-intersection checks and reward under
    random actions, in turns. Seconds are processor time of this process, which on an idle machine is wall-clock time
    and on a busy one does not charge either engine for others' work. The fast engine's time includes its restarts in
    fresh scenes; building PyBullet's scenes is not counted. PyBullet: velocity mode, rayTestBatch with numThreads=1.
    """
    chosen, rng = get_setup(setup), np.random.default_rng(seed)
    fast = FastEngine(chosen, n_envs, seed=seed)
    actions = [_random_actions(rng, n_envs) for _ in range(64)]
    turn, scene_seed, building = 0, 0, 0.0

    def fast_step() -> int:
        nonlocal turn
        turn += 1
        fast.step(actions[turn % len(actions)])
        return n_envs

    with ReferenceEngine(chosen) as reference:

        def reference_step() -> int:
            nonlocal scene_seed, building
            if reference.done:
                begin = time.process_time()
                reference.reset(draw_scene(chosen, scene_seed))
                scene_seed += 1
                building += time.process_time() - begin
            reference.step(_random_actions(rng, 1)[0])
            return 1

        for warm_up in (fast_step, reference_step):  # compile, fill caches
            for _ in range(40):
                warm_up()
        fast_steps = reference_steps = 0
        fast_time = reference_time = building = 0.0
        for _ in range(ROUNDS):
            steps, spent = _steps_in(seconds / ROUNDS / 3, fast_step)
            fast_steps, fast_time = fast_steps + steps, fast_time + spent
            steps, spent = _steps_in(seconds / ROUNDS * 2 / 3, reference_step)
            reference_steps, reference_time = reference_steps + steps, reference_time + spent
        reference_time -= building
    fast_rate, reference_rate = fast_steps / fast_time, reference_steps / reference_time
    return {
        "fast_steps_per_s": fast_rate,
        "pybullet_steps_per_s": reference_rate,
        "ratio": fast_rate / reference_rate,
        "setup": chosen.name,
        "lidar_beams": chosen.lidar.beams,
        "fast_environments": n_envs,
        "pybullet_substeps": SUBSTEPS,
        "pybullet_drive_mode": "velocity",
        "pybullet_ray_threads": 1,
        "threads": 1,
        "fast_steps": fast_steps,
        "pybullet_steps": reference_steps,
        "seed": seed,
    }
