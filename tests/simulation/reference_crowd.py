"""The reference for `crowd_engine`: one robot among pedestrians in PyBullet, to check and to be compared with.

Rays, contacts and the robot's motion come from PyBullet; pedestrians are put where their routes say.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.crowds import crowd_setups as settings
from desirepath.simulation.crowds.crowd_kernels import SUBSTEPS as LOOKS
from desirepath.simulation.pedestrians import Pedestrian, where_on_route
from desirepath.simulation.reference import SUBSTEPS, pybullet
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.setups import CONTROL_DT_S, Setup
from desirepath.simulation.trajectory import Outcome

Doubles = NDArray[np.float64]


class CrowdReference:
    """One scene in PyBullet (DIRECT), as rigid boxes. After `reset` and `step`: outcome, pose (3,), ranges (beams,) m
    without noise. Close it, or use it in a `with` block. Crowds that avoid others are not walked here.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup, self._p = setup, pybullet()
        self._client = self._p.connect(self._p.DIRECT)
        self.pose, self.ranges = np.zeros(3), np.zeros(setup.robot.lidar.beams)
        self.outcome, self.steps = Outcome.RUNNING, 0

    def __enter__(self) -> CrowdReference:
        return self

    def __exit__(self, *_: object) -> None:
        self._p.disconnect(physicsClientId=self._client)

    def reset(self, scene: Scene) -> None:
        """Build the scene. Raises SceneError for a crowd that does not keep to its routes."""
        if scene.crowd is None or scene.crowd.behaviour != "path":
            raise SceneError("crowd", scene.crowd, "PyBullet walks pedestrians along their routes only")
        p, on = self._p, {"physicsClientId": self._client}
        p.resetSimulation(**on)
        p.setTimeStep(CONTROL_DT_S / SUBSTEPS, **on)
        self._goal = scene.goal
        self._walls = [self._box(o.length, o.width, o.height, (o.pose.x, o.pose.y, o.pose.yaw)) for o in scene.solids()]
        person = scene.person.pose
        self._who = (Pedestrian(((person.x, person.y),), 0.0, person.yaw), *scene.crowd.pedestrians)
        self._people = [
            self._box(settings.PED_DEPTH_M, settings.PED_WIDTH_M, settings.PED_HEIGHT_M, where_on_route(one, 0.0))
            for one in self._who
        ]
        shape = p.createCollisionShape(
            p.GEOM_CYLINDER, radius=self.setup.robot.radius_m, height=self.setup.robot.height_m, **on
        )
        self._robot = p.createMultiBody(6.0, shape, -1, **on)
        p.setCollisionFilterGroupMask(self._robot, -1, 2, 0, **on)  # rays are in group 1; contact is asked for
        p.changeDynamics(self._robot, -1, linearDamping=0.0, angularDamping=0.0, **on)
        self.pose[:] = scene.start.x, scene.start.y, scene.start.yaw
        self._stand()
        self.outcome, self.steps = Outcome.RUNNING, 0
        self._look()

    def _box(self, length: float, width: float, height: float, at: tuple[float, float, float]) -> int:
        p, on = self._p, {"physicsClientId": self._client}
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=[length / 2, width / 2, height / 2], **on)
        turned = p.getQuaternionFromEuler([0, 0, at[2]])
        return int(p.createMultiBody(0, shape, -1, [at[0], at[1], height / 2], turned, **on))

    def _stand(self) -> None:
        turned = self._p.getQuaternionFromEuler([0, 0, self.pose[2]])
        where = [*self.pose[:2], self.setup.robot.height_m / 2]
        self._p.resetBasePositionAndOrientation(self._robot, where, turned, physicsClientId=self._client)

    def _look(self) -> None:
        lidar = self.setup.robot.lidar
        angles = self.pose[2] + np.arange(lidar.beams) * (2 * math.pi / lidar.beams)
        reach = np.stack([np.cos(angles), np.sin(angles), np.zeros(lidar.beams)], axis=1) * lidar.range_m
        start = np.array([*self.pose[:2], lidar.height_m])
        hits = self._p.rayTestBatch([start.tolist()] * lidar.beams, (start + reach).tolist(), numThreads=1,
                                    physicsClientId=self._client)  # fmt: skip
        self.ranges[:] = [hit[2] * lidar.range_m for hit in hits]

    def _touches(self) -> bool:
        p, on = self._p, {"physicsClientId": self._client}
        return any(p.getClosestPoints(self._robot, one, 0.0, **on) for one in (*self._walls, *self._people))

    def step(self, action: Any) -> None:
        """One control step with an action (2,) in [-1, 1]."""
        p, on, limits = self._p, {"physicsClientId": self._client}, self.setup.robot.limits
        v = (float(action[0]) + 1) / 2 * (limits.v_max - limits.v_min) + limits.v_min
        w = float(action[1]) * limits.w_max
        hit = False
        for part in range(1, LOOKS + 1):
            seconds = (self.steps + part / LOOKS) * CONTROL_DT_S
            for body, one in zip(self._people, self._who, strict=True):
                x, y, yaw = where_on_route(one, seconds)
                turned = p.getQuaternionFromEuler([0, 0, yaw])
                p.resetBasePositionAndOrientation(body, [x, y, settings.PED_HEIGHT_M / 2], turned, **on)
            for _ in range(SUBSTEPS // LOOKS):
                _, turned = p.getBasePositionAndOrientation(self._robot, **on)
                yaw = p.getEulerFromQuaternion(turned)[2] + w * CONTROL_DT_S / SUBSTEPS / 2
                p.resetBaseVelocity(self._robot, [v * math.cos(yaw), v * math.sin(yaw), 0], [0, 0, w], **on)
                p.stepSimulation(**on)
            if self._touches():
                hit = True
                break
        where, turned = p.getBasePositionAndOrientation(self._robot, **on)
        self.pose[:] = where[0], where[1], p.getEulerFromQuaternion(turned)[2]
        self.steps += 1
        self._look()
        if hit:
            self.outcome = Outcome.COLLISION
        elif math.dist(self.pose[:2], (self._goal.x, self._goal.y)) <= self.setup.goal_radius_m:
            self.outcome = Outcome.SUCCESS
        elif self.steps >= self.setup.max_steps:
            self.outcome = Outcome.TIMEOUT
