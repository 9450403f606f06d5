"""The three views as cameras: where the eye stands, what it looks at, what must be in sight.

Only geometry. The page's own script (`client/camera.js`) turns a camera into pixels, because it knows the window.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from app.bodies import PERSON_DISC_RADIUS_M
from app.orders import CameraOrder
from backend.simulation.scene import Scene
from backend.simulation.trajectory import Trajectory

View = Literal["top_down", "first_person", "immersive"]
VIEWS: tuple[View, ...] = get_args(View)

FIRST_PERSON_FOV_RAD = math.radians(60)  # vertical; ch. 7
IMMERSIVE_FOV_RAD = math.radians(75)  # vertical; ours, a headset shows more than a screen and a screen can be turned
TOP_DOWN_FOV_RAD = math.radians(10)  # high and narrow, as near to a plan as a perspective camera gets
TRACKED_HEIGHT_M = 0.30  # the camera follows this point of the robot
_MARGIN_M = 0.35  # around the outermost thing that must be in sight


class ViewError(ValueError):
    """A view that does not exist."""


@dataclass(frozen=True)
class Camera:
    """How one view looks at one scene.

    eye, target: world metres. fov_rad: vertical. frame: (x_min, y_min, x_max, y_max), metres, all of it in sight
    from above (`top_down` ignores `eye` and fits this rectangle to the window).
    """

    view: View
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_rad: float
    frame: tuple[float, float, float, float]

    def as_message(self) -> CameraOrder:
        """Plain data for the page."""
        return {
            "view": self.view,
            "eye": list(self.eye),
            "target": list(self.target),
            "fov_rad": self.fov_rad,
            "frame": list(self.frame),
        }


def require_view(view: str) -> View:
    """The view of that name. Raises ViewError listing the known ones."""
    for known in VIEWS:
        if view == known:
            return known
    raise ViewError(f"unknown view {view!r}; known: {', '.join(VIEWS)}")


def frame_of(scene: Scene, trajectories: Iterable[Trajectory] = ()) -> tuple[float, float, float, float]:
    """The rectangle that must be in sight from above: the room, or everything in the open plus all paths."""
    if scene.room is not None:
        half_x = scene.room.length / 2 + scene.room.wall_thickness
        half_y = scene.room.width / 2 + scene.room.wall_thickness
        points = [(-half_x, -half_y), (half_x, half_y)]
        margin = 0.1
    else:
        points = [(scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y)]
        person = scene.person.pose
        points += [(person.x + d, person.y + d) for d in (-PERSON_DISC_RADIUS_M, PERSON_DISC_RADIUS_M)]
        for obstacle in scene.obstacles:
            reach = math.hypot(obstacle.length, obstacle.width) / 2
            points += [(obstacle.pose.x + d, obstacle.pose.y + d) for d in (-reach, reach)]
        margin = _MARGIN_M
    for trajectory in trajectories:
        xy = np.asarray(trajectory.poses, np.float64)[:, :2]
        points += [(float(x), float(y)) for x, y in (xy.min(0) - 0.2, xy.max(0) + 0.2)]
    low, high = np.min(points, axis=0) - margin, np.max(points, axis=0) + margin
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def camera_for(scene: Scene, view: View, trajectories: Iterable[Trajectory] = ()) -> Camera:
    """The camera of a view in a scene. `trajectories`: whatever will be played there, so that A and B share a frame."""
    frame = frame_of(scene, trajectories)
    person, start = scene.person.pose, scene.start
    eye = (person.x, person.y, scene.person.eye_height_m)
    target = (start.x, start.y, TRACKED_HEIGHT_M)
    if view == "top_down":
        middle = ((frame[0] + frame[2]) / 2, (frame[1] + frame[3]) / 2)
        return Camera(view, (*middle, 60.0), (*middle, 0.0), TOP_DOWN_FOV_RAD, frame)
    fov = FIRST_PERSON_FOV_RAD if view == "first_person" else IMMERSIVE_FOV_RAD
    return Camera(view, eye, target, fov, frame)
