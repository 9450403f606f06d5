"""The three views as cameras: where the eye stands, what it looks at, what must be in sight.

Only geometry. The page's own script (`client/camera.js`) turns a camera into pixels, because it knows the window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath_stage.bodies import PERSON_DISC_RADIUS_M
from desirepath_stage.orders import CameraOrder

View = Literal["top_down", "first_person", "immersive"]
VIEWS: tuple[View, ...] = get_args(View)

FIRST_PERSON_FOV_RAD = math.radians(60)  # vertical; ch. 7
IMMERSIVE_FOV_RAD = math.radians(75)  # vertical; ours, a headset shows more than a screen and a screen can be turned
TOP_DOWN_FOV_RAD = math.radians(10)  # high and narrow, as near to a plan as a perspective camera gets
TRACKED_HEIGHT_M = 0.30  # the camera follows this point of the robot
_MARGIN_M = 0.35  # around the outermost thing that must be in sight
CLOSE_MARGIN_M = 0.55  # ours: a way is seen with what it passes
BARE_MARGIN_M = 0.25  # ours: where nothing stands, with no more than the ring around the robot
BUILDING_MARGIN_M = 1.2  # ours: with so much of the walls around
WALL_SEEN_M = 0.1  # ours: so much of a wall's thickness tells that it is one
NEAR_M = 1.5  # ours: from the robot, people belong to what is seen
CLOSEST_M = 3.6  # ours: no frame is smaller, or nobody knows where in the room they are


Frame = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max, metres."""


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
    frame: Frame

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


def frame_of(
    scene: Scene, trajectories: Sequence[Trajectory] = (), *, close: bool = False, goal: bool = False
) -> Frame:
    """The rectangle that must be in sight from above: the room, or everything in the open plus all paths.

    close: no more than what matters, so that robot and person are as large as can be: the paths, the person, whom
    the robot meets, and with `goal` the goal, with some room around them.
    """
    points = [(scene.start.x, scene.start.y)]
    if scene.has_person:
        person, around = scene.person.pose, PERSON_DISC_RADIUS_M
        points += [(person.x + d, person.y + d) for d in (-around, around)]
    whole = _room_frame(scene)
    if close:
        margin = CLOSE_MARGIN_M if scene.obstacles or scene.ground else BARE_MARGIN_M
        if goal:
            points += [(scene.goal.x + d, scene.goal.y + d) for d in (-scene.goal_radius, scene.goal_radius)]
        points += [corner for trajectory in trajectories for corner in _met(trajectory)]
    elif whole is not None:
        points += [whole[:2], whole[2:]]
        margin = 0.1
    else:
        points.append((scene.goal.x, scene.goal.y))
        for obstacle in scene.obstacles:
            reach = math.hypot(obstacle.length, obstacle.width) / 2
            points += [(obstacle.pose.x + d, obstacle.pose.y + d) for d in (-reach, reach)]
        margin = _MARGIN_M if scene.ground is None else BUILDING_MARGIN_M
    for trajectory in trajectories:
        low, high = _reach(trajectory)
        points += [low, high]
    corners = np.array([np.min(points, axis=0) - margin, np.max(points, axis=0) + margin])
    if close:
        missing = np.maximum(0.0, CLOSEST_M - (corners[1] - corners[0])) / 2
        corners += [-missing, missing]
        if scene.room is not None:  # beyond the walls there is nothing
            half = np.array([scene.room.length, scene.room.width]) / 2 + WALL_SEEN_M
            corners = np.clip(corners, -half, half)
    return float(corners[0, 0]), float(corners[0, 1]), float(corners[1, 0]), float(corners[1, 1])


def holds(frame: Frame, trajectory: Trajectory) -> bool:
    """Whether a frame has all of a path in sight."""
    low, high = _reach(trajectory)
    return frame[0] <= low[0] and frame[1] <= low[1] and frame[2] >= high[0] and frame[3] >= high[1]


def _reach(trajectory: Trajectory) -> tuple[tuple[float, float], tuple[float, float]]:
    """The lower left and the upper right corner of where the robot comes, its body with it."""
    xy = np.asarray(trajectory.poses, np.float64)[:, :2]
    body = max(0.2, get_setup(trajectory.scene.setup).robot.radius_m + 0.02)
    (a, b), (c, d) = xy.min(0) - body, xy.max(0) + body
    return (float(a), float(b)), (float(c), float(d))


def _met(trajectory: Trajectory) -> list[tuple[float, float]]:
    """Where people are while the robot is near to them; who walks elsewhere comes into sight when they come here."""
    robot = np.asarray(trajectory.poses, np.float64)[:, :2]
    people = trajectory.scene.people_at(trajectory.times)
    near = people[np.linalg.norm(people - robot, axis=2) < NEAR_M]
    return [(float(x + d), float(y + d)) for x, y in near for d in (-PERSON_DISC_RADIUS_M, PERSON_DISC_RADIUS_M)]


def _room_frame(scene: Scene) -> Frame | None:
    """The room with its walls."""
    if scene.room is None:
        return None
    half_x = scene.room.length / 2 + scene.room.wall_thickness
    half_y = scene.room.width / 2 + scene.room.wall_thickness
    return -half_x, -half_y, half_x, half_y


def camera_for(
    scene: Scene,
    view: View,
    trajectories: Sequence[Trajectory] = (),
    *,
    close: bool = False,
    goal: bool = False,
    around_m: float = 0.0,
) -> Camera:
    """The camera of a view in a scene. `trajectories`: whatever will be played there, so that A and B share a frame;
    close, goal: as for `frame_of`; around_m: so much more is in sight from above, on each side.
    """
    frame = frame_of(scene, trajectories, close=close, goal=goal)
    frame = (frame[0] - around_m, frame[1] - around_m, frame[2] + around_m, frame[3] + around_m)
    if view == "top_down":
        middle = ((frame[0] + frame[2]) / 2, (frame[1] + frame[3]) / 2)
        return Camera(view, (*middle, 60.0), (*middle, 0.0), TOP_DOWN_FOV_RAD, frame)
    person, start = scene.person.pose, scene.start
    eye = (person.x, person.y, scene.person.eye_height_m)
    target = (start.x, start.y, TRACKED_HEIGHT_M)
    fov = FIRST_PERSON_FOV_RAD if view == "first_person" else IMMERSIVE_FOV_RAD
    return Camera(view, eye, target, fov, frame)
