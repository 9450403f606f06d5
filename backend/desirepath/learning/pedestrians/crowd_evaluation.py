"""Rollouts among pedestrians and their rates, on scene sets that are kept apart by purpose.

How a policy is trained, and planners that need no training, are the laboratory's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.metrics import accumulated_angle, min_human_distance, path_length
from desirepath.learning.pedestrians.crowd_states import Given, states
from desirepath.learning.scene_sets import Purpose, first_seed
from desirepath.simulation.crowds.crowd_engine import CrowdEngine, record
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath.simulation.social_metrics import SocialMetrics, social_metrics
from desirepath.simulation.trajectory import Outcome

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
CrowdAct = Callable[[Floats], Floats]
"""(n, states) -> (n, 2) in [-1, 1]."""
CrowdPlan = Callable[[CrowdEngine], Floats]
"""A planner reads what it needs of the engine itself."""
AT_ONCE = 250


@dataclass(frozen=True)
class CrowdTable:
    """Of n episodes: outcome (n,) `Outcome`, time_s (n,), min_human_distance_m (n,) between centres, of whoever comes
    nearest; social: of the same episodes."""

    outcome: NDArray[np.int8]
    time_s: NDArray[np.float64]
    min_human_distance_m: NDArray[np.float64]
    social: SocialMetrics

    def rates(self) -> dict[str, float]:
        """success, collision, timeout in %; time_s: mean of successful episodes, NaN without any."""
        success = self.outcome == Outcome.SUCCESS
        return {
            "success": 100 * float(success.mean()),
            "collision": 100 * float((self.outcome == Outcome.COLLISION).mean()),
            "timeout": 100 * float((self.outcome == Outcome.TIMEOUT).mean()),
            "time_s": float(self.time_s[success].mean()) if success.any() else float("nan"),
        }

    def means(self) -> dict[str, float]:
        """Of the distance and the social metrics, over all episodes."""
        columns = {"min_human_distance_m": self.min_human_distance_m, **self.social.columns()}
        return {name: float(values.mean()) for name, values in columns.items()}


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
    outcomes: list[NDArray[np.int8]] = []
    poses: list[Doubles] = []
    people: list[Doubles] = []
    for first in range(0, len(scenes), AT_ONCE):
        some = scenes[first : first + AT_ONCE]
        engine = CrowdEngine(n_envs=len(some), icp=icp, walls=walls)
        engine.reset(some)
        robots, everybody = [engine.poses.copy()], [engine.people_xy.copy()]
        while not engine.dones.all():
            engine.step(act(states(engine, given)) if act is not None else _plan(plan, engine))
            robots.append(engine.poses.copy())
            everybody.append(engine.people_xy.copy())
        outcomes.append(engine.outcomes.copy())
        robot_poses, people_xy = np.stack(robots, axis=1), np.stack(everybody, axis=2)
        for i, steps in enumerate(engine.steps):
            poses.append(robot_poses[i, : steps + 1])
            people.append(people_xy[i, : engine.world.people[i], : steps + 1])
    return _table(scenes, np.concatenate(outcomes), poses, people)


def _table(
    scenes: Sequence[Scene], outcome: NDArray[np.int8], poses: Sequence[Doubles], people: Sequence[Doubles]
) -> CrowdTable:
    """poses: (steps + 1, 3) of the robot in each scene; people: (people, steps + 1, 2)."""
    return CrowdTable(
        outcome,
        np.array([(len(path) - 1) * CONTROL_DT_S for path in poses]),
        np.array([min_human_distance(path[None], who).min() for path, who in zip(poses, people, strict=True)]),
        social_metrics(
            [path[:, :2] for path in poses],
            scenes,
            success=outcome == Outcome.SUCCESS,
            path_length=np.array([path_length(path[None])[0] for path in poses]),
            accumulated_angle=np.array([accumulated_angle(path[None])[0] for path in poses]),
            dt=CONTROL_DT_S,
            people=people,
        ),
    )


def _plan(plan: CrowdPlan | None, engine: CrowdEngine) -> Floats:
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


def roll_out_crowd(act: CrowdAct, given: Given, scene: Scene) -> CrowdRollout:
    """One policy in one scene, everything kept."""
    engine = CrowdEngine(n_envs=1)
    engine.reset([scene])
    people = 1 + (len(scene.crowd.pedestrians) if scene.crowd else 0)
    recorded: dict[str, list[Any]] = {name: [] for name in ("poses", "people", "facing", "states", "actions")}

    def note() -> None:
        recorded["poses"].append(engine.poses[0].copy())
        recorded["people"].append(engine.people_xy[0, :people].copy())
        recorded["facing"].append(engine.world.facing[0, :people].copy())

    note()
    while not engine.dones.all():
        state = states(engine, given)
        action = act(state)
        engine.step(action)
        recorded["states"].append(state[0])
        recorded["actions"].append(action[0])
        note()
    seen = record(scene, np.array(recorded["people"]), np.array(recorded["facing"]))
    return CrowdRollout(
        seen, Outcome(int(engine.outcomes[0])), np.array(recorded["poses"]), np.array(recorded["states"]),
        np.array(recorded["actions"]),
    )  # fmt: skip
