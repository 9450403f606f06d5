"""Choosing again while it drives: from where the robot is, every policy goes on in what it knows of the place, and the
one drives on whose whole way its person is expected to like most.

What it knows: where its lidar's beams have ended, its goal, where the person is and how they move, whom it takes to
walk on like that. The same on a robot as in the engine (`DecidesAgain`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.policies.policy import Floats
from desirepath.learning.policies.side_by_side import SideBySide
from desirepath.simulation.acting import EpisodeActs, Rows, SensingPolicy
from desirepath.simulation.fast import raw_ranges
from desirepath.simulation.known_world import KnownWorld, SeenScene, ended_beams
from desirepath.simulation.resumed import roll_on
from desirepath.simulation.scene import Person, Pose, Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory, arrived
from desirepath.simulation.walks import Walk, WalkError

EVERY_S = 1.0
LONGEST_S = 40.0  # a way that takes longer from here is taken for none
WALKS_M_S = 0.15  # who is slower stands
FORESEEN_S = 8.0  # that somebody goes on as they walk
NOBODY_M = 30.0
"""So far away, behind the robot, is the person whom nobody tells of."""

Gains = Callable[[Trajectory, Sequence[Trajectory]], Doubles]
"""(way that is usual, n others from the same moment on) -> (n,) how much better each is expected to be."""


class Told(NamedTuple):
    """Where the person is, m, and how they move, m/s."""

    x: float
    y: float
    v_x: float = 0.0
    v_y: float = 0.0


@dataclass(frozen=True)
class Chooser:
    """What decides which of several policies drives on; the first is the base policy."""

    setup: str
    policies: SideBySide
    gains: Gains

    def choose(self, past: Trajectory, known: Scene, driving: int) -> int:
        """The place of who drives on. past: what was driven so far, at the end of which the robot is."""
        n = len(self.policies)
        acts, limit = self.policies.begin(np.arange(n)), round(LONGEST_S / CONTROL_DT_S)
        return self.best(roll_on(get_setup(self.setup), acts, n, past, known=known, max_steps=limit), driving)

    def best(self, ways: Sequence[Trajectory], driving: int) -> int:
        """By what each would do. Whoever drives goes on unless another is surely better; the base policy does where
        nobody arrives."""
        arrive = arrived(ways)
        usual = driving if arrive[driving] else 0
        if not arrive[usual]:
            return int(arrive.argmax()) if arrive.any() else 0
        others = [k for k in range(len(ways)) if arrive[k] and k != usual]
        if not others:
            return usual
        expected = self.gains(ways[usual], [ways[k] for k in others])
        return others[int(expected.argmax())] if expected.max() > 0 else usual


class OnItsWay:
    """One drive: what was driven, what was seen, who drives. Begins where the robot stands."""

    def __init__(self, chooser: Chooser, goal: tuple[float, float], goal_radius_m: float) -> None:
        self._chooser, self._setup = chooser, get_setup(chooser.setup)
        self._goal, self._goal_radius_m = Pose(*goal), goal_radius_m
        self._world = KnownWorld()
        self._poses: list[NDArray[np.float32]] = []
        self._people: list[Told] = []
        self._observations: list[Floats] = []
        self._actions: list[Floats] = []
        self.driving = 0

    @property
    def steps(self) -> int:
        return len(self._actions)

    def see(self, pose: Pose, ended: Doubles, person: Told | None, observation: Floats) -> None:
        """Where the robot is as a step begins, what it sees there (`KnownWorld.see`), and what its policies do."""
        if person is None:
            away = self._people[-1] if self._people else None
            person = away or Told(pose.x - NOBODY_M * math.cos(pose.yaw), pose.y - NOBODY_M * math.sin(pose.yaw))
        self._world.see(ended, [(person.x, person.y)], Person.radius)
        self._poses.append(np.array([pose.x, pose.y, pose.yaw], dtype=np.float32))
        self._people.append(person)
        self._observations.append(observation.astype(np.float32))

    def acted(self, action: Floats) -> None:
        """What was done in this step."""
        self._actions.append(np.clip(action, -1, 1).astype(np.float32))

    def ask(self) -> Callable[[], int]:
        """What decides who drives on, from where it was seen last; it takes its time, and may run beside the drive."""
        known = self._known()
        past = self._past(known)

        def decide() -> int:
            self.driving = self._chooser.choose(past, known, self.driving)
            return self.driving

        return decide

    def _known(self) -> SeenScene:
        here, person = Pose(*map(float, self._poses[-1])), self._people[-1]
        start = Pose(*map(float, self._poses[0]))
        walk, first = self._walk(), self._people[0] if math.hypot(person.v_x, person.v_y) > WALKS_M_S else person
        facing = math.atan2(start.y - first.y, start.x - first.x)  # nobody tells: towards the robot
        at = walk.poses_at([0.0])[0] if walk else (person.x, person.y, facing)
        return SeenScene(
            setup=self._setup.name,
            seed=0,
            start=start,
            goal=self._goal,
            goal_radius=self._goal_radius_m,
            person=Person(Pose(*map(float, at))),
            walk=walk,
            seen=self._world.map_around([here, start, self._goal, Pose(person.x, person.y)]),
        )

    def _walk(self) -> Walk | None:
        """As the person walked, then straight on; of who stands, none."""
        told = self._people[-1]
        if math.hypot(told.v_x, told.v_y) <= WALKS_M_S:
            return None
        ahead = Told(told.x + told.v_x * FORESEEN_S, told.y + told.v_y * FORESEEN_S)
        times = [*(k * CONTROL_DT_S for k in range(len(self._people))), self.steps * CONTROL_DT_S + FORESEEN_S]
        every, yaw = [*self._people, ahead], math.atan2(told.v_y, told.v_x)
        try:
            return Walk(tuple(times), tuple(one.x for one in every), tuple(one.y for one in every), (yaw,) * len(every))
        except WalkError:  # whoever was told of jumped: another one, or an error of who tells
            return None

    def _past(self, known: Scene) -> Trajectory:
        n, seen = self.steps, np.stack(self._observations)
        return Trajectory(
            scene=known,
            outcome=Outcome.RUNNING,
            poses=np.stack(self._poses),
            observations=seen[:n],
            actions=np.array(self._actions, dtype=np.float32).reshape(n, 2),
            rewards=np.zeros(n, dtype=np.float32),
            next_observations=seen[1:],
            dones=np.zeros(n, dtype=np.bool_),
            dt=CONTROL_DT_S,
        )


class DecidesAgain(SensingPolicy):
    """Drives in an engine by what a robot would know there, and chooses again every so many seconds. choices: of the
    last call, episode by episode who drove from one decision to the next."""

    def __init__(self, chooser: Chooser, every_s: float = EVERY_S) -> None:
        self._chooser, self._every = chooser, max(1, round(every_s / CONTROL_DT_S))
        self.choices: list[list[int]] = []

    def begin_in(self, engine: Any) -> EpisodeActs:
        n, setup = engine.n_envs, engine.setup
        scenes: list[Scene] = [engine.scene(i) for i in range(n)]
        drives = [OnItsWay(self._chooser, (one.goal.x, one.goal.y), one.goal_radius) for one in scenes]
        driving = np.zeros(n, dtype=np.int64)
        acts = self._chooser.policies.begin(driving)
        self.choices = [[] for _ in range(n)]

        def act(observations: Floats, rows: Rows) -> Floats:
            for observation, i in zip(observations, rows, strict=True):
                drive, pose = drives[i], Pose(*map(float, engine.poses[i]))
                (x, y, _), (x_then, y_then, _) = scenes[i].person_poses(
                    [drive.steps * CONTROL_DT_S, max(drive.steps - 1, 0) * CONTROL_DT_S]
                )
                told = Told(x, y, (x - x_then) / CONTROL_DT_S, (y - y_then) / CONTROL_DT_S)
                ranges = raw_ranges(setup, replace(scenes[i], person=Person(Pose(x, y)), walk=None), pose)
                drive.see(pose, ended_beams(setup, pose, ranges), told, observation)
                if drive.steps % self._every == 0:
                    driving[i] = drive.ask()()
                    self.choices[i].append(int(driving[i]))
            actions = acts(observations, rows)
            for action, i in zip(actions, rows, strict=True):
                drives[i].acted(action)
            return actions

        return act
