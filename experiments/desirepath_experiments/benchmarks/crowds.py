"""How fast crowds are simulated, against PyBullet, in one run: `desirepath benchmark crowds`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from desirepath.simulation.crowds.crowd_engine import CrowdEngine, CrowdPool
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS, get_crowd_setup
from desirepath.simulation.pedestrians import BEHAVIOURS, CrowdConditions
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.benchmarks.crowd_reference import CrowdReference
from desirepath_experiments.benchmarks.engines import steps_in

ROUNDS = 4
SCENES = 48  # of the pool: drawn before anything is measured


def benchmark_crowds(*, pedestrians: int = 8, n_envs: int = 64, seconds: float = 16.0, seed: int = 0) -> dict[str, Any]:
    """Steps per second of the crowd engine and of PyBullet among so many moving pedestrians, one thread, in one run.

    The same scenes (all three buildings), lidar (1,440 beams), contacts and random actions; in turns, processor time.
    `path`: pedestrians that avoid nobody, as PyBullet walks them; `orca`, `social_force`: who avoid; `descriptors`:
    `path` with aligned group descriptors in every step. Neither's drawing and building of scenes is counted.
    """
    crowd = CrowdConditions(moving=(pedestrians, pedestrians), standing=(1, 1))
    rng = np.random.default_rng(seed)
    actions = itertools.cycle([(rng.uniform(-1, 1, (n_envs, 2)) * [1.0, 0.3]).astype(np.float32) for _ in range(64)])
    contestants: dict[str, Callable[[], int]] = {}
    spent_elsewhere = {}
    for behaviour in BEHAVIOURS:
        conditions = CrowdConditions(crowd.moving, crowd.standing, crowd.speeds, behaviour)
        pool = CrowdPool(TRAINED_SETUPS, seed, conditions, SCENES)
        for _ in range(SCENES):
            pool.take()
        contestants[behaviour] = _stepper(CrowdEngine(n_envs=n_envs, pool=pool), actions, described=False)
        if behaviour == "path":
            engine = CrowdEngine(n_envs=n_envs, pool=pool)
            contestants["descriptors"] = _stepper(engine, actions, described=True)
    reference = _Reference(seed, crowd)
    contestants["pybullet"] = reference.step
    for step in contestants.values():
        step()
    steps, spent = dict.fromkeys(contestants, 0), dict.fromkeys(contestants, 0.0)
    reference.building = 0.0
    for _ in range(ROUNDS):
        for who, step in contestants.items():
            made, took = steps_in(seconds / ROUNDS / len(contestants), step)
            steps[who], spent[who] = steps[who] + made, spent[who] + took
    spent_elsewhere["pybullet"] = reference.building
    reference.engine.__exit__()
    rate = {who: steps[who] / (spent[who] - spent_elsewhere.get(who, 0.0)) for who in contestants}
    return {
        "pedestrians": pedestrians,
        "steps_per_s": rate,
        "ratio": rate["path"] / rate["pybullet"],
        "ratio_with_descriptors": rate["descriptors"] / rate["pybullet"],
        "environments": n_envs,
        "threads": 1,
        "seconds_are": "processor time",
        "steps": steps,
        "seed": seed,
    }


def _stepper(engine: CrowdEngine, actions: Any, *, described: bool) -> Callable[[], int]:
    def step() -> int:
        engine.step(next(actions))
        if described:
            engine.descriptors()
        engine.restart()
        return engine.n_envs

    return step


class _Reference:
    """PyBullet under random actions, in a new scene whenever an episode has ended."""

    def __init__(self, seed: int, crowd: CrowdConditions) -> None:
        self.engine = CrowdReference(get_crowd_setup(TRAINED_SETUPS[0]))
        self.engine.outcome = Outcome.TIMEOUT
        self.building, self._scene = 0.0, seed
        self._crowd, self._rng = crowd, np.random.default_rng(seed)

    def step(self) -> int:
        if self.engine.outcome != Outcome.RUNNING:
            begin = time.process_time()
            self.engine.reset(draw_crowd_scene(TRAINED_SETUPS[self._scene % 3], self._scene, self._crowd))
            self._scene += 1
            self.building += time.process_time() - begin
        self.engine.step(self._rng.uniform(-1, 1, 2) * [1.0, 0.3])
        return 1
