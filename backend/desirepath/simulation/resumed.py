"""Robots that are on their way: whoever asks what becomes of them goes on from where they are, in what they know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.acting import EpisodeActs
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.known_world import SeenScene
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.setups import CONTROL_DT_S, Setup
from desirepath.simulation.trajectory import Outcome, Trajectory

SPARSE = 4
"""Beams per sector in what a robot believes: its cells are coarser than its beams. A third of the time of 12."""


class ResumedEngine(FastEngine):
    """Robots that have all driven the same past in what they take for their scene, of which nothing is checked. Steps
    and measures of an episode count from here."""

    def __init__(self, setup: Setup, n_envs: int, scene: Scene, past: Trajectory) -> None:
        self._since_s = len(past.actions) * CONTROL_DT_S
        commands, pose = _executed(setup, past), past.poses[-1]
        here = replace(scene, start=Pose(*map(float, pose)))
        if isinstance(scene, SeenScene):
            setup = _sparse(setup)
        super().__init__(setup, n_envs, auto_reset=False, scenes=[here] * n_envs)
        self._state.commands[:] = commands
        if setup.with_velocity:
            limits = setup.robot.limits
            velocity = commands[0] / (limits.v_max, limits.w_max)
            self.observations[:, setup.polar_size - 2 : setup.polar_size] = velocity

    def _people_walk(self, scenes: Sequence[Scene]) -> None:
        self._walking[:] = scenes[0].walk is not None
        if self._walking.any():
            times = self._since_s + np.arange(self.setup.max_steps + 1) * CONTROL_DT_S
            self._walks = np.tile(scenes[0].person_poses(times), (self.n_envs, 1, 1))

    def _check(self, scenes: Sequence[Scene]) -> None:
        """Where it drives is what it believes."""


def _sparse(setup: Setup) -> Setup:
    lidar = setup.robot.lidar
    beams = min(lidar.beams, SPARSE * lidar.sectors)
    return replace(setup, robot=replace(setup.robot, lidar=replace(lidar, beams=beams)))


def roll_on(
    setup: Setup,
    acts: EpisodeActs,
    n: int,
    past: Trajectory,
    *,
    known: Scene | None = None,
    max_steps: int | None = None,
) -> list[Trajectory]:
    """n robots that have all driven the same past: each goes on by its own row of `acts` until it ends, at the latest
    when the setup's time is up from now on, or after max_steps. known: the scene as the robots know it; default: as
    it is.

    Trajectories are whole, with the past, in `known`.
    """
    scene = known or past.scene
    limit = setup.max_steps if max_steps is None else min(max_steps, setup.max_steps)
    engine = ResumedEngine(setup, n, scene, past)
    actions, steps = np.zeros((n, 2), dtype=np.float32), list[tuple[NDArray[Any], ...]]()
    before = engine.observations.copy()
    while len(steps) < limit and not engine.dones.all():
        running = np.flatnonzero(~engine.dones)
        actions[running] = np.clip(acts(before[running], running), -1.0, 1.0)
        engine.step(actions)
        poses = engine.poses.astype(np.float32)
        after = engine.observations.copy()
        steps.append((before, actions.copy(), engine.rewards.copy(), after, engine.dones.copy(), poses))
        before = after
    parts = [np.stack(part, axis=1) for part in zip(*steps, strict=True)]
    trajectories = []
    for i in range(n):
        seen, taken, rewards, after, dones, poses = (part[i, : engine.steps[i]] for part in parts)
        trajectories.append(
            Trajectory(
                scene=scene,
                outcome=Outcome(int(engine.outcomes[i])),
                poses=np.concatenate([past.poses, poses]),
                observations=np.concatenate([past.observations, seen]),
                actions=np.concatenate([past.actions, taken]),
                rewards=np.concatenate([past.rewards, rewards]),
                next_observations=np.concatenate([past.next_observations, after]),
                dones=np.concatenate([past.dones, dones]),
                dt=CONTROL_DT_S,
            )
        )
    return trajectories


def _executed(setup: Setup, past: Trajectory) -> NDArray[np.float64]:
    """(2, 2) forward and angular velocity of the last step and of the one before: as observed where they are, else as
    commanded; 0 before the start."""
    limits, executed = setup.robot.limits, np.zeros((2, 2))
    for back, action in enumerate(past.actions[::-1][:2].astype(np.float64)):
        executed[back] = limits.v_min + (action[0] + 1) / 2 * (limits.v_max - limits.v_min), action[1] * limits.w_max
        if setup.with_velocity:
            observed = past.next_observations[-1 - back, setup.polar_size - 2 : setup.polar_size]
            executed[back] = observed * (limits.v_max, limits.w_max)
    return executed
