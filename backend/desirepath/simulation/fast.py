"""The fast engine: thousands of kinematic robots in their scenes, stepped together by compiled code.

Here live the batch of environments and what is made with it (trajectories, tables of episodes). The arithmetic lives
in `kernels.py`, the Gymnasium and Stable-Baselines3 faces in `environments.py`, rigid bodies in `reference.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, TypedDict, Unpack, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.acting import ActFunction, ActionError, EpisodicPolicy, begin
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import (
    ScenePool,
    check_scene,
    columns_of,
    ground_of,
    map_of,
    own_map,
    row_to_scene,
    scene_to_row,
    scenes_to_rows,
)
from desirepath.simulation.setups import CONTROL_DT_S, SETUPS, Setup, get_setup, require_same
from desirepath.simulation.social_metrics import SocialMetrics, social_metrics
from desirepath.simulation.trajectory import Outcome, Trajectory

Floats = NDArray[np.float32]


def rules_of(setup: Setup, progress_weight: float = 0.0) -> k.Rules:
    """The setup's numbers for the compiled step; `progress_weight` is reward per metre of progress (training only)."""
    return k.Rules(
        dt=CONTROL_DT_S,
        robot_radius=setup.robot.radius_m,
        v_min=setup.robot.limits.v_min,
        v_max=setup.robot.limits.v_max,
        w_max=setup.robot.limits.w_max,
        max_steps=setup.max_steps,
        loop_age=setup.self_intersection_min_age_steps,
        distance_scale=setup.distance_scale_m,
        with_velocity=setup.with_velocity,
        goal=setup.reward.goal,
        collision=setup.reward.collision,
        timeout=setup.reward.timeout,
        self_intersection=setup.reward.self_intersection,
        time_per_step=setup.reward.time_per_step,
        jerk_weight=setup.reward.jerk_weight,
        progress_weight=progress_weight,
        solids=setup.solids,
        with_person=setup.with_person,
        near=setup.near.reward if setup.near else 0.0,
        near_m=setup.near.within_m if setup.near else 0.0,
        v_change=(setup.robot.limits.v_change or math.inf) * CONTROL_DT_S,
        w_change=(setup.robot.limits.w_change or math.inf) * CONTROL_DT_S,
    )


def beams_of(setup: Setup, *, pooled: bool = True) -> k.Beams:
    """The setup's lidar for the compiled scan; unpooled, every beam is a sector of its own."""
    lidar = setup.robot.lidar
    whole = lidar.beams_of_a_turn
    angles = np.arange(3 * whole) * (2 * math.pi / whole)
    return k.Beams(
        number=whole,
        sectors=lidar.sectors_of_a_turn if pooled else whole,
        range_m=lidar.range_m,
        directions=np.stack([np.cos(angles), np.sin(angles)], axis=1),
        seen=lidar.sectors if pooled else lidar.beams,
        x=lidar.x_m,
        y=lidar.y_m,
        yaw=lidar.yaw_rad,
    )


def errors_of(setup: Setup) -> k.Errors | None:
    """What the setup's lidar gets wrong; None of one that gets nothing wrong."""
    lidar = setup.robot.lidar
    if lidar.exact:
        return None
    beams = beams_of(setup, pooled=False)
    return k.Errors(beams, lidar.noise_m, lidar.drop_out, lidar.min_range_m, lidar.steps_per_scan)


def outline_of(setup: Setup) -> NDArray[np.float64] | None:
    """(corners, 2) of a robot that is a polygon, metres in its frame; None of a round one."""
    return None if setup.robot.footprint is None else np.array(setup.robot.footprint, dtype=np.float64)


def clearance_m(scene: Scene, poses: NDArray[np.floating[Any]]) -> float:
    """The smallest distance (m) from the robot's body to a box, a wall or what a map has, along poses (n, 3); infinite
    in an empty field."""
    setup, row, ground = get_setup(scene.setup), scene_to_row(scene), ground_of(scene)
    along = np.ascontiguousarray(poses, dtype=np.float64)
    outline = outline_of(setup)
    if outline is not None:
        return float(k.poses_surface_gap(row, along, outline, ground))
    return float(k.path_surface_distance(row, along[:, :2].copy(), ground)) - setup.robot.radius_m


def raw_ranges(setup: Setup, scene: Scene, pose: Pose) -> NDArray[np.float64]:
    """Every lidar beam from that pose, without errors: (beams,) metres, in the order of `Lidar.bearings`."""
    beams = beams_of(setup, pooled=False)
    return k.seen_ranges(scene_to_row(scene), pose.x, pose.y, pose.yaw, beams, ground_of(scene))


class StartPool(Protocol):
    """Where episodes begin that start by themselves."""

    def take(self, count: int) -> tuple[k.Rows, NDArray[np.int64]]:
        """The next scenes: rows (count, columns) and their seeds (count,)."""
        ...


@runtime_checkable
class WalkingStartPool(StartPool, Protocol):
    """A pool of episodes in which people walk."""

    def take_walking(self, count: int) -> tuple[k.Rows, NDArray[np.int64], NDArray[np.float64]]:
        """As `take`, and where each person is after every step: (count, max_steps + 1, 3), NaN for who stands."""
        ...


class EngineOptions(TypedDict, total=False):
    """What an engine may be told besides its setup and how many robots; defaults and meaning: `FastEngine`."""

    seed: int
    auto_reset: bool
    progress_weight: float
    parallel: bool
    scenes: Sequence[Scene] | None
    pool: StartPool | None


def make_engine(setup: Setup, n_envs: int, **options: Unpack[EngineOptions]) -> FastEngine:
    """The fast engine of a setup; where there are pedestrians, the one that moves them."""
    if not setup.crowded:
        return FastEngine(setup, n_envs, **options)
    from desirepath.simulation.crowds.peopled_engine import PeopledEngine  # which is a FastEngine

    return PeopledEngine(setup, n_envs, **options)


class FastEngine:
    """`n_envs` robots of one setup, each in its own scene.

    After `step(actions)` these arrays (updated in place; copy what must last) tell, for every environment:
    observations (n, obs) float32: what to act on next, after an automatic restart that of the new episode;
    next_observations (n, obs) float32: the true successor, before any restart;
    rewards (n,) float32: core reward + progress_weight * metres of progress towards the goal;
    dones (n,) bool, outcomes (n,) int8 (Outcome): whether and how the episode ended with this step;
    human_distance, obstacle_clearance (n,) float32, metres, after the step: centre to centre to the person; robot
    surface to the nearest box or wall (infinite in an empty field);
    poses (n, 3) float64: x, y, yaw, after an automatic restart the new start;
    steps, min_human_distance, min_clearance, path_length, accumulated_angle, self_intersections (n,): of the episode
    that the step belonged to, so final values where `dones`; minima are over the poses of the control steps.

    auto_reset: ended environments start a fresh scene of the pool (default: `ScenePool` of setup and seed); without,
    they stand still, their reward 0 and their arrays unchanged. parallel: all of Numba's threads instead of one
    (equal up to rounding).
    Same seed, scenes and actions give bit-identical results on one machine.

    `make_engine` makes it, and of a setup with pedestrians a `crowds.peopled_engine.PeopledEngine`: the same arrays,
    people who walk.
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
        if n_envs < 1:
            raise ValueError(f"n_envs = {n_envs}: must be at least 1")
        if setup.crowded:
            raise ValueError(f"setup {setup.name} has pedestrians: `make_engine` makes the engine that moves them")
        self.setup, self.n_envs, self.auto_reset = setup, n_envs, auto_reset
        self._rules, self._beams = rules_of(setup, progress_weight), beams_of(setup)
        here = own_map(scenes[0], setup) if scenes else map_of(setup)
        self._ground, self._outline, self._errors = here.ground if here else None, outline_of(setup), errors_of(setup)
        self._step_all = k.step_all_parallel if parallel else k.step_all
        self._given_pool, self._seed = pool, seed
        self._scenes = list(scenes) if scenes is not None else None
        self._given: list[Scene | None] = [None] * n_envs
        self._seeds = np.zeros(n_envs, dtype=np.int64)
        self._walking = np.zeros(n_envs, dtype=np.bool_)
        self._walks = np.zeros((n_envs, 0, 3))
        size = setup.observation_size
        self.observations = np.zeros((n_envs, size), dtype=np.float32)
        self._results = r = k.Results(
            next_observations=np.zeros((n_envs, size), dtype=np.float32),
            rewards=np.zeros(n_envs, dtype=np.float32),
            dones=np.zeros(n_envs, dtype=np.bool_),
            outcomes=np.zeros(n_envs, dtype=np.int8),
            human_distance=np.zeros(n_envs, dtype=np.float32),
            obstacle_clearance=np.zeros(n_envs, dtype=np.float32),
            steps=np.zeros(n_envs, dtype=np.int32),
            min_human_distance=np.zeros(n_envs, dtype=np.float32),
            min_clearance=np.zeros(n_envs, dtype=np.float32),
            path_length=np.zeros(n_envs, dtype=np.float32),
            accumulated_angle=np.zeros(n_envs, dtype=np.float32),
            self_intersections=np.zeros(n_envs, dtype=np.int32),
        )
        self.next_observations, self.rewards, self.dones, self.outcomes = r[:4]
        self.human_distance, self.obstacle_clearance, self.steps = r[4:7]
        self.min_human_distance, self.min_clearance, self.path_length, self.accumulated_angle = r[7:11]
        self.self_intersections = r[11]
        self._state = self._fresh_state(columns_of(setup))
        self.poses = self._state.poses
        self.reset()

    def _fresh_state(self, columns: int) -> k.State:
        n = self.n_envs
        return k.State(
            rows=np.zeros((n, columns)),
            poses=np.zeros((n, 3)),
            paths=np.zeros((n, self.setup.max_steps + 1, 2)),
            steps=np.zeros(n, dtype=np.int32),
            finished=np.zeros(n, dtype=np.bool_),
            commands=np.zeros((n, 2, 2)),
            largest_jerk=np.zeros(n),
            obstacle_clearance=np.zeros(n),
            human_distance=np.zeros(n),
        )

    def reset(self, scenes: Sequence[Scene] | None = None) -> Floats:
        """Start every environment: in `scenes`, else in the scenes given at construction, else in fresh ones.

        Returns `observations`. Raises SceneError for a bad scene, SetupError for one of another setup.
        """
        scenes = self._scenes if scenes is None else list(scenes)
        everyone = np.arange(self.n_envs)
        if scenes is None:
            self._start_from_pool(everyone)
        else:
            self._check(scenes)
            rows = scenes_to_rows(scenes)
            if rows.shape[1] > self._state.rows.shape[1]:
                self._state = self._state._replace(rows=np.zeros_like(rows))
            self._given[:] = scenes
            self._people_walk(scenes)
            self._start(everyone, rows)
        return self._begin()

    def _check(self, scenes: Sequence[Scene]) -> None:
        """Raise ValueError unless there is one for every environment, SceneError or SetupError as `reset` says."""
        if len(scenes) != self.n_envs:
            raise ValueError(f"scenes: {len(scenes)} given for {self.n_envs} environments")
        known = SETUPS.get(self.setup.name)  # asked for once: looking for a setup asks the disk
        for scene in {id(scene): scene for scene in scenes}.values():
            require_same(engine=self.setup.name, scene=scene.setup)
            check_scene(scene, known)

    def start_at(self, poses: NDArray[np.float64]) -> Floats:
        """Start every environment anew in the scene it is in, from its own pose (n_envs, 3): x, y (m), yaw (rad).

        For whoever chose free places: unlike `reset`, nothing is checked. Returns `observations`.
        """
        if poses.shape != (self.n_envs, 3):
            raise ValueError(f"poses have shape {poses.shape}, must be ({self.n_envs}, 3)")
        self._given[:] = [replace(self.scene(i), start=Pose(*map(float, pose))) for i, pose in enumerate(poses)]
        rows = self._state.rows
        rows[:, k.START_X], rows[:, k.START_Y], rows[:, k.START_YAW] = poses.T
        self._start(np.arange(self.n_envs), rows)
        return self._begin()

    def _begin(self) -> Floats:
        """What the arrays say before the first step. Returns `observations`."""
        self.dones[:] = False
        self.outcomes[:] = Outcome.RUNNING
        self.rewards[:] = 0.0
        self.steps[:] = 0
        self.path_length[:] = self.accumulated_angle[:] = 0.0
        self.self_intersections[:] = 0
        self.next_observations[:] = self.observations
        self.human_distance[:] = self.min_human_distance[:] = self._state.human_distance
        self.obstacle_clearance[:] = self.min_clearance[:] = self._state.obstacle_clearance
        return self.observations

    def _people_walk(self, scenes: Sequence[Scene]) -> None:
        """Note where walking people are after every control step."""
        self._walking[:] = [scene.walk is not None for scene in scenes]
        if self._walking.any():
            times = np.arange(self.setup.max_steps + 1) * CONTROL_DT_S
            self._walks = np.stack([scene.person_poses(times) for scene in scenes])

    def _advance_people(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Walking people take their next step before the robots do: (which, distances before it (n_envs,) m).

        Who walks into a robot that drives has collided with it.
        """
        state = self._state
        apart = state.human_distance.copy()
        which = np.flatnonzero(self._walking & ~state.finished)
        if len(which):
            people = self._walks[which, state.steps[which] + 1]
            state.rows[which, k.PERSON_X : k.PERSON_YAW + 1] = people
            state.human_distance[which] = np.linalg.norm(people[:, :2] - state.poses[which, :2], axis=1)
        return which, apart

    def reseed(self, seed: int) -> None:
        """Draw all further scenes from a new pool of that seed; episodes that are running go on."""
        self._given_pool, self._seed = None, seed
        self.__dict__.pop("_pool", None)

    @cached_property
    def _pool(self) -> StartPool:
        """Made when it is needed: whoever gives scenes needs none."""
        return self._given_pool if self._given_pool is not None else ScenePool(self.setup, self._seed)

    def _start_from_pool(self, which: NDArray[np.int64]) -> None:
        for i in which:
            self._given[i] = None
        if isinstance(self._pool, WalkingStartPool):
            rows, self._seeds[which], walks = self._pool.take_walking(len(which))
            self._walking[which] = ~np.isnan(walks[:, 0, 0])
            if self._walks.shape[1] != self.setup.max_steps + 1:
                self._walks = np.zeros((self.n_envs, self.setup.max_steps + 1, 3))
            self._walks[which] = walks
        else:
            rows, self._seeds[which] = self._pool.take(len(which))
            self._walking[which] = False
        self._start(which, rows)

    def _start(self, which: NDArray[np.int64], rows: k.Rows) -> None:
        self._state.rows[which, : rows.shape[1]] = rows
        walking = which[self._walking[which]]
        if len(walking):
            self._state.rows[walking, k.PERSON_X : k.PERSON_YAW + 1] = self._walks[walking, 0]
        given = self._rules, self._beams, self._ground, self._outline, self._errors
        k.start_episodes(which, self._state, self.observations, *given)

    def step(self, actions: Floats) -> None:
        """One control step (0.2 s) of every environment with `actions` (n, 2) in [-1, 1], clipped.

        actions[:, 0] maps to [v_min, v_max], actions[:, 1] to [-w_max, w_max]. Raises ActionError for a wrong shape
        or numbers that are not finite.
        """
        actions = np.ascontiguousarray(actions, dtype=np.float32)
        if actions.shape != (self.n_envs, 2):
            raise ActionError(f"actions have shape {actions.shape}, must be ({self.n_envs}, 2)")
        if not np.isfinite(actions).all():
            worst = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise ActionError(f"actions[{worst}] = {actions[worst].tolist()}: must be finite, in [-1, 1]")
        walking, apart = self._advance_people()
        if self._errors is not None:  # a scan that is not new is the one that was seen
            self.next_observations[:] = self.observations
        given = self._rules, self._beams, self._ground, self._outline, self._errors
        self._step_all(self._state, self._results, actions, *given)
        first = walking[self.steps[walking] == 1]
        self.min_human_distance[first] = np.minimum(apart[first], self.human_distance[first])
        self.observations[:] = self.next_observations
        if self.auto_reset and self.dones.any():
            self._start_from_pool(np.flatnonzero(self.dones))

    @property
    def seeds(self) -> NDArray[np.int64]:
        """(n,) what the pool called the scenes that the robots are in now."""
        return self._seeds

    @property
    def rows(self) -> k.Rows:
        """(n, columns) the scenes that the robots are in now, as `scene_to_row` writes them."""
        return self._state.rows

    def scene(self, i: int) -> Scene:
        """The scene that environment i is in now."""
        given = self._given[i]
        return given if given is not None else row_to_scene(self.setup, int(self._seeds[i]), self._state.rows[i])

    def shown(self, i: int, scene: Scene) -> Scene:
        """The scene that environment i ran in, as its trajectory keeps it."""
        return scene

    def path(self, i: int) -> NDArray[np.float64]:
        """(steps + 1, 2) positions of environment i since its start, metres."""
        return self._state.paths[i, : self._state.steps[i] + 1].copy()


def rollout(
    setup: Setup, act: ActFunction | EpisodicPolicy, scenes: Sequence[Scene], *, max_steps: int | None = None
) -> list[Trajectory]:
    """Roll out one policy in every scene once: one full trajectory per scene, in order.

    max_steps: stop earlier than the setup's limit; the outcome of what is cut off is RUNNING.
    """
    limit = setup.max_steps if max_steps is None else min(max_steps, setup.max_steps)

    def steering(engine: FastEngine) -> _Choose:
        steer = begin(act, len(scenes), engine)
        return lambda _, observations, running: steer(observations, running)

    return _roll_out_all(setup, steering, scenes, limit)


def replay(setup: Setup, scenes: Sequence[Scene], actions: Sequence[Floats]) -> list[Trajectory]:
    """Execute given actions, (T, 2) in [-1, 1] per scene: one trajectory per scene, in order.

    Who has not ended with their last action repeats it until the longest series of the call is over.
    """
    longest = min(setup.max_steps, max((len(a) for a in actions), default=0))
    padded = [np.concatenate([a, np.repeat(a[-1:], longest - len(a), axis=0)]) for a in actions]
    together = np.stack(padded) if padded else np.zeros((0, 0, 2), dtype=np.float32)
    return _roll_out_all(setup, lambda _: lambda step, _, running: together[running, step], scenes, longest)


_Choose = Callable[[int, Floats, NDArray[np.int64]], Floats]
"""(step, observations of those running, which those are) -> their actions."""


def _roll_out_all(
    setup: Setup, steering: Callable[[FastEngine], _Choose], scenes: Sequence[Scene], limit: int
) -> list[Trajectory]:
    """One trajectory per scene. steering: how actions are chosen in this engine."""
    if not scenes:
        return []
    engine = make_engine(setup, len(scenes), auto_reset=False, scenes=scenes)
    choose = steering(engine)
    poses = [[pose.copy()] for pose in engine.poses]
    records: list[list[tuple[Floats, Floats, np.float32, Floats, np.bool_]]] = [[] for _ in scenes]
    actions = np.zeros((len(scenes), 2), dtype=np.float32)
    for step in range(limit):
        running = np.flatnonzero(~engine.dones)
        if not len(running):
            break
        before = engine.observations[running]
        actions[running] = np.clip(choose(step, before, running), -1.0, 1.0)
        engine.step(actions)
        rewards, dones = engine.rewards[running], engine.dones[running]
        after, here, taken = engine.next_observations[running], engine.poses[running], actions[running]
        for row, i in enumerate(running):
            poses[i].append(here[row])
            records[i].append((before[row], taken[row], rewards[row], after[row], dones[row]))
    return [
        Trajectory(
            scene=engine.shown(i, scene),
            outcome=Outcome(int(engine.outcomes[i])),
            poses=np.asarray(poses[i], dtype=np.float32),
            observations=np.asarray([r[0] for r in records[i]], dtype=np.float32).reshape(-1, setup.observation_size),
            actions=np.asarray([r[1] for r in records[i]], dtype=np.float32).reshape(-1, 2),
            rewards=np.asarray([r[2] for r in records[i]], dtype=np.float32),
            next_observations=np.asarray([r[3] for r in records[i]], dtype=np.float32).reshape(
                -1, setup.observation_size
            ),
            dones=np.asarray([r[4] for r in records[i]], dtype=np.bool_),
            self_intersections=int(engine.self_intersections[i]),
            dt=CONTROL_DT_S,
        )
        for i, scene in enumerate(scenes)
    ]


@dataclass(frozen=True)
class EpisodeTable:
    """One row per episode, each array (episodes,), in the order of the scenes. SI units.

    outcome: int8 (Outcome). min_human_distance: centre to centre; min_clearance: robot surface to the nearest box or
    wall, without the person. accumulated_angle: sum of absolute heading changes. path_area: between the path and the
    straight line from start to goal. total_reward: undiscounted core reward. straight_distance: start to goal.
    ceiling: the largest minimum human distance that any policy can reach in the scene. social: of the same episodes.
    """

    outcome: NDArray[np.int8]
    steps: NDArray[np.int32]
    path_length: Floats
    min_human_distance: Floats
    min_clearance: Floats
    self_intersections: NDArray[np.int32]
    accumulated_angle: Floats
    path_area: Floats
    total_reward: Floats
    straight_distance: Floats
    ceiling: Floats
    social: SocialMetrics
    dt: float = CONTROL_DT_S

    @property
    def success(self) -> NDArray[np.bool_]:
        return np.asarray(self.outcome == Outcome.SUCCESS)

    @property
    def time(self) -> Floats:
        """Seconds from start to end."""
        return (self.steps * self.dt).astype(np.float32)

    def __len__(self) -> int:
        return len(self.outcome)


EPISODE_COLUMNS = tuple(name for name in EpisodeTable.__dataclass_fields__ if name not in ("social", "dt"))
"""Names of its arrays."""


def evaluate(
    act: ActFunction | EpisodicPolicy,
    setup: Setup,
    scenes: Sequence[Scene],
    make: Callable[..., FastEngine] = make_engine,
) -> EpisodeTable:
    """Roll out in every scene once to its end and keep the numbers, not the trajectories. make: the engine."""
    if not scenes:
        raise ValueError("scenes: none given; evaluation needs at least one")
    engine = make(setup, len(scenes), auto_reset=False, scenes=scenes)
    actions = np.zeros((len(scenes), 2), dtype=np.float32)
    total = np.zeros(len(scenes), dtype=np.float64)
    steer = begin(act, len(scenes), engine)
    while not engine.dones.all():
        running = np.flatnonzero(~engine.dones)
        actions[running] = steer(engine.observations[running], running)
        engine.step(actions)
        total += engine.rewards
    paths = [engine.path(i) for i in range(len(scenes))]
    outcome, length, turned = engine.outcomes.copy(), engine.path_length.copy(), engine.accumulated_angle.copy()
    return EpisodeTable(
        outcome=outcome,
        steps=engine.steps.copy(),
        path_length=length,
        min_human_distance=engine.min_human_distance.copy(),
        min_clearance=engine.min_clearance.copy(),
        self_intersections=engine.self_intersections.copy(),
        accumulated_angle=turned,
        path_area=np.array(
            [k.path_area(path, scene.goal.x, scene.goal.y) for path, scene in zip(paths, scenes, strict=True)],
            dtype=np.float32,
        ),
        total_reward=total.astype(np.float32),
        straight_distance=np.array(
            [math.dist((s.start.x, s.start.y), (s.goal.x, s.goal.y)) for s in scenes], dtype=np.float32
        ),
        ceiling=np.array([s.human_distance_ceiling_m() for s in scenes], dtype=np.float32),
        social=social_metrics(
            paths,
            [engine.shown(i, scene) for i, scene in enumerate(scenes)],
            success=outcome == Outcome.SUCCESS,
            path_length=length,
            accumulated_angle=turned,
            dt=CONTROL_DT_S,
        ),
    )


def table_of(trajectories: Sequence[Trajectory]) -> EpisodeTable:
    """The table that `evaluate` would have made of these trajectories. Raises ValueError for none."""
    if not trajectories:
        raise ValueError("trajectories: none given")
    columns: dict[str, list[float]] = {name: [] for name in EPISODE_COLUMNS}
    for trajectory in trajectories:
        scene = trajectory.scene
        path = np.ascontiguousarray(trajectory.poses[:, :2], dtype=np.float64)
        turns = np.diff(trajectory.poses[:, 2].astype(np.float64))
        people = scene.people_at(trajectory.times)
        for name, value in {
            "outcome": trajectory.outcome,
            "steps": len(trajectory.actions),
            "path_length": np.linalg.norm(np.diff(path, axis=0), axis=1).sum(),
            "min_human_distance": np.linalg.norm(path - people, axis=2).min(),
            "min_clearance": clearance_m(scene, trajectory.poses),
            "self_intersections": trajectory.self_intersections,
            "accumulated_angle": np.abs((turns + np.pi) % (2 * np.pi) - np.pi).sum(),
            "path_area": k.path_area(path, scene.goal.x, scene.goal.y),
            "total_reward": trajectory.rewards.sum(),
            "straight_distance": math.dist((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y)),
            "ceiling": scene.human_distance_ceiling_m(),
        }.items():
            columns[name].append(float(value))
    whole = {"outcome": np.int8, "steps": np.int32, "self_intersections": np.int32}
    arrays: dict[str, Any] = {name: np.asarray(c, dtype=whole.get(name, np.float32)) for name, c in columns.items()}
    dt = trajectories[0].dt
    social = social_metrics(
        [one.poses[:, :2].astype(np.float64) for one in trajectories],
        [one.scene for one in trajectories],
        success=arrays["outcome"] == Outcome.SUCCESS,
        path_length=arrays["path_length"],
        accumulated_angle=arrays["accumulated_angle"],
        dt=dt,
    )
    return EpisodeTable(**arrays, social=social, dt=dt)
