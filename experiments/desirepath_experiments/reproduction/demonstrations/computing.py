"""What each task of chapter 2 computes. Which there are: `plan.py`; the numbers made of them: `results.py`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.metrics import collision_rate, measure, success_rate, timeout_rate
from desirepath.demonstrations.controllers import roll_out
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.judging import KINDS, judge_rollouts, speed_profile, unseen_scenes
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath.demonstrations.td3_bc.training import train_with_demonstrations
from desirepath.learning.policies.policy import Policy
from desirepath.learning.scene_sets import Purpose
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.reproduction.tasks import Function, TaskResult, as_bytes


def demonstrations_of(params: Mapping[str, Any]) -> list[Demonstration]:
    """What the programmed demonstrator draws: `per_pair` strokes of each pair, others for another seed."""
    first = params["seed"] * params["per_pair"]
    return [
        demonstrate(params["style"], scene, first + k)
        for scene in demonstration_scenes(params["environment"])
        for k in range(params["per_pair"])
    ]


def config_of(params: Mapping[str, Any]) -> DemonstrationConfig:
    """The configuration a task's JSON names; lists become tuples."""
    changes: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in params["config"].items()}
    return replace(DemonstrationConfig(), **changes)


def controller(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Train; the curve holds the CPU seconds until each checkpoint, its own measuring included."""
    began = time.process_time()
    seconds: list[float] = []

    def note(_: float, metrics: dict[str, float]) -> None:
        if "score" in metrics:
            seconds.append(time.process_time() - began)

    trained = train_with_demonstrations(demonstrations_of(params), config_of(params), note)
    curve = [{**point, "cpu_s": spent} for point, spent in zip(trained.history, seconds, strict=True)]
    content = as_bytes(trained.policy.without_critic().to_bytes())
    return TaskResult({"curve": curve, "chosen": trained.chosen}, {"policy": content})


def _acting(params: Mapping[str, Any], needs: Sequence[TaskResult]) -> str | Policy:
    return Policy.from_bytes(needs[0].content("policy")) if needs else str(params["controller"])


def judged(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Rollouts from every demonstrated start, measured; the demonstrations measured beside them."""
    demonstrations = demonstrations_of(params)
    rollouts = roll_out(_acting(params, needs), [d.scene for d in demonstrations])
    arrays = {**_pick_shown(rollouts, "driven"), **_pick_shown([d.trajectory for d in demonstrations], "demonstrated")}
    return TaskResult({"judged": judge_rollouts(rollouts, demonstrations).as_dict()}, arrays)


def unseen(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Rollouts where nothing was demonstrated, in the reporting scenes of the seed, measured."""
    pairs = demonstration_scenes(params["environment"])
    by_kind: dict[str, Any] = {}
    for kind in KINDS:
        scenes = unseen_scenes(pairs, kind, params["scenes"], purpose=Purpose.REPORT, seed=params["seed"])
        measured = measure(roll_out(_acting(params, needs), scenes))
        by_kind[kind] = {
            "n": len(scenes),
            "success_rate": success_rate(measured.outcome),
            "collision_rate": collision_rate(measured.outcome),
            "timeout_rate": timeout_rate(measured.outcome),
            "min_human_distance_m": float(measured.min_human_distance.mean()),
        }
    return TaskResult({"unseen": by_kind}, {})


def _pick_shown(rollouts: Sequence[Trajectory], name: str) -> dict[str, NDArray[Any]]:
    """What figures need of rollouts: poses padded with NaN, numbers of chapter 2, speed profiles."""
    measured = measure(rollouts)
    poses = np.full((len(rollouts), max(len(t.poses) for t in rollouts), 3), np.nan, dtype=np.float32)
    for row, trajectory in zip(poses, rollouts, strict=True):
        row[: len(trajectory.poses)] = trajectory.poses
    return {
        f"{name}_poses": poses,
        f"{name}_outcome": measured.outcome,
        f"{name}_relative_path_length": measured.relative_path_length,
        f"{name}_min_human_distance": measured.min_human_distance,
        f"{name}_path_area": measured.path_area,
        f"{name}_speeds": np.stack([speed_profile(t) for t in rollouts]),
    }


FUNCTIONS: dict[str, Function] = {"controller": controller, "judged": judged, "unseen": unseen}
