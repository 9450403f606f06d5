"""How fast the two engines step, in one run: `desirepath benchmark simulate`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.simulation.fast import make_engine
from desirepath.simulation.reference import SUBSTEPS, DriveMode, ReferenceEngine
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setups import Setup, get_setup
from desirepath_experiments.benchmarks.results import Progress

ROUNDS = 5
WARM_UP_CALLS = 40  # compile, fill caches


@dataclass(frozen=True)
class SimulateConfig:
    """Where the engines step, and for how long in all."""

    setup: Annotated[str, Field(description="Any setup that PyBullet has, too.")] = "open_field"
    n_envs: Annotated[int, Field(ge=1, description="Environments of the fast engine.")] = 256
    seconds: Annotated[float, Field(gt=0, description="Of processor time, over all engines.")] = 18.0
    seed: int = 0


def _random_actions(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    """Any speed, turning at most 0.3 of the limit, so that the robots get somewhere and meet things."""
    return np.asarray(rng.uniform(-1, 1, (count, 2)) * [1.0, 0.3], dtype=np.float32)


def fast_stepper(setup: Setup, n_envs: int, seed: int) -> Callable[[], int]:
    """A function that steps all environments of a fast engine once, under random actions, and returns their number."""
    engine, rng = make_engine(setup, n_envs, seed=seed), np.random.default_rng(seed)
    actions = itertools.cycle([_random_actions(rng, n_envs) for _ in range(64)])

    def step() -> int:
        engine.step(next(actions))
        return n_envs

    for _ in range(WARM_UP_CALLS):
        step()
    return step


def steps_in(seconds: float, step: Callable[[], int]) -> tuple[int, float]:
    """Call `step` (returns the steps it made) for about that long: (steps, processor seconds)."""
    steps, begin = 0, time.process_time()
    while (spent := time.process_time() - begin) < seconds:
        steps += step()
    return steps, spent


class _Reference:
    """PyBullet under random actions, in a new scene whenever an episode has ended."""

    def __init__(self, setup: Setup, drive_mode: DriveMode, seed: int) -> None:
        self._setup, self._rng, self._scene = setup, np.random.default_rng(seed), 0
        self.engine = ReferenceEngine(setup, drive_mode=drive_mode)
        self.building = 0.0  # processor seconds spent on building scenes, not on stepping

    def step(self) -> int:
        if self.engine.done:
            begin = time.process_time()
            self.engine.reset(draw_scene(self._setup, self._scene))
            self._scene += 1
            self.building += time.process_time() - begin
        self.engine.step(_random_actions(self._rng, 1)[0])
        return 1


def benchmark_simulate(config: SimulateConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Steps per second of the fast engine and of PyBullet on the same kind of work, one thread each, in one run.

    All run the same setup with the same lidar, observation, collision and self-intersection checks and reward under
    random actions, in turns. Seconds are processor time of this process, which on an idle machine is wall-clock time
    and on a busy one charges nobody for others' work. The fast engine's time includes its restarts in fresh scenes;
    building PyBullet's scenes is not counted. PyBullet: rayTestBatch with numThreads=1, 48 physics steps per control
    step. `pybullet_steps_per_s` and `ratio` are of the wheeled robot on its floor, the drive mode one would train in;
    the `_velocity_mode` pair is of a body without floor, motors or contact forces.
    """
    chosen, seed = get_setup(config.setup), config.seed
    modes: tuple[DriveMode, ...] = ("wheels", "velocity")
    references = {mode: _Reference(chosen, mode, seed) for mode in modes}
    contestants = {"fast": fast_stepper(chosen, config.n_envs, seed)} | {
        mode: reference.step for mode, reference in references.items()
    }
    steps, spent = dict.fromkeys(contestants, 0), dict.fromkeys(contestants, 0.0)
    for reference in references.values():
        for _ in range(WARM_UP_CALLS):
            reference.step()
        reference.building = 0.0
    for _ in range(ROUNDS):
        for who, step in contestants.items():
            steps_made, took = steps_in(config.seconds / ROUNDS / len(contestants), step)
            steps[who], spent[who] = steps[who] + steps_made, spent[who] + took
    for mode, reference in references.items():
        spent[mode] -= reference.building
        reference.engine.close()
    rate = {who: steps[who] / spent[who] for who in contestants}
    return {
        "fast_steps_per_s": rate["fast"],
        "pybullet_steps_per_s": rate["wheels"],
        "ratio": rate["fast"] / rate["wheels"],
        "pybullet_steps_per_s_velocity_mode": rate["velocity"],
        "ratio_velocity_mode": rate["fast"] / rate["velocity"],
        "setup": chosen.name,
        "lidar_beams": chosen.robot.lidar.beams,
        "fast_environments": config.n_envs,
        "pybullet_drive_mode": "wheels",
        "pybullet_substeps": SUBSTEPS,
        "pybullet_ray_threads": 1,
        "threads": 1,
        "seconds_are": "processor time",
        "fast_steps": steps["fast"],
        "pybullet_steps": steps["wheels"],
        "seed": seed,
    }
