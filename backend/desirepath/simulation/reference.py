"""The reference engine: one robot in one scene as rigid bodies in PyBullet, to check and report against.

Same scenes, observations, rewards and endings as `fast.py`; only motion, rays and contacts come from PyBullet, which
is imported when first needed. Training belongs on the fast engine.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import os
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.acting import ActFunction, ActionError, EpisodicPolicy, begin
from desirepath.simulation.fast import EpisodeTable, Floats, rules_of, table_of
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import check_scene, scene_to_row
from desirepath.simulation.setups import CONTROL_DT_S, Setup, SetupError, require_plain, require_same
from desirepath.simulation.trajectory import Outcome, Trajectory

DriveMode = Literal["velocity", "wheels"]

SUBSTEPS = 48  # physics steps per control step: 240 Hz, PyBullet's own default
WHEELED_ROBOT = "turtlebot2"  # whose wheels `turtlebot.urdf` has
WHEEL_RADIUS_M = 0.035  # Kobuki TurtleBot 2
WHEEL_SEPARATION_M = 0.23  # Kobuki TurtleBot 2
WHEEL_TORQUE_NM = 10.0
TOUCH_M = {"velocity": 0.0, "wheels": 0.001}  # with contact forces, touching bodies rest at small positive distances
_RAY, _ROBOT, _FLOOR, _SOLID = 1, 2, 4, 8  # collision groups; PyBullet's rays are in 1, and ours see solids only
_URDF = Path(__file__).with_name("turtlebot.urdf")


@cache
def pybullet() -> Any:
    """PyBullet, imported late; what it prints while loading goes to stderr, where logs belong.

    Raises LookupError where it is not installed.
    """
    if importlib.util.find_spec("pybullet") is None:
        raise LookupError(
            "engine = pybullet: PyBullet is not installed (pip install 'desirepath[reference]', Python 3.11); "
            "fast works without it"
        )
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        return importlib.import_module("pybullet")
    finally:
        os.dup2(kept, 1)
        os.close(kept)


class ReferenceEngine:
    """One robot of one setup in PyBullet (DIRECT).

    drive_mode `velocity`: the commanded velocity is set on the base before every physics step; the rollout ends before
    contact forces would matter, so they are off. `wheels`: wheel motors on a TurtleBot-like robot that stands on a
    floor with friction; commands are reached with the motors' delay.

    After `reset` and `step`: observation (obs,) float32, reward, done, outcome, pose (3,) float64, human_distance and
    obstacle_clearance (metres, as in FastEngine), steps, self_intersections. Close it, or use it in a `with` block.
    """

    def __init__(self, setup: Setup, *, drive_mode: DriveMode = "velocity", progress_weight: float = 0.0) -> None:
        if drive_mode not in TOUCH_M:
            raise ValueError(f"drive_mode = {drive_mode!r}: must be one of {', '.join(TOUCH_M)}")
        if drive_mode == "wheels" and setup.robot.name != WHEELED_ROBOT:
            raise SetupError(
                f"setup {setup.name}: only {WHEELED_ROBOT} has wheels in PyBullet; use drive_mode velocity"
            )
        require_plain(setup, "PyBullet")
        if setup.crowded:
            raise SetupError(f"setup {setup.name}: PyBullet has no pedestrians here; the fast engine has")
        self.setup, self.drive_mode = setup, drive_mode
        self._rules = rules_of(setup, progress_weight)
        self._p = pybullet()
        self._client = self._p.connect(self._p.DIRECT)
        angles = np.arange(setup.robot.lidar.beams) * (2 * math.pi / setup.robot.lidar.beams)
        self._beam_cos, self._beam_sin = np.cos(angles), np.sin(angles)
        self._path = np.zeros((setup.max_steps + 1, 2))
        self._commands = np.zeros((1, 2, 2))
        self._largest_jerk = np.zeros(1)
        self.observation = np.zeros(setup.observation_size, dtype=np.float32)
        self.pose = np.zeros(3)
        self.reward, self.done, self.outcome = 0.0, True, Outcome.RUNNING
        self.human_distance = self.obstacle_clearance = math.inf
        self.steps = self.self_intersections = 0
        self.scene: Scene | None = None

    def __enter__(self) -> ReferenceEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the physics server back. Closing twice is fine."""
        if self._client >= 0:
            self._p.disconnect(physicsClientId=self._client)
            self._client = -1

    def reset(self, scene: Scene) -> Floats:
        """Build the scene and stand at its start; returns the observation. Raises SceneError, SetupError."""
        require_same(engine=self.setup.name, scene=scene.setup)
        check_scene(scene)
        self.scene, self._row = scene, scene_to_row(scene)
        self._build(scene)
        self._commands[:] = 0.0
        self._largest_jerk[:] = 0.0
        self._place(scene.start)
        self._path[0] = self.pose[:2]
        self.reward, self.done, self.outcome = 0.0, False, Outcome.RUNNING
        self.steps = self.self_intersections = 0
        self._observe(0.0, 0.0)
        return self.observation

    def _build(self, scene: Scene) -> None:
        p, on = self._p, {"physicsClientId": self._client}
        p.resetSimulation(**on)
        p.setTimeStep(self._rules.dt / SUBSTEPS, **on)
        self._solids = []
        for solid in scene.solids():
            size = [solid.length / 2, solid.width / 2, solid.height / 2]
            shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=size, **on)
            turned = p.getQuaternionFromEuler([0, 0, solid.pose.yaw])
            where = [solid.pose.x, solid.pose.y, solid.height / 2]
            self._solids.append(p.createMultiBody(0, shape, -1, where, turned, **on))
        person = scene.person
        shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=person.radius, height=person.height, **on)
        where = [person.pose.x, person.pose.y, person.height / 2]
        self._solids.append(p.createMultiBody(0, shape, -1, where, **on))
        for body in self._solids:
            p.setCollisionFilterGroupMask(body, -1, _SOLID, _ROBOT | _RAY, **on)
        if self.drive_mode == "velocity":
            shape = p.createCollisionShape(
                p.GEOM_CYLINDER, radius=self.setup.robot.radius_m, height=self.setup.robot.height_m, **on
            )
            self._robot, self._rest_height = p.createMultiBody(6.0, shape, -1, **on), self.setup.robot.height_m / 2
            p.changeDynamics(self._robot, -1, linearDamping=0.0, angularDamping=0.0, **on)
            p.setCollisionFilterGroupMask(self._robot, -1, _ROBOT, 0, **on)
        else:
            self._build_wheeled_robot()

    def _build_wheeled_robot(self) -> None:
        p, on = self._p, {"physicsClientId": self._client}
        p.setGravity(0, 0, -9.81, **on)
        floor = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE, **on), **on)
        p.setCollisionFilterGroupMask(floor, -1, _FLOOR, _ROBOT, **on)
        p.changeDynamics(floor, -1, lateralFriction=1.0, **on)
        self._robot, self._rest_height = p.loadURDF(str(_URDF), **on), WHEEL_RADIUS_M
        links = {p.getJointInfo(self._robot, j, **on)[12].decode(): j for j in range(p.getNumJoints(self._robot, **on))}
        self._wheels = [links["left_wheel"], links["right_wheel"]]
        p.changeDynamics(self._robot, -1, linearDamping=0.0, angularDamping=0.0, **on)
        for link in (-1, *links.values()):
            p.setCollisionFilterGroupMask(self._robot, link, _ROBOT, _SOLID | _FLOOR, **on)
            grip = 1.0 if link in self._wheels else 0.0
            p.changeDynamics(self._robot, link, lateralFriction=grip, rollingFriction=0.0, spinningFriction=0.0, **on)

    def _place(self, pose: Pose) -> None:
        p, on = self._p, {"physicsClientId": self._client}
        turned = p.getQuaternionFromEuler([0, 0, pose.yaw])
        if self.drive_mode == "wheels":  # PyBullet places the centre of mass, which lies above the axle
            centre = p.getDynamicsInfo(self._robot, -1, **on)[3]
            height = self._rest_height + centre[2]
        else:
            height = self._rest_height
        p.resetBasePositionAndOrientation(self._robot, [pose.x, pose.y, height], turned, **on)
        p.resetBaseVelocity(self._robot, [0, 0, 0], [0, 0, 0], **on)
        self._read_pose()

    def _read_pose(self) -> None:
        (x, y, _), turned = self._p.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        self.pose[0], self.pose[1] = x, y
        self.pose[2] = math.atan2(
            2 * (turned[3] * turned[2] + turned[0] * turned[1]), 1 - 2 * (turned[1] ** 2 + turned[2] ** 2)
        )

    def raw_ranges(self, pose: Pose | None = None) -> NDArray[np.float64]:
        """Every lidar beam from `pose` (default: the robot's): (beams,) metres, one ray-cast thread."""
        x, y, yaw = (pose.x, pose.y, pose.yaw) if pose is not None else self.pose
        lidar = self.setup.robot.lidar
        c, s = lidar.range_m * math.cos(yaw), lidar.range_m * math.sin(yaw)
        ends = np.empty((lidar.beams, 3))
        ends[:, 0] = x + c * self._beam_cos - s * self._beam_sin
        ends[:, 1] = y + s * self._beam_cos + c * self._beam_sin
        ends[:, 2] = lidar.height_m
        hits = self._p.rayTestBatch(
            [[x, y, lidar.height_m]] * lidar.beams,
            ends.tolist(),
            numThreads=1,
            collisionFilterMask=_SOLID,
            physicsClientId=self._client,
        )
        return np.array([hit[2] for hit in hits]) * lidar.range_m

    def touches(self, pose: Pose | None = None) -> bool:
        """Whether the robot's body touches anything, by closest points; with `pose`, after moving it there."""
        if pose is not None:
            self._place(pose)
        return self._touching(self._near(0.0))

    def _near(self, reach: float) -> list[int]:
        """The solids whose bounding boxes lie within `reach` metres of the robot's body."""
        margin = self.setup.robot.radius_m + reach + 0.01
        low = [self.pose[0] - margin, self.pose[1] - margin, 0.02]
        high = [self.pose[0] + margin, self.pose[1] + margin, self.setup.robot.height_m]
        found = self._p.getOverlappingObjects(low, high, physicsClientId=self._client) or ()
        return sorted({body for body, _ in found} & set(self._solids))

    def _touching(self, bodies: Sequence[int]) -> bool:
        limit = TOUCH_M[self.drive_mode]
        return any(
            point[8] < limit
            for body in bodies
            for point in self._p.getClosestPoints(self._robot, body, limit + 1e-4, physicsClientId=self._client)
        )

    def _drive(self, v: float, w: float) -> bool:
        """One control step of physics; True if it was ended by a contact, with the robot where it last was free."""
        p, on = self._p, {"physicsClientId": self._client}
        near = self._near(v * self._rules.dt + 0.02)
        if self.drive_mode == "wheels":
            speeds = [(v + side * w * WHEEL_SEPARATION_M / 2) / WHEEL_RADIUS_M for side in (-1, 1)]
            p.setJointMotorControlArray(
                self._robot,
                self._wheels,
                p.VELOCITY_CONTROL,
                targetVelocities=speeds,
                forces=[WHEEL_TORQUE_NM] * 2,
                **on,
            )
        for _ in range(SUBSTEPS):
            if self.drive_mode == "velocity":
                # The heading in the middle of the physics step: its chord is then that of the arc.
                heading = self.pose[2] + w * self._rules.dt / SUBSTEPS / 2
                velocity = [v * math.cos(heading), v * math.sin(heading), 0]
                p.resetBaseVelocity(self._robot, velocity, [0, 0, w], **on)
            free = self.pose.copy()
            p.stepSimulation(**on)
            self._read_pose()
            if near and self._touching(near):
                self.pose[:] = free
                return True
        return False

    def _advance_person(self) -> None:
        """A walking person takes their next step before the robot does, as in the fast engine."""
        if self.scene is None or self.scene.walk is None:
            return
        pose = self.scene.person_poses([(self.steps + 1) * CONTROL_DT_S])[0]
        self._row[k.PERSON_X : k.PERSON_YAW + 1] = pose
        where = [pose[0], pose[1], self.scene.person.height / 2]
        self._p.resetBasePositionAndOrientation(self._solids[-1], where, [0, 0, 0, 1], physicsClientId=self._client)

    def _observe(self, v: float, w: float) -> None:
        x, y, yaw = self.pose
        row, scale = self._row, self.setup.distance_scale_m
        goal_x, goal_y = row[k.GOAL_X] - x, row[k.GOAL_Y] - y
        person_x, person_y = row[k.PERSON_X] - x, row[k.PERSON_Y] - y
        self.human_distance = math.hypot(person_x, person_y)
        self.obstacle_clearance = k.surface_distance(row, x, y) - self.setup.robot.radius_m
        if self.setup.solids:  # chapter 2 assumes that all positions are known: nothing is measured by rays
            self.observation = np.zeros(self.setup.observation_size, dtype=np.float32)
            k.observe_solids(row, self.pose, scale, self.observation)
            return
        task = [
            math.hypot(goal_x, goal_y) / scale,
            k.wrap(math.atan2(goal_y, goal_x) - yaw) / math.pi,
        ]
        if self.setup.with_person:
            task += [self.human_distance / scale, k.wrap(math.atan2(person_y, person_x) - yaw) / math.pi]
        if self.setup.with_velocity:
            task += [v / self.setup.robot.limits.v_max, w / self.setup.robot.limits.w_max]
        pooled = (
            self.raw_ranges().reshape(self.setup.robot.lidar.sectors, -1).min(axis=1) / self.setup.robot.lidar.range_m
        )
        self.observation = np.concatenate([task, pooled]).astype(np.float32)

    def step(self, action: NDArray[np.floating[Any]]) -> None:
        """One control step (0.2 s) with `action` (2,) in [-1, 1], clipped. Raises ActionError for anything else.

        Raises RuntimeError before `reset` and after the episode ended.
        """
        if self.done:
            raise RuntimeError("the episode has ended or never begun; call reset(scene) first")
        numbers = np.asarray(action, dtype=np.float64)
        if numbers.shape != (2,) or not np.isfinite(numbers).all():
            raise ActionError(f"action = {numbers.tolist()}: must be two finite numbers in [-1, 1]")
        limits, rules, row = self.setup.robot.limits, self._rules, self._row
        forward, turning = np.clip(numbers, -1.0, 1.0)
        v, w = (forward + 1) / 2 * (limits.v_max - limits.v_min) + limits.v_min, turning * limits.w_max
        goal = np.array([row[k.GOAL_X], row[k.GOAL_Y]])
        goal_before = float(np.linalg.norm(goal - self.pose[:2]))
        self._advance_person()
        hit = self._drive(v, w)
        self.steps += 1
        self._path[self.steps] = self.pose[:2]
        goal_after = float(np.linalg.norm(goal - self.pose[:2]))
        jerk = k.jerk_penalty(self._commands, self._largest_jerk, 0, v, w, rules.jerk_weight)
        self.reward = rules.time_per_step + jerk + rules.progress_weight * (goal_before - goal_after)
        if k.crosses_itself(self._path, self.steps, rules.loop_age, rules.v_max * rules.dt):
            self.self_intersections += 1
            self.reward += rules.self_intersection
        apart = min(
            k.surface_distance(row, *self.pose[:2]), k.person_distance(row, *self.pose[:2]) - row[k.PERSON_RADIUS]
        )
        if apart < rules.near_m:
            self.reward += rules.near
        if hit:
            self.outcome = Outcome.COLLISION
            self.reward += rules.collision
        elif goal_after <= row[k.GOAL_RADIUS]:
            self.outcome = Outcome.SUCCESS
            self.reward += rules.goal
        elif self.steps >= rules.max_steps:
            self.outcome = Outcome.TIMEOUT
            self.reward += rules.timeout
        self.done = self.outcome != Outcome.RUNNING
        self._observe(v, w)


def rollout_reference(
    setup: Setup,
    act: ActFunction | EpisodicPolicy,
    scenes: Sequence[Scene],
    *,
    drive_mode: DriveMode = "velocity",
    max_steps: int | None = None,
) -> list[Trajectory]:
    """As `fast.rollout`, in PyBullet: one full trajectory per scene, in order."""
    limit = setup.max_steps if max_steps is None else min(max_steps, setup.max_steps)
    trajectories = []
    with ReferenceEngine(setup, drive_mode=drive_mode) as engine:
        for scene in scenes:
            engine.reset(scene)
            poses, observations = [engine.pose.copy()], [engine.observation]
            actions, rewards, dones = [], [], []
            steer, alone = begin(act, 1), np.zeros(1, dtype=np.int64)
            while not engine.done and engine.steps < limit:
                action = np.clip(steer(engine.observation[None], alone)[0], -1.0, 1.0)
                engine.step(action)
                poses.append(engine.pose.copy())
                observations.append(engine.observation)
                actions.append(action)
                rewards.append(engine.reward)
                dones.append(engine.done)
            trajectories.append(
                Trajectory(
                    scene=scene,
                    outcome=engine.outcome,
                    poses=np.asarray(poses, dtype=np.float32),
                    observations=np.asarray(observations[:-1], dtype=np.float32).reshape(-1, setup.observation_size),
                    actions=np.asarray(actions, dtype=np.float32).reshape(-1, 2),
                    rewards=np.asarray(rewards, dtype=np.float32),
                    next_observations=np.asarray(observations[1:], dtype=np.float32).reshape(
                        -1, setup.observation_size
                    ),
                    dones=np.asarray(dones, dtype=np.bool_),
                    self_intersections=engine.self_intersections,
                    dt=CONTROL_DT_S,
                )
            )
    return trajectories


def evaluate_reference(act: ActFunction | EpisodicPolicy, setup: Setup, scenes: Sequence[Scene]) -> EpisodeTable:
    """As `fast.evaluate`, in PyBullet. Raises ValueError for no scenes."""
    return table_of(rollout_reference(setup, act, scenes))
