"""Time-to-success curves of base training: what its policy attains after every few processor seconds of one core."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, NamedTuple

import pydantic
import torch
from pydantic import Field

from desirepath.analysis.estimates import wilson
from desirepath.analysis.metrics import collision_rate, success_rate
from desirepath.learning.policies.policy import Policy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import BaseConfig, BaseTraining, base_config
from desirepath.simulation.fast import EpisodeTable, evaluate
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.benchmarks.training_arms import CONFIRM_SCENES, CONFIRM_SEEDS


class Target(NamedTuple):
    """A success rate that counts as reached in fresh scenes where its interval begins no lower than `least`."""

    success: float
    least: float = 0.0


TARGETS = {"94": Target(0.94), "99": Target(0.99, 0.985)}
FIRST_FRESH = 30_000  # reporting scenes of no other benchmark


@pydantic.dataclasses.dataclass(frozen=True)
class CurvesConfig:
    """What is trained, and when it is looked at."""

    setup: Annotated[str, Field(description="study_room or open_field.")] = "open_field"
    seeds: Annotated[int, Field(ge=1, description="Number of trainings, seeds from 0 on.")] = 10
    first_seed: Annotated[int, Field(ge=0, description="Of the first training.")] = 0
    every_s: Annotated[float, Field(gt=0, description="Processor seconds of training between two looks.")] = 2.0
    max_seconds: Annotated[float, Field(gt=0, description="Of one training; then it ends without 99 %.")] = 40.0
    look_scenes: Annotated[int, Field(ge=1, description="In which success is looked at.")] = 2_000


@dataclass(frozen=True)
class Point:
    """A look at a training: seconds are processor time of the training alone; success in the scenes of looks."""

    seed: int
    seconds: float
    cloning_updates: int
    updates: int
    transitions: int
    success_rate: float
    collision_rate: float
    path_length_m: float
    confirmed: float | None
    """Success in 2,000 scenes that served nothing before, where a target seemed to be reached."""


def benchmark_curves(
    config: CurvesConfig, progress: Progress | None = None, *, base: BaseConfig | None = None
) -> dict[str, Any]:
    """Success of the averaged weights (no recovery, no rule) after every few processor seconds of one thread.

    `seconds_to_94`, `seconds_to_99`, by seed: until that success was met in the scenes of looks and then confirmed in
    2,000 fresh ones, new at every try; for 99 % the 95 % interval there begins at 98.5 % or above. Null where a seed
    (median: half of them) never got there. Looks are not counted.
    """
    load = [round(value, 2) for value in os.getloadavg()]
    curves: list[Point] = []
    reached: dict[str, list[float | None]] = {name: [] for name in TARGETS}
    for seed in range(config.first_seed, config.first_seed + config.seeds):
        found: dict[str, float] = {}
        for point, names in _curve(replace(base or base_config(config.setup), seed=seed), config):
            curves.append(point)
            found |= dict.fromkeys(names, point.seconds)
            if progress is not None:
                progress.tell(f"seed {seed}: {point.success_rate:.1%} after {point.seconds:.1f} s")
        for name in TARGETS:
            reached[name].append(found.get(name))
    return {
        "setup": config.setup,
        "seeds": config.seeds,
        "first_seed": config.first_seed,
        "seconds_are": "processor time of one thread",
        **{f"seconds_to_{name}": seconds for name, seconds in reached.items()},
        "median": {name: _finite(statistics.median(_all(seconds))) for name, seconds in reached.items()},
        "worst": {name: _finite(max(_all(seconds))) for name, seconds in reached.items()},
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "load_average": {"before": load, "after": [round(value, 2) for value in os.getloadavg()]},
        "scenes": {"look": config.look_scenes, "confirm": CONFIRM_SCENES, "confirm_scenes_are": "new at every try"},
        "curves": [asdict(point) for point in curves],
    }


def _curve(base: BaseConfig, config: CurvesConfig) -> Iterator[tuple[Point, list[str]]]:
    """Each look at one training, with the names of the targets that it confirmed, until all are or time is up."""
    training, seed = BaseTraining(base), base.seed
    looked_at = scene_set(config.setup, config.look_scenes, purpose=Purpose.BENCHMARK, seed=seed)
    left, tries, seconds, next_look = dict(TARGETS), 0, 0.0, config.every_s
    while left and seconds < config.max_seconds:
        began = time.process_time()
        training.vector_step()
        seconds += time.process_time() - began
        if seconds < next_look:
            continue
        next_look = seconds + config.every_s
        policy = training.policy(averaged=True)
        table = evaluate(policy.act, training.setup, looked_at)
        seemed = [name for name, target in left.items() if success_rate(table.outcome) >= target.success]
        confirmed, met = None, []
        if seemed:
            confirmed, low = _in_fresh_scenes(policy, FIRST_FRESH + CONFIRM_SEEDS * seed + tries)
            tries += 1
            met = [name for name in seemed if confirmed >= left[name].success and low >= left[name].least]
        left = {name: target for name, target in left.items() if name not in met}
        yield _point(seed, seconds, training, table, confirmed), met


def _in_fresh_scenes(policy: Policy, seed: int) -> tuple[float, float]:
    """Success there, and where its 95 % interval begins."""
    scenes = scene_set(policy.setup, CONFIRM_SCENES, purpose=Purpose.REPORT, seed=seed)
    success = success_rate(evaluate(policy.act, get_setup(policy.setup), scenes).outcome)
    return success, wilson(round(success * CONFIRM_SCENES), CONFIRM_SCENES).low


def _point(seed: int, seconds: float, training: BaseTraining, table: EpisodeTable, confirmed: float | None) -> Point:
    return Point(
        seed=seed,
        seconds=round(seconds, 2),
        cloning_updates=training.cloning_updates,
        updates=training.agent.updates,
        transitions=training.transitions,
        success_rate=success_rate(table.outcome),
        collision_rate=collision_rate(table.outcome),
        path_length_m=round(float(table.path_length.mean()), 3),
        confirmed=confirmed,
    )


def _all(seconds: list[float | None]) -> list[float]:
    return [float("inf") if value is None else value for value in seconds]


def _finite(value: float) -> float | None:
    return None if value == float("inf") else value
