"""Many robots among pedestrians, stepped together: the fast engine of chapter 4.

Arithmetic lives in the three files of kernels; what networks are given of this is chosen in
`learning/pedestrians/crowd_states.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.acting import ActionError
from desirepath.simulation.crowds import avoidance_kernels as avoid
from desirepath.simulation.crowds import crowd_kernels as k
from desirepath.simulation.crowds import crowd_setups as settings
from desirepath.simulation.crowds.crowd_maps import boxes_of, path_from_anywhere
from desirepath.simulation.crowds.descriptor_kernels import describe_all
from desirepath.simulation.pedestrians import MOST_KNOTS, MOST_PEDESTRIANS, Pedestrian
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.setups import CONTROL_DT_S, Setup, get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath.simulation.walks import Walk

CROWD_CORRIDOR = get_setup("crowd_corridor")

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
GROUPS = 30  # N_c = N_b, section 4.4.3
COARSE_RANGES = 128  # of baseline B2
COARSE_SPACING_M = 1.0
MOST_BOXES = 32
PERSON_RADIUS_M = 0.3  # of the circle around a cuboid, for who avoids
BODY = MOST_PEDESTRIANS + 1  # the scene's person is one more


class ScenesInTurn(Protocol):
    """Where episodes begin that start by themselves."""

    def take(self) -> Scene:
        """The next scene."""
        ...


def crowd_rules(setup: Setup, reward: settings.CrowdReward, noise_m: float) -> k.CrowdRules:
    """The setup's numbers for the compiled step."""
    return k.CrowdRules(
        dt=CONTROL_DT_S,
        radius=setup.robot.radius_m,
        v_min=setup.robot.limits.v_min,
        v_max=setup.robot.limits.v_max,
        w_max=setup.robot.limits.w_max,
        max_steps=setup.max_steps,
        goal_radius=setup.goal_radius_m,
        range_m=setup.robot.lidar.range_m,
        beams=setup.robot.lidar.beams,
        sectors=setup.robot.lidar.sectors,
        noise=noise_m,
        depth=settings.PED_DEPTH_M / 2,
        width=settings.PED_WIDTH_M / 2,
        points=settings.PATH_POINTS,
        spacing=settings.PATH_SPACING_M,
        ahead=settings.GUIDE_AHEAD_M,
        near=settings.PROXIMITY_M,
        collision=reward.collision,
        guide=reward.guide,
        proximity=reward.proximity,
    )


class CrowdEngine:
    """`n_envs` robots, each among the pedestrians of its scene.

    After `step(actions)`, for every environment (updated in place; copy what must last): rewards (n,), dones (n,),
    outcomes (n,) `Outcome`, steps (n,), poses (n, 3) of the robots, people_xy (n, P, 2);
    reactive (n,): whose pedestrians avoid others. What it senses: `ranges`, `points`, `path_points`,
    `descriptors()`. With `pool`, who has ended begins anew at `restart`, not within `step`: what a step ended with can
    be read first.

    icp: whether descriptors are aligned; outline: whether their centroids are of outlines (ours) or points;
    walls: whether walls and obstacles are there at all (the open-space check).
    noise_m: of the lidar. Same seeds, scenes and actions give bit-identical results on one machine.
    """

    def __init__(
        self,
        setup: Setup = CROWD_CORRIDOR,
        *,
        n_envs: int,
        pool: ScenesInTurn | None = None,
        icp: bool = True,
        outline: bool = True,
        walls: bool = True,
        noise_m: float = settings.LIDAR_NOISE_M,
        reward: settings.CrowdReward | None = None,
    ) -> None:
        if n_envs < 1:
            raise ValueError(f"n_envs = {n_envs}: must be at least 1")
        self.setup, self.n_envs, self.pool, self.icp, self.walls = setup, n_envs, pool, icp, walls
        self.outline = outline
        self._rules = crowd_rules(setup, reward or settings.CrowdReward(), noise_m)
        angles = np.arange(self._rules.beams) * (2 * math.pi / self._rules.beams)
        self._directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        n, sectors = n_envs, self._rules.sectors
        self.world = k.World(
            boxes=np.zeros((n, MOST_BOXES, 6)),
            box_count=np.zeros(n, np.int64),
            routes=np.zeros((n, BODY, MOST_KNOTS, 2)),
            knots=np.ones((n, BODY), np.int64),
            speeds=np.zeros((n, BODY)),
            people=np.zeros(n, np.int64),
            paths=np.zeros((n, MOST_KNOTS, 2)),
            path_knots=np.ones(n, np.int64),
            people_xy=np.zeros((n, BODY, 2)),
            people_v=np.zeros((n, BODY, 2)),
            facing=np.zeros((n, BODY, 2)),
            heading_for=np.zeros((n, BODY), np.int64),
            turn=np.ones((n, BODY), np.int64),
            held_up=np.zeros((n, BODY)),
            robots=np.zeros((n, 3)),
            steps=np.zeros(n, np.int64),
            finished=np.ones(n, np.bool_),
            seeds=np.zeros(n, np.int64),
        )
        self.seen = k.Seen(
            ranges=np.zeros((n, sectors)),
            points=np.zeros((n, sectors, 2)),
            path_points=np.zeros((n, self._rules.points, 2)),
            rewards=np.zeros(n),
            outcomes=np.zeros(n, np.int8),
            lidar_min=np.zeros(n),
        )
        self.scenes: list[Scene | None] = [None] * n
        self.reactive, self._forces = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
        self.robot_v = np.zeros((n, 2))
        self.older_points, self.older_ranges = np.zeros((n, sectors, 2)), np.zeros((n, sectors))
        self.oldest_ranges = np.zeros((n, sectors))
        self.dones = np.ones(n, np.bool_)
        if pool is not None:
            self.restart()

    rewards = property(lambda self: self.seen.rewards)
    outcomes = property(lambda self: self.seen.outcomes)
    steps = property(lambda self: self.world.steps)
    poses = property(lambda self: self.world.robots)
    people_xy = property(lambda self: self.world.people_xy)
    ranges = property(lambda self: self.seen.ranges)
    points = property(lambda self: self.seen.points)
    path_points = property(lambda self: self.seen.path_points)
    longest_step_m = property(lambda self: self._rules.v_max * self._rules.dt)

    def reset(self, scenes: Sequence[Scene]) -> None:
        """Start all environments in these scenes. Raises SceneError for one without a crowd, or too large."""
        if len(scenes) != self.n_envs:
            raise ValueError(f"scenes: {len(scenes)} given for {self.n_envs} environments")
        self.place(np.arange(self.n_envs), scenes)

    def place(self, which: NDArray[np.int64], scenes: Sequence[Scene]) -> None:
        """Start these environments in these scenes. Raises SceneError as `reset` does."""
        for i, scene in zip(which, scenes, strict=True):
            self._place(int(i), scene)
        self._begin(which)

    def restart(self) -> NDArray[np.int64]:
        """Whoever has ended starts in the pool's next scenes; returns who did."""
        which = np.flatnonzero(self.world.finished)
        if self.pool is None:
            raise ValueError("an engine without a pool cannot restart; give it scenes by reset")
        for i in which:
            self._place(int(i), self.pool.take())
        self._begin(which)
        return which

    def _place(self, i: int, scene: Scene) -> None:
        if scene.crowd is None:
            raise SceneError("crowd", None, "is missing; scenes with one person run on the fast engine")
        w, boxes, path = self.world, boxes_of(scene), path_from_anywhere(scene)
        if len(boxes) > MOST_BOXES:
            raise SceneError("obstacles", len(boxes), f"at most {MOST_BOXES} walls and obstacles among pedestrians")
        w.box_count[i] = len(boxes) if self.walls else 0
        w.boxes[i, : len(boxes)] = boxes
        w.path_knots[i], w.paths[i, : len(path)] = len(path), path
        person = scene.person.pose
        people = (Pedestrian(((person.x, person.y),), 0.0, person.yaw), *scene.crowd.pedestrians)
        w.people[i] = len(people)
        for p, one in enumerate(people):
            count = len(one.route)
            w.knots[i, p], w.speeds[i, p], w.routes[i, p, :count] = count, one.speed, one.route
            yaw = one.yaw
            if count > 1:
                yaw = math.atan2(one.route[1][1] - one.route[0][1], one.route[1][0] - one.route[0][0])
            w.people_xy[i, p], w.facing[i, p] = one.route[0], (math.cos(yaw), math.sin(yaw))
            w.people_v[i, p] = w.speeds[i, p] * w.facing[i, p]
            w.heading_for[i, p], w.turn[i, p], w.held_up[i, p] = min(1, count - 1), 1, 0.0
        w.robots[i] = scene.start.x, scene.start.y, scene.start.yaw
        w.seeds[i] = scene.seed
        self.reactive[i] = scene.crowd.behaviour != "path"
        self._forces[i] = scene.crowd.behaviour == "social_force"
        self.scenes[i] = scene

    def _begin(self, which: NDArray[np.int64]) -> None:
        k.begin_crowds(which, self.world, self.seen, self._rules, self._directions)
        self.robot_v[which] = 0.0
        self.seen.outcomes[which], self.seen.rewards[which], self.dones[which] = Outcome.RUNNING, 0.0, False
        self.older_points[which], self.older_ranges[which] = self.points[which], self.ranges[which]
        self.oldest_ranges[which] = self.ranges[which]

    def step(self, actions: Floats) -> None:
        """One control step (0.2 s) of every environment that runs, with `actions` (n, 2) in [-1, 1], clipped.

        Raises ActionError for a wrong shape or numbers that are not finite.
        """
        actions = np.ascontiguousarray(actions, dtype=np.float32)
        if actions.shape != (self.n_envs, 2) or not np.isfinite(actions).all():
            raise ActionError(f"actions of shape {actions.shape}: must be ({self.n_envs}, 2), finite, in [-1, 1]")
        running = ~self.world.finished
        self.oldest_ranges[running] = self.older_ranges[running]
        self.older_points[running], self.older_ranges[running] = self.points[running], self.ranges[running]
        before = self.world.robots[:, :2].copy()
        self._choose_velocities(np.flatnonzero(running & self.reactive))
        k.step_crowds(self.world, self.seen, actions, self.reactive, self._rules, self._directions)
        self.robot_v[:] = (self.world.robots[:, :2] - before) / CONTROL_DT_S
        self.dones[:] = self.world.finished

    def _choose_velocities(self, which: NDArray[np.int64]) -> None:
        if not len(which):
            return
        w = self.world
        targets = np.take_along_axis(w.routes, w.heading_for[:, :, None, None], axis=2)[:, :, 0]
        avoid.choose_velocities(
            which, self._forces, w.people_xy, w.people_v, w.people, w.speeds, targets, w.robots, self.robot_v,
            w.boxes, w.box_count, PERSON_RADIUS_M, self.setup.robot.radius_m, avoid.OrcaRules(), avoid.ForceRules(),
        )  # fmt: skip

    def descriptors(self) -> Doubles:
        """(n, 30, 4) group centroids of the last two scans: older x, y, newer x, y, m in the robots' frames now."""
        found = np.zeros((self.n_envs, GROUPS, 4))
        describe_all(
            self.older_points,
            self.points,
            self.older_ranges,
            self.ranges,
            self._rules.range_m,
            self.icp,
            self.outline,
            found,
        )
        return found

    def coarse_ranges(self) -> Doubles:
        """(n, 128) m: baseline B2's scan."""
        found = np.zeros((self.n_envs, COARSE_RANGES))
        k.scan_ranges(self.world, self._rules, self._directions, COARSE_RANGES, found)
        return found

    def coarse_path(self) -> Doubles:
        """(n, 5, 2) m: baseline B2's path points, 1 m apart, in the robots' frames."""
        found = np.zeros((self.n_envs, self._rules.points, 2))
        k.path_points(self.world, COARSE_SPACING_M, found)
        return found

    def path_left_m(self) -> Doubles:
        """(n,) m: how far it still is along the paths."""
        found = np.zeros(self.n_envs)
        k.path_left(self.world, found)
        return found

    def goals(self) -> Doubles:
        """(n, 2) m: the goals in the robots' frames."""
        w = self.world
        ends = w.paths[np.arange(self.n_envs), w.path_knots - 1]
        d, yaw = ends - w.robots[:, :2], w.robots[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        return np.stack([d[:, 0] * c + d[:, 1] * s, d[:, 1] * c - d[:, 0] * s], axis=1)


def record(scene: Scene, people: Doubles, facing: Doubles) -> Scene:
    """The scene with where its pedestrians really were: people, facing (T + 1, P, 2), the person first."""
    if scene.crowd is None or people.shape[1] < 1 + len(scene.crowd.pedestrians) or len(people) < 2:
        return scene
    times = tuple(float(t) for t in np.arange(len(people)) * CONTROL_DT_S)
    yaw = np.unwrap(np.arctan2(facing[:, :, 1], facing[:, :, 0]), axis=0).round(4)
    walked = tuple(
        replace(one, walk=Walk(times, *(tuple(map(float, part)) for part in (*people[:, p].T.round(4), yaw[:, p]))))
        for p, one in enumerate(scene.crowd.pedestrians, start=1)
    )
    return replace(scene, crowd=replace(scene.crowd, pedestrians=walked))
