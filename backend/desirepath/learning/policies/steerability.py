"""How far preference weights move a policy, objective by objective: against the base policy, and of what is possible.

What an objective is lives in `objectives.py`, what takes weights in `conditioned.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import NOTHING, interval, mean_estimate, resample_means, wilson
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.crowd_measures import CrowdRecord
from desirepath.learning.preferences.measures import CLEARANCE_CAP_M, in_order, measures, near_person_m, table_of
from desirepath.learning.preferences.objectives import OBJECTIVES, best_possible, gains, names_of, objectives_of
from desirepath.simulation.acting import begin
from desirepath.simulation.fast import FastEngine, make_engine
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup, require_same
from desirepath.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredRollouts:
    """One policy in n scenes. outcome (n,): Outcome; measured (n, 7): vocabulary's; self_intersections (n,)."""

    outcome: NDArray[np.int8]
    measured: Doubles
    self_intersections: NDArray[np.int32]

    @classmethod
    def of(cls, trajectories: Sequence[Trajectory]) -> MeasuredRollouts:
        return cls(
            np.array([t.outcome for t in trajectories], dtype=np.int8),
            measures(trajectories),
            np.array([t.self_intersections for t in trajectories], dtype=np.int32),
        )

    @property
    def success(self) -> NDArray[np.bool_]:
        return np.asarray(self.outcome == Outcome.SUCCESS)


class Course:
    """Scenes that one policy after another is rolled out in, each once to its end: checked and set up only once."""

    def __init__(self, scenes: Sequence[Scene], *, blind: bool = False) -> None:
        """blind: the engine casts a single lidar beam, for who steers by poses. Raises SetupError for scenes of several
        setups, ValueError for none."""
        if not scenes:
            raise ValueError("scenes: none given; a course needs at least one")
        self.setup = require_same(**{f"scene {k}": scene.setup for k, scene in enumerate(scenes)})
        setup = get_setup(self.setup)
        if blind:
            one_beam = replace(setup.robot.lidar, beams=1, sectors=1, field_of_view_rad=2 * math.pi)
            setup = replace(setup, robot=replace(setup.robot, lidar=one_beam))
        self._engine = make_engine(setup, len(scenes), auto_reset=False, scenes=scenes)
        self.scenes = list(scenes)
        self._starts = self._engine.poses.copy()
        self._people = np.array([(scene.person.pose.x, scene.person.pose.y) for scene in scenes])

    def rollout(self, policy: Policy) -> MeasuredRollouts:
        """What `MeasuredRollouts.of` would say of the trajectories, which nobody keeps here. Raises SetupError."""
        require_same(policy=policy.setup, scenes=self.setup)
        steer = begin(policy.rollout_policy, len(self._starts))
        return self.steered(lambda engine, running: steer(engine.observations[running], running))

    def steered(
        self, steer: Callable[[FastEngine, NDArray[np.int64]], NDArray[np.float32]], most: int | None = None
    ) -> MeasuredRollouts:
        """The same of whoever acts: (engine, which robots still run) -> their actions (n, 2). most: steps after which
        those that still run are given up (RUNNING); None: the setup's."""
        engine, n = self._engine, len(self._starts)
        engine.start_at(self._starts)
        actions = np.zeros((n, 2), dtype=np.float32)
        most = min(most or engine.setup.max_steps, engine.setup.max_steps)
        distances, speeds = np.full((most, n), np.inf), np.zeros((most, n))  # by step
        nearest, side = engine.human_distance.copy(), self._bearing(np.arange(n))
        crowd = CrowdRecord(engine.setup, most, n) if engine.setup.pedestrians else None
        step = 0
        while step < most and not engine.dones.all():
            running = np.flatnonzero(~engine.dones)
            actions[running] = steer(engine, running)
            before = engine.poses[running, :2]
            engine.step(actions)
            moved = engine.poses[running, :2] - before
            speeds[step, running] = np.hypot(moved[:, 0], moved[:, 1]) / CONTROL_DT_S
            distances[step, running] = engine.human_distance[running]
            if crowd is not None:
                crowd.note(step, running, engine.next_observations[running], speeds[step, running])
            nearer = running[engine.human_distance[running] < nearest[running]]
            nearest[nearer], side[nearer] = engine.human_distance[nearer], self._bearing(nearer)
            step += 1
        near = distances[:step] <= near_person_m(distances[:step].min(0))
        columns = {
            "min_human_distance_m": engine.min_human_distance,
            "passing_side": np.sin(side),
            "min_clearance_m": np.minimum(engine.min_clearance, CLEARANCE_CAP_M),
            "path_length_m": engine.path_length,
            "accumulated_angle_rad": engine.accumulated_angle,
            "speed_near_person_m_s": (speeds[:step] * near).sum(0) / near.sum(0),
            "time_s": engine.steps * CONTROL_DT_S,
        } | (crowd.columns() if crowd else {})
        measured = in_order(columns, table_of(self.setup))
        return MeasuredRollouts(engine.outcomes.copy(), measured, engine.self_intersections.copy())

    def _bearing(self, which: NDArray[np.int64]) -> Doubles:
        """Where the person is from these robots (rad, of any turn)."""
        poses = self._engine.poses[which]
        offsets = self._people[which] - poses[:, :2]
        return np.arctan2(offsets[:, 1], offsets[:, 0]) - poses[:, 2]


def measure_rollouts(policy: Policy, scenes: Sequence[Scene]) -> MeasuredRollouts:
    """Roll out in every scene once to its end. Raises SetupError."""
    return Course(scenes).rollout(policy)


@dataclass(frozen=True)
class Steerability:
    """Policies by what they were conditioned on (objectives, `neutral`, mixtures) and the base policy, in the same
    scenes.

    Written results keep the keys of the first release (`told`: rollouts of conditioned policies).
    setup: whose objectives and measures these are.
    """

    base: MeasuredRollouts
    conditioned: dict[str, MeasuredRollouts]
    possible: Doubles
    setup: str = "study_room"

    @cached_property
    def shares(self) -> dict[str, float]:
        """For each objective that a policy was conditioned on alone: share of the way from the base policy to what is
        possible.

        Ratio of means over the scenes in which both policies succeed; NaN where there are none.
        """
        columns = {name: self._columns(name) for name in names_of(self.setup) if name in self.conditioned}
        return {name: float(_share(c.mean(0))) if len(c) else math.nan for name, c in columns.items()}

    def _columns(self, name: str) -> Doubles:
        """(both succeed, 3): base's, the conditioned policy's and the best value that the measure can have."""
        k = names_of(self.setup).index(name)
        measure = OBJECTIVES[k].measure
        both = self.base.success & self.conditioned[name].success
        return np.stack(
            [self.base.measured[both, measure], self.conditioned[name].measured[both, measure], self.possible[both, k]],
            axis=1,
        )

    @cached_property
    def score(self) -> float:
        """Mean share of the way, less failures and self-intersections: what a checkpoint is chosen by.

        A failure rate of 1 % weighs as much as 4 % of the way, another 2 % where it falls below the worst allowed (97 %
        success); a self-intersection in every tenth episode as much as 10 %.
        """
        success = np.array([trajectories.success.mean() for trajectories in self.conditioned.values()])
        crossings = np.array([trajectories.self_intersections.mean() for trajectories in self.conditioned.values()])
        shares = np.array(list(self.shares.values()))
        return float(
            np.clip(np.nan_to_num(shares, nan=-1.0), -1, 1).mean()
            - 4 * (1 - success.mean())
            - 2 * max(0.0, 0.97 - float(success.min()))
            - np.minimum(crossings, 1.0).mean()
        )

    def summary(self) -> dict[str, float]:
        """A few numbers for a progress line: score, success, self-intersections, shares of the way."""
        success = [float(trajectories.success.mean()) for trajectories in self.conditioned.values()]
        return {
            "score": self.score,
            "mean_success_rate": float(np.mean(success)),
            "worst_success_rate": min(success),
            "self_intersections": float(np.mean([d.self_intersections.mean() for d in self.conditioned.values()])),
            **{f"share_{name}": share for name, share in self.shares.items()},
        }

    def report(self) -> dict[str, Any]:
        """Everything for a card: per policy its rates and measures, per objective what it moved, with intervals."""
        return {
            "scenes": len(self.possible),
            "base": _described(self.base, self.setup),
            "told": {name: _described(trajectories, self.setup) for name, trajectories in self.conditioned.items()},
            "moved": {name: self.moved(name) for name in self.shares},
        }

    def moved(self, name: str) -> dict[str, Any]:
        """What telling this objective changed: its measure, paired gains and the share of the way, with intervals."""
        k = names_of(self.setup).index(name)
        columns = self._columns(name)
        estimated = interval(self.shares[name], _share(resample_means(columns))) if len(columns) else NOTHING
        against = {"base": self.base} | (
            {"neutral": self.conditioned["neutral"]} if "neutral" in self.conditioned else {}
        )
        better = {}
        for who, trajectories in against.items():
            both = trajectories.success & self.conditioned[name].success
            gained = gains(self.conditioned[name].measured[both] - trajectories.measured[both])[:, k]
            better[f"better_than_{who}"] = mean_estimate(gained).as_dict() | {"both_succeed": int(both.sum())}
        return {
            "measure": objectives_of(self.setup)[k].measured_by,
            "base": float(columns[:, 0].mean()),
            "told": float(columns[:, 1].mean()),
            "best_possible": float(columns[:, 2].mean()),
            **better,
            "share_of_the_way": estimated.as_dict(),
        }


def _share(means: Doubles) -> Doubles:
    """Share of the way, of means (..., 3) of the base's, the conditioned policy's and the best possible value."""
    share: Doubles = (means[..., 1] - means[..., 0]) / (means[..., 2] - means[..., 0])
    return share


def _described(trajectories: MeasuredRollouts, setup: str) -> dict[str, Any]:
    n = len(trajectories.outcome)
    counts = {name: int((trajectories.outcome == which).sum()) for name, which in _OUTCOMES.items()}
    reached = trajectories.measured[trajectories.success]
    return {
        **{f"{name}_rate": wilson(count, n).as_dict() for name, count in counts.items()},
        "self_intersections": mean_estimate(trajectories.self_intersections).as_dict(),
        "measures_where_successful": {
            measure.name: float(value) for measure, value in zip(table_of(setup), reached.mean(0), strict=True)
        },
    }


_OUTCOMES = {"success": Outcome.SUCCESS, "collision": Outcome.COLLISION, "timeout": Outcome.TIMEOUT}


def steerability_of(conditioned: Mapping[str, Policy], base: Policy, scenes: Sequence[Scene]) -> Steerability:
    """Roll out all policies in the same scenes."""
    course = Course(scenes)
    return Steerability(
        course.rollout(base),
        {name: course.rollout(policy) for name, policy in conditioned.items()},
        best_possible(scenes),
        base.setup,
    )
