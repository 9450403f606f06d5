"""The depth camera in PyBullet: the same shapes drawn by its software renderer, to check the fast engine's against."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.depth_camera import DEPTH_CAMERA, DepthCamera, Frames
from desirepath.simulation.depth_shapes import MANNEQUIN, seen_of
from desirepath.simulation.reference import pybullet
from desirepath.simulation.scene import Scene

NEAR_M, FAR_M = 0.02, 30.0
FLOOR_HALF_M = 30.0


class ReferenceCamera:
    """One scene at a time as visual shapes in PyBullet (DIRECT), seen by TinyRenderer, which runs on one core."""

    def __init__(self, camera: DepthCamera = DEPTH_CAMERA) -> None:
        self.camera = camera
        self._p = pybullet()
        self._client = self._p.connect(self._p.DIRECT)
        rise = math.degrees(2 * math.atan(camera.rows / 2 / camera.focal_px))
        projection = list(self._p.computeProjectionMatrixFOV(rise, camera.columns / camera.rows, NEAR_M, FAR_M))
        # TinyRenderer looks through the pixels' corners; moved by half a pixel it looks through their middles.
        projection[8], projection[9] = 1 / camera.columns, 1 / camera.rows
        self._projection = projection
        self._limbs: list[tuple[int, NDArray[np.float64], list[float]]] = []

    def __enter__(self) -> ReferenceCamera:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: object, __: TracebackType | None) -> None:
        self._p.disconnect(physicsClientId=self._client)

    def build(self, scene: Scene) -> None:
        """Stand everything up, the person where the scene has them."""
        p, on = self._p, {"physicsClientId": self._client}
        p.resetSimulation(**on)
        floor = [FLOOR_HALF_M, FLOOR_HALF_M, 0.05]
        self._add(p.createVisualShape(p.GEOM_BOX, halfExtents=floor, **on), [0, 0, -0.05], [0, 0, 0, 1])
        boxes, cylinders = seen_of(scene)
        for x, y, c, s, half_length, half_width, low, high in boxes.tolist():
            shape = p.createVisualShape(p.GEOM_BOX, halfExtents=[half_length, half_width, (high - low) / 2], **on)
            self._add(shape, [x, y, (low + high) / 2], p.getQuaternionFromEuler([0, 0, math.atan2(s, c)]))
        for x, y, radius, low, high in cylinders.tolist():
            shape = p.createVisualShape(p.GEOM_CYLINDER, radius=radius, length=high - low, **on)
            self._add(shape, [x, y, (low + high) / 2], [0, 0, 0, 1])
        self._limbs = []
        for limb in scene.person.height * MANNEQUIN:
            axis = limb[3:6] - limb[:3]
            length = float(np.linalg.norm(axis))
            shape = p.createVisualShape(p.GEOM_CAPSULE, radius=float(limb[6]), length=length, **on)
            turn, tilt = math.atan2(axis[1], axis[0]), math.acos(axis[2] / length)
            turned = p.getQuaternionFromEuler([0, tilt, turn])
            self._limbs.append((self._add(shape, [0, 0, -5], turned), (limb[:3] + limb[3:6]) / 2, list(turned)))
        self.move_person((scene.person.pose.x, scene.person.pose.y, scene.person.pose.yaw))

    def _add(self, shape: int, where: Sequence[float], turned: Sequence[float]) -> int:
        return int(self._p.createMultiBody(0, -1, shape, where, turned, physicsClientId=self._client))

    def move_person(self, pose: Sequence[float]) -> None:
        """Put the person at x, y (m), yaw (rad)."""
        p, on = self._p, {"physicsClientId": self._client}
        where = [pose[0], pose[1], 0.0]
        facing = p.getQuaternionFromEuler([0, 0, pose[2]])
        for body, middle, turned in self._limbs:
            place, rotated = p.multiplyTransforms(where, facing, middle.tolist(), turned)
            p.resetBasePositionAndOrientation(body, place, rotated, **on)

    def picture(self, pose: Sequence[float]) -> Frames:
        """(rows, columns) depth in metres from a robot's pose x, y (m), yaw (rad), as `DepthCamera` gives it."""
        found = self.raw_picture(pose)
        depth = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * found)
        clipped: Frames = np.minimum(depth, self.camera.range_m).astype(np.float32)
        return clipped

    def raw_picture(self, pose: Sequence[float]) -> NDArray[Any]:
        """(rows, columns) the renderer's depth buffer, in [0, 1]."""
        p, camera = self._p, self.camera
        c, s = math.cos(pose[2]), math.sin(pose[2])
        eye = [pose[0] + camera.ahead_m * c, pose[1] + camera.ahead_m * s, camera.height_m]
        view = p.computeViewMatrix(eye, [eye[0] + c, eye[1] + s, eye[2]], [0, 0, 1])
        got = p.getCameraImage(
            camera.columns,
            camera.rows,
            view,
            self._projection,
            shadow=0,
            renderer=p.ER_TINY_RENDERER,
            flags=p.ER_NO_SEGMENTATION_MASK,
            physicsClientId=self._client,
        )
        return np.reshape(got[3], (camera.rows, camera.columns))
