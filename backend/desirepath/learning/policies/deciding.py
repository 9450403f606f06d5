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

from desirepath.deploy.observing import NOBODY
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
from desirepath.simulation.walks import FASTEST_M_S, Walk, WalkError

EVERY_S = 1.0
LONGEST_S = 40.0  # a way that takes longer from here is taken for none
WALKS_M_S = 0.15  # who is slower stands
FORESEEN_S = 8.0  # that somebody goes on as they walk
NOBODY_M = NOBODY[0]
NEXT_GOAL_M = 15.0  # a goal that is farther is looked at so far ahead
MOST_PAST = 300  # steps
STOOD = 10  # steps in which it did nothing: who drives has given up

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

    def choose(self, past: Trajectory, known: Scene, driving: int, *, stands: bool = False) -> int:
        """The place of who drives on. past: what was driven so far, at the end of which the robot is; stands: whoever
        drives has given up."""
        n = len(self.policies)
        acts, limit = self.policies.begin(np.arange(n)), round(LONGEST_S / CONTROL_DT_S)
        ways = roll_on(get_setup(self.setup), acts, n, past, known=known, max_steps=limit)
        return self.best(ways, driving, stands=stands)

    def best(self, ways: Sequence[Trajectory], driving: int, *, stands: bool = False) -> int:
        """By what each would do. Whoever drives goes on unless another is surely better; the base policy does where
        nobody arrives."""
        arrive = arrived(ways)
        arrive[driving] &= not stands
        usual = driving if arrive[driving] else 0
        if not arrive[usual]:
            return int(arrive.argmax()) if arrive.any() else 0
        others = [k for k in range(len(ways)) if arrive[k] and k != usual]
        if not others:
            return usual
        expected = self.gains(ways[usual], [ways[k] for k in others])
        return others[int(expected.argmax())] if expected.max() > 0 else usual


class OnItsWay:
    """One drive: what was driven, what was seen, who drives. Begins where the robot stands; of a long drive the last
    MOST_PAST steps are judged."""

    def __init__(self, chooser: Chooser, goal: tuple[float, float], goal_radius_m: float) -> None:
        self._chooser, self._setup = chooser, get_setup(chooser.setup)
        self._goal, self._goal_radius_m = goal, goal_radius_m
        self._world = KnownWorld()
        self._seen: list[_Seen] = []
        self._actions: list[Floats] = []
        self.steps, self.driving = 0, 0

    def see(self, pose: Pose, ended: Doubles, beams: int, people: Sequence[Told], observation: Floats) -> None:
        """Where the robot is as a step begins, where some of its beams ended there (`KnownWorld.see`), who it is told
        of, and what its policies observe."""
        self._world.see(ended, beams, [(one.x, one.y) for one in people], Person.radius)
        nearest = min(people, key=lambda one: math.hypot(one.x - pose.x, one.y - pose.y), default=None)
        self._seen.append(_Seen(pose, nearest, observation.astype(np.float32)))

    def acted(self, action: Floats) -> None:
        """What was done in this step."""
        self._actions.append(np.clip(action, -1, 1).astype(np.float32))
        self.steps += 1
        if len(self._actions) > MOST_PAST:
            del self._actions[0], self._seen[0]

    def ask(self) -> Callable[[], int]:
        """What decides who drives on, from where it was seen last; it takes its time, and may run beside the drive."""
        world, seen, actions = self._world.copy(), [*self._seen], [*self._actions]

        def decide() -> int:
            known = self._known(world, seen)
            stands = len(actions) >= STOOD and bool((np.array(actions[-STOOD:]) == (-1.0, 0.0)).all())
            self.driving = self._chooser.choose(_past(known, seen, actions), known, self.driving, stands=stands)
            return self.driving

        return decide

    def _known(self, world: KnownWorld, seen: Sequence[_Seen]) -> SeenScene:
        start, here, told = seen[0].pose, seen[-1].pose, seen[-1].person
        if told is None:  # as the policies observe nobody
            told = Told(here.x - NOBODY_M * math.cos(here.yaw), here.y - NOBODY_M * math.sin(here.yaw))
        facing = math.atan2(here.y - told.y, here.x - told.x)  # nobody tells: towards the robot
        walk = _walk(seen)
        at = walk.poses_at([0.0])[0] if walk else (told.x, told.y, facing)
        away = np.subtract(self._goal, (here.x, here.y))
        goal = (here.x, here.y) + away * min(1.0, NEXT_GOAL_M / max(float(np.hypot(*away)), 1e-9))
        places = [here, start, Pose(*map(float, goal)), Pose(told.x, told.y)]
        return SeenScene(
            setup=self._setup.name,
            seed=0,
            start=start,
            goal=places[2],
            goal_radius=self._goal_radius_m,
            person=Person(Pose(*map(float, at))),
            walk=walk,
            seen=world.map_around(places, self._setup.robot.lidar.range_m),
        )


class _Seen(NamedTuple):
    """As a step began. person: the nearest who was told of."""

    pose: Pose
    person: Told | None
    observation: Floats


def _walk(seen: Sequence[_Seen]) -> Walk | None:
    """As the person walked since they were told of without a jump, before that standing, from now on straight on; of
    who stands, none."""
    told = seen[-1].person
    if told is None or math.hypot(told.v_x, told.v_y) <= WALKS_M_S:
        return None
    stretch = [(len(seen) - 1, told)]
    for k in range(len(seen) - 2, -1, -1):
        before, after = seen[k].person, stretch[-1][1]
        if before is None or math.hypot(after.x - before.x, after.y - before.y) > FASTEST_M_S * CONTROL_DT_S:
            break
        stretch.append((k, before))
    stretch.reverse()
    first = [(0, stretch[0][1])] if stretch[0][0] > 0 else []
    ahead = Told(told.x + told.v_x * FORESEEN_S, told.y + told.v_y * FORESEEN_S)
    knots = [*((k * CONTROL_DT_S, one) for k, one in first + stretch)]
    knots.append((knots[-1][0] + FORESEEN_S, ahead))
    times, x, y = zip(*((at, one.x, one.y) for at, one in knots), strict=True)
    try:
        return Walk(times, x, y, (math.atan2(told.v_y, told.v_x),) * len(times))
    except WalkError:  # faster than anybody walks
        return None


def _past(known: Scene, seen: Sequence[_Seen], actions: Sequence[Floats]) -> Trajectory:
    n, observations = len(actions), np.stack([one.observation for one in seen])
    return Trajectory(
        scene=known,
        outcome=Outcome.RUNNING,
        poses=np.array([(one.pose.x, one.pose.y, one.pose.yaw) for one in seen], dtype=np.float32),
        observations=observations[:n],
        actions=np.array(actions, dtype=np.float32).reshape(n, 2),
        rewards=np.zeros(n, dtype=np.float32),
        next_observations=observations[1:],
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
                told = [Told(x, y, (x - x_then) / CONTROL_DT_S, (y - y_then) / CONTROL_DT_S)]
                ranges = raw_ranges(setup, replace(scenes[i], person=Person(Pose(x, y)), walk=None), pose)
                drive.see(pose, ended_beams(setup, pose, ranges), len(ranges), told, observation)
                if drive.steps % self._every == 0:
                    driving[i] = drive.ask()()
                    self.choices[i].append(int(driving[i]))
            actions = acts(observations, rows)
            for action, i in zip(actions, rows, strict=True):
                drives[i].acted(action)
            return actions

        return act
