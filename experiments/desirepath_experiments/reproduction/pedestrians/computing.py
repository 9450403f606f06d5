"""What each task of chapter 4 computes. Which there are: `plan.py`; report and command: `run.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.pedestrians.crowd_evaluation import CrowdTable, crowd_scene_set, evaluate_crowds
from desirepath.learning.pedestrians.crowd_networks import (
    VARIANTS,
    Actor,
    actor_acts,
    actor_from_arrays,
    actor_to_arrays,
)
from desirepath.learning.scene_sets import Purpose
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED, UNSEEN_HOMES
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.tasks import Function, TaskResult
from desirepath_experiments.training.pedestrians.crowd_planners import PLANNERS
from desirepath_experiments.training.pedestrians.crowd_training import CrowdTrainingConfig, train_crowd
from desirepath_experiments.training.pedestrians.imitation import ImitationConfig, imitate

CROWD_HOME = get_setup("crowd_home")

Floats = NDArray[np.float32]
Judge = Callable[..., CrowdTable]


def trained(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """A part of one training."""
    state = needs[0].arrays["state"].tobytes() if needs else None
    training = train_crowd(CrowdTrainingConfig(**params["config"]), until=params["until"], state=state)
    meta = {"history": training.history, "level": training.level, "transitions": training.transitions}
    return TaskResult(meta, {**_prefix(training.actor), "state": np.frombuffer(training.state, dtype=np.uint8)})


def imitated(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """One training by imitation."""
    del needs
    training = imitate(ImitationConfig(**params["config"]))
    return TaskResult({"history": training.history, "bfloat16": training.bfloat16}, _prefix(training.actor))


def _prefix(actor: Actor) -> dict[str, Floats]:
    return {f"actor.{name}": value for name, value in actor_to_arrays(actor).items()}


def actor_of(result: TaskResult) -> dict[str, Floats]:
    """What `actor_to_arrays` made, of a training."""
    return {name[6:]: value for name, value in result.arrays.items() if name.startswith("actor.")}


@lru_cache  # drawn once by each process: a thousand homes take as long as a network's episodes in them
def _reporting_scenes(
    n: int, conditions: CrowdConditions, setups: tuple[str, ...] = TRAINED_SETUPS
) -> tuple[Scene, ...]:
    return tuple(crowd_scene_set(n, conditions, purpose=Purpose.REPORT, seed=0, setups=setups))


def _conditions(params: dict[str, Any]) -> Iterator[tuple[str, tuple[Scene, ...]]]:
    """Names and scenes of everything that is judged: the same for everybody."""
    many, more = params["episodes"], params["episodes_more"]
    yield "published", _reporting_scenes(many, PUBLISHED)
    for speed in params["speeds"]:
        yield f"speed {speed:g}", _reporting_scenes(more, CrowdConditions((2, 2), (1, 1), (speed, speed)))
    for number in params["numbers"]:
        yield f"number {number}", _reporting_scenes(more, CrowdConditions((number, number), (1, 1), (0.6, 0.6)))
    yield "homes", _reporting_scenes(many, UNSEEN_HOMES, (CROWD_HOME.name,))
    for behaviour in ("orca", "social_force"):
        yield behaviour, _reporting_scenes(more, CrowdConditions((2, 2), (1, 1), (0.6, 0.6), behaviour))


def _judged(params: dict[str, Any], judge: Judge) -> TaskResult:
    meta: dict[str, Any] = {}
    social: dict[str, dict[str, float]] = {}
    arrays = {}
    for name, scenes in _conditions(params):
        table = judge(scenes)
        meta[name], arrays[name.replace(" ", "_")] = table.rates(), table.outcome
        if name in params["social"]:
            social[name] = table.means()
        if name == "published" and params.get("robustness"):
            meta["no_icp"], meta["no_walls"] = judge(scenes, icp=False).rates(), judge(scenes, walls=False).rates()
    return TaskResult({"rates": meta, "social": social}, arrays)


def judged(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """A trained policy on the reporting scenes; ours also without ICP and in the open."""
    import torch

    torch.set_num_threads(1)
    given = VARIANTS[params["variant"]].given
    act = actor_acts(actor_from_arrays(params["variant"], actor_of(needs[0])))
    return _judged(params, lambda scenes, **more: evaluate_crowds(act, given, scenes, **more))


def planned(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """A planner on the same scenes."""
    del needs
    plan = PLANNERS[params["planner"]]
    return _judged(params, lambda scenes, **more: evaluate_crowds(None, "ranges", scenes, plan=plan, **more))


FUNCTIONS: dict[str, Function] = {"imitated": imitated, "trained": trained, "judged": judged, "planned": planned}
