"""The fast engine's face on the engine of crowds: robots among pedestrians under the same names as everywhere else.

`make_engine` makes one of a setup with pedestrians. How people and robots move, collide and are
scanned is `crowd_engine.py`'s; here is what a policy of a setup observes of it, and its core reward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.crowds.crowd_engine import CrowdEngine, record
from desirepath.simulation.crowds.crowd_kernels import nearest_wall
from desirepath.simulation.fast import FastEngine, Floats, StartPool
from desirepath.simulation.scene import Pose, Scene, SceneError
from desirepath.simulation.scenes import row_to_scene, scenes_to_rows
from desirepath.simulation.setups import Setup
from desirepath.simulation.trajectory import Outcome

Doubles = NDArray[np.float64]
FAR_M = 20.0  # where a place for a pedestrian is observed that nobody takes


class PeopledEngine(FastEngine):
    """`FastEngine` for a setup with pedestrians; human distances are those to the nearest one's centre.

    With a path (chapter 4) the reward is equation 4.1, else the setup's core reward; jerk is not charged. parallel
    changes nothing.
    """

    def __init__(
        self,
        setup: Setup,
        n_envs: int,
        *,
        seed: int = 0,
        auto_reset: bool = True,
        progress_weight: float = 0.0,
        parallel: bool = False,
        scenes: Sequence[Scene] | None = None,
        pool: StartPool | None = None,
    ) -> None:
        del parallel
        if n_envs < 1:
            raise ValueError(f"n_envs = {n_envs}: must be at least 1")
        self.setup, self.n_envs, self.auto_reset, self._progress = setup, n_envs, auto_reset, progress_weight
        self._given_pool, self._seed = pool, seed
        self._scenes = list(scenes) if scenes is not None else None
        self._crowd = CrowdEngine(setup, n_envs=n_envs)
        self._seeds = np.zeros(n_envs, dtype=np.int64)
        size = setup.observation_size
        self.observations = np.zeros((n_envs, size), dtype=np.float32)
        self.next_observations = np.zeros((n_envs, size), dtype=np.float32)
        self.rewards, self.dones = np.zeros(n_envs, np.float32), np.zeros(n_envs, np.bool_)
        self.outcomes, self.steps = np.zeros(n_envs, np.int8), np.zeros(n_envs, np.int32)
        self.self_intersections = np.zeros(n_envs, np.int32)
        self.human_distance, self.obstacle_clearance = np.zeros(n_envs, np.float32), np.zeros(n_envs, np.float32)
        self.min_human_distance, self.min_clearance = np.zeros(n_envs, np.float32), np.zeros(n_envs, np.float32)
        self.path_length, self.accumulated_angle = np.zeros(n_envs, np.float32), np.zeros(n_envs, np.float32)
        self._paths = np.zeros((n_envs, setup.max_steps + 1, 2))
        self._taken = np.zeros(n_envs, np.int64)  # steps of the episode that runs, after a restart 0
        self._goals = np.zeros((n_envs, 2))
        self._now = np.zeros((2, n_envs), np.float32)  # distances to the nearest person and wall where the robots are
        self._walked: list[list[tuple[Doubles, Doubles]]] = [[] for _ in range(n_envs)]
        self.poses = self._crowd.world.robots
        self.reset()

    def reset(self, scenes: Sequence[Scene] | None = None) -> Floats:
        """As `FastEngine.reset`."""
        scenes = self._scenes if scenes is None else list(scenes)
        everyone = np.arange(self.n_envs)
        if scenes is None:
            self._start_from_pool(everyone)
        else:
            self._check(scenes)
            self._seeds[:] = [scene.seed for scene in scenes]
            self._start_in(everyone, scenes)
        return self._begin()

    def start_at(self, poses: Doubles) -> Floats:
        """As `FastEngine.start_at`: everybody else begins anew, too."""
        if poses.shape != (self.n_envs, 3):
            raise ValueError(f"poses have shape {poses.shape}, must be ({self.n_envs}, 3)")
        started = [replace(self.scene(i), start=Pose(*map(float, pose))) for i, pose in enumerate(poses)]
        self._start_in(np.arange(self.n_envs), started)
        return self._begin()

    def _start_from_pool(self, which: NDArray[np.int64]) -> None:
        rows, self._seeds[which] = self._pool.take(len(which))
        found = [row_to_scene(self.setup, int(self._seeds[i]), row) for i, row in zip(which, rows, strict=True)]
        self._start_in(which, found)

    def _start_in(self, which: NDArray[np.int64], scenes: Sequence[Scene]) -> None:
        self._crowd.place(which, scenes)
        self._taken[which] = 0
        self._goals[which] = [(scene.goal.x, scene.goal.y) for scene in scenes]
        self._paths[which, 0] = self.poses[which, :2]
        for i in which:
            self._walked[i] = []
        self._note_walks(which)
        self._now[:, which] = self._apart(which), self._clearance(which)
        self.observations[which] = self._observed(which, np.zeros((len(which), 2)))

    def _begin(self) -> Floats:
        self.dones[:], self.outcomes[:], self.rewards[:], self.steps[:] = False, Outcome.RUNNING, 0.0, 0
        self.path_length[:] = self.accumulated_angle[:] = 0.0
        self.self_intersections[:] = 0
        self.next_observations[:] = self.observations
        self.human_distance[:] = self.min_human_distance[:] = self._now[0]
        self.obstacle_clearance[:] = self.min_clearance[:] = self._now[1]
        return self.observations

    def step(self, actions: Floats) -> None:
        """As `FastEngine.step`."""
        world = self._crowd.world
        which = np.flatnonzero(~world.finished)
        before, (apart, clear) = self.poses[which].copy(), self._now[:, which].copy()
        self._crowd.step(actions)
        self.rewards[:] = 0.0
        if not len(which):
            return
        here, first = self.poses[which], self._taken[which] == 0
        self._taken[which] += 1
        taken = self._taken[which]
        self.steps[which] = taken
        self._paths[which, taken] = here[:, :2]
        self.outcomes[which], self.dones[which] = self._crowd.outcomes[which], world.finished[which]
        human, clearance = self._now[:, which] = self._apart(which), self._clearance(which)
        moved = np.linalg.norm(here[:, :2] - before[:, :2], axis=1)
        turned = np.abs((here[:, 2] - before[:, 2] + math.pi) % (2 * math.pi) - math.pi)
        crossed = self._crossed(which, taken)
        # the episode's own values begin anew with its first step: until then they tell of the episode before
        for kept, start, now in ((self.min_human_distance, apart, human), (self.min_clearance, clear, clearance)):
            kept[which] = np.minimum(np.where(first, start, kept[which]), now)
        for total, more in ((self.path_length, moved), (self.accumulated_angle, turned)):
            total[which] = np.where(first, 0, total[which]) + more
        self.self_intersections[which] = np.where(first, 0, self.self_intersections[which]) + crossed
        self.human_distance[which], self.obstacle_clearance[which] = human, clearance
        goals = self._goals[which]
        nearer = np.linalg.norm(goals - before[:, :2], axis=1) - np.linalg.norm(goals - here[:, :2], axis=1)
        self.rewards[which] = self._progress * nearer + self._earned(which, crossed)
        limits = self.setup.robot.limits
        commands = np.clip(np.asarray(actions, np.float64)[which], -1, 1)
        commands[:, 0] = ((commands[:, 0] + 1) / 2 * (limits.v_max - limits.v_min) + limits.v_min) / limits.v_max
        self.next_observations[which] = self._observed(which, commands)
        self.observations[which] = self.next_observations[which]
        self._note_walks(which)
        if self.auto_reset and self.dones.any():
            self._start_from_pool(np.flatnonzero(self.dones))

    def _earned(self, which: NDArray[np.int64], crossed: NDArray[np.bool_]) -> Doubles:
        """(n,) reward of the step without progress."""
        core = self.setup.reward
        if self.setup.path_points:
            return np.asarray(self._crowd.rewards[which] + core.self_intersection * crossed)
        by_outcome = np.array([0.0, core.goal, core.collision, core.timeout])
        return np.asarray(by_outcome[self.outcomes[which]] + core.time_per_step + core.self_intersection * crossed)

    def _crossed(self, which: NDArray[np.int64], taken: NDArray[np.int64]) -> NDArray[np.bool_]:
        longest, age = self._crowd.longest_step_m, self.setup.self_intersection_min_age_steps
        pairs = zip(which, taken, strict=True)
        return np.array([k.crosses_itself(self._paths[i], int(n), age, longest) for i, n in pairs], dtype=np.bool_)

    def _offsets(self, which: NDArray[np.int64]) -> Doubles:
        """(n, P, 2) m to everybody, in the world's frame; infinite where there is nobody."""
        world = self._crowd.world
        offsets = world.people_xy[which] - self.poses[which, None, :2]
        offsets[np.arange(offsets.shape[1]) >= world.people[which, None]] = np.inf
        return np.asarray(offsets)

    def _apart(self, which: NDArray[np.int64]) -> Floats:
        """(n,) m from centre to centre to the nearest pedestrian."""
        offsets = self._offsets(which)
        return np.asarray(np.hypot(offsets[..., 0], offsets[..., 1]).min(axis=1), dtype=np.float32)

    def _clearance(self, which: NDArray[np.int64]) -> Floats:
        """(n,) m from the robot's surface to the nearest wall or obstacle."""
        return np.array(
            [nearest_wall(self._crowd.world, int(i)) - self.setup.robot.radius_m for i in which], dtype=np.float32
        )

    def _observed(self, which: NDArray[np.int64], commands: Doubles) -> Floats:
        """(n, observation) as the setup's layout says. commands: (n, 2) of full speed and of the fastest turn."""
        setup, yaw = self.setup, self.poses[which, 2]
        c, s = np.cos(yaw), np.sin(yaw)

        def turned(offsets: Doubles) -> Doubles:
            x, y = offsets[..., 0], offsets[..., 1]
            shape = (-1,) + (1,) * (x.ndim - 1)
            cos, sin = c.reshape(shape), s.reshape(shape)
            return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)

        def polar(places: Doubles) -> list[Doubles]:
            away = np.hypot(places[:, 0], places[:, 1])
            return [away / setup.distance_scale_m, np.arctan2(places[:, 1], places[:, 0]) / math.pi]

        columns = polar(turned(self._goals[which] - self.poses[which, :2]))
        if setup.with_person or setup.pedestrians:
            offsets = self._offsets(which)
            nearest = np.argsort(np.hypot(offsets[..., 0], offsets[..., 1]), axis=1)[:, : max(1, setup.pedestrians)]
            nobody = ~np.isfinite(np.take_along_axis(offsets[..., 0], nearest, axis=1))
            places = turned(np.take_along_axis(np.nan_to_num(offsets, posinf=FAR_M), nearest[..., None], axis=1))
            places[nobody] = (FAR_M, 0.0)
            motion = turned(np.take_along_axis(self._crowd.world.people_v[which], nearest[..., None], axis=1))
            motion[nobody] = 0.0
            for rank in range(nearest.shape[1]):
                columns += polar(places[:, rank])
                if setup.pedestrians:
                    columns += [motion[:, rank, 0], motion[:, rank, 1]]
        if setup.path_points:
            columns += list(self._crowd.path_points[which].reshape(len(which), -1).T / setup.distance_scale_m)
        if setup.with_velocity:
            columns += list(commands.T)
        ranges = self._crowd.ranges[which] / setup.robot.lidar.range_m
        return np.concatenate([np.stack(columns, axis=1), np.clip(ranges, 0.0, 1.0)], axis=1).astype(np.float32)

    def _note_walks(self, which: NDArray[np.int64]) -> None:
        """Where people are who avoid others: their rollouts keep it, since no route tells."""
        world = self._crowd.world
        for i in which[self._crowd.reactive[which]]:
            self._walked[i].append((world.people_xy[i].copy(), world.facing[i].copy()))

    def shown(self, i: int, scene: Scene) -> Scene:
        """`scene` as environment i ran in it: with where its people really were, if they avoid others."""
        if not self._walked[i]:
            return scene
        people, facing = (np.array(part) for part in zip(*self._walked[i], strict=True))
        return record(scene, people, facing)

    @property
    def crowd(self) -> CrowdEngine:
        """The engine behind it, for who has sensors of its own."""
        return self._crowd

    @property
    def rows(self) -> k.Rows:
        """(n, columns) the scenes that the robots are in now, without their pedestrians."""
        return scenes_to_rows([self.scene(i) for i in range(self.n_envs)])

    def scene(self, i: int) -> Scene:
        """The scene that environment i is in now."""
        scene = self._crowd.scenes[i]
        if scene is None:
            raise SceneError("scene", i, "has not begun")
        return scene

    def path(self, i: int) -> Doubles:
        """(steps + 1, 2) positions of environment i since its start, metres."""
        return self._paths[i, : self._taken[i] + 1].copy()
