"""Rollouts among pedestrians and their rates, on scene sets that are kept apart by purpose.

How a policy was trained lives in `crowd_training.py`, planners that need no training in `crowd_planners.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.learning.pedestrians.crowd_states import Given, states
from backend.learning.scene_sets import Purpose, first_seed
from backend.simulation.crowds.crowd_engine import CrowdEngine, recorded
from backend.simulation.crowds.crowd_scenes import CrowdConditions, draw_crowd_scene
from backend.simulation.crowds.crowd_setups import TRAINED_SETUPS
from backend.simulation.scene import Scene
from backend.simulation.setups import CONTROL_DT_S
from backend.simulation.trajectory import Outcome

Floats = NDArray[np.float32]
CrowdAct = Callable[[Floats], Floats]
"""(n, states) -> (n, 2) in [-1, 1]."""
CrowdPlan = Callable[[CrowdEngine], Floats]
"""A planner reads what it needs of the engine itself."""
AT_ONCE = 250


@dataclass(frozen=True)
class CrowdTable:
    """Of n episodes: outcome (n,) `Outcome`, time_s (n,), nearest_m (n,) least distance to a pedestrian."""

    outcome: NDArray[np.int8]
    time_s: NDArray[np.float64]
    nearest_m: NDArray[np.float64]

    def rates(self) -> dict[str, float]:
        """success, collision, timeout in %; time_s: mean of successful episodes, NaN without any."""
        success = self.outcome == Outcome.SUCCESS
        return {
            "success": 100 * float(success.mean()),
            "collision": 100 * float((self.outcome == Outcome.COLLISION).mean()),
            "timeout": 100 * float((self.outcome == Outcome.TIMEOUT).mean()),
            "time_s": float(self.time_s[success].mean()) if success.any() else float("nan"),
        }


def crowd_scene_set(
    n: int, conditions: CrowdConditions, *, purpose: Purpose, seed: int, setups: Sequence[str] = TRAINED_SETUPS
) -> list[Scene]:
    """The n scenes of that purpose and seed, the setups in turn."""
    start = first_seed(purpose, seed)
    return [draw_crowd_scene(setups[k % len(setups)], start + k, conditions) for k in range(n)]


def selection_scenes(n: int, most: int, seed: int) -> list[Scene]:
    """Where checkpoints are chosen and the curriculum rises: 1 to `most` who move."""
    return crowd_scene_set(n, CrowdConditions(moving=(1, most)), purpose=Purpose.SELECT, seed=seed)


def evaluate_crowds(
    act: CrowdAct | None,
    given: Given,
    scenes: Sequence[Scene],
    *,
    plan: CrowdPlan | None = None,
    icp: bool = True,
    walls: bool = True,
) -> CrowdTable:
    """Every scene once. act: a policy of states `given`; plan: a planner instead. walls: False is the open space."""
    outcomes, times, nearest = [], [], []
    for first in range(0, len(scenes), AT_ONCE):
        some = scenes[first : first + AT_ONCE]
        engine = CrowdEngine(n_envs=len(some), icp=icp, walls=walls)
        engine.reset(some)
        least = engine.nearest_person_m.copy()
        while not engine.dones.all():
            engine.step(act(states(engine, given)) if act is not None else _planned(plan, engine))
            least = np.minimum(least, engine.nearest_person_m)
        outcomes.append(engine.outcomes.copy())
        times.append(engine.steps * CONTROL_DT_S)
        nearest.append(least)
    return CrowdTable(np.concatenate(outcomes), np.concatenate(times), np.concatenate(nearest))


def _planned(plan: CrowdPlan | None, engine: CrowdEngine) -> Floats:
    if plan is None:
        raise ValueError("evaluate_crowds needs a policy or a planner")
    return plan(engine)


@dataclass(frozen=True)
class CrowdRollout:
    """One episode, for looking at. scene: with where its pedestrians were. poses (T + 1, 3); states (T, size)."""

    scene: Scene
    outcome: Outcome
    poses: NDArray[np.float64]
    states: Floats
    actions: Floats


def roll_out_crowd(act: CrowdAct, given: Given, scene: Scene, *, icp: bool = True) -> CrowdRollout:
    """One policy in one scene, everything kept."""
    engine = CrowdEngine(n_envs=1, icp=icp)
    engine.reset([scene])
    people = 1 + (len(scene.crowd.pedestrians) if scene.crowd else 0)
    kept: dict[str, list[Any]] = {name: [] for name in ("poses", "people", "facing", "states", "actions")}

    def note() -> None:
        kept["poses"].append(engine.poses[0].copy())
        kept["people"].append(engine.people_xy[0, :people].copy())
        kept["facing"].append(engine.world.facing[0, :people].copy())

    note()
    while not engine.dones.all():
        state = states(engine, given)
        action = act(state)
        engine.step(action)
        kept["states"].append(state[0])
        kept["actions"].append(action[0])
        note()
    seen = recorded(scene, np.array(kept["people"]), np.array(kept["facing"]))
    return CrowdRollout(
        seen, Outcome(int(engine.outcomes[0])), np.array(kept["poses"]), np.array(kept["states"]),
        np.array(kept["actions"]),
    )  # fmt: skip
