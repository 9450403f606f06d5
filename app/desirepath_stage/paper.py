"""What lies on the floor, as plain data: the sheet that a path is drawn on with what the page's pen (`client/draw.js`)
has to know of a scene, paths beside a replay, tracks of whoever moves.

Whether a path can be driven is decided elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from desirepath.demonstrations.stroke import drawn_limits
from desirepath.simulation.pedestrians import where_on_route
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import solids_near
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_stage import furniture
from desirepath_stage.orders import Drawn, PaperOrder, StrokeTrouble, Surroundings, Track
from desirepath_stage.views import View

TIGHT_M = 0.08  # ours: nearer than this nobody can tell from the picture whether it still fits
AROUND_M = 4.0  # of a map, so far from start, goal and person; the page needs no more
LONGEST_CROWD_S = 60.0  # that pedestrians without a record are played for, twice the longest episode of ch. 4
Points = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Beside:
    """Paths beside what moves on a replay, for analysts, under one name in the legend. colour: red, green, blue, 0 to
    255. paths: (n, 2 or more) each, metres."""

    name: str
    colour: tuple[int, int, int]
    paths: Sequence[ArrayLike]


def pose_track(times: ArrayLike, poses: ArrayLike, digits: int = 4) -> Track:
    """[[t, x, y, yaw], ...] in s, m, rad, yaw unwrapped, for the page's player. times (n,), poses (n, 3)."""
    along = np.asarray(poses, np.float64)
    rows = np.column_stack([times, along[:, :2], np.unwrap(along[:, 2])])
    return [[round(float(value), digits) for value in row] for row in rows]


def walk_track(scene: Scene) -> Track | None:
    """How the scene's person walks, as the page plays it, None where they stand."""
    if scene.walk is None:
        return None
    times = np.arange(0.0, scene.walk.duration_s + CONTROL_DT_S, CONTROL_DT_S)
    return pose_track(times, scene.walk.poses_at(times))


def crowd_tracks(scene: Scene) -> list[Track]:
    """Where the scene's pedestrians are, as the page plays it: as they were recorded, else along their routes, where
    they avoid nobody.
    """
    tracks = []
    for pedestrian in scene.crowd.pedestrians if scene.crowd else ():
        if pedestrian.walk is not None:
            times = np.asarray(pedestrian.walk.times_s)
            poses = pedestrian.walk.poses_at(times)
        else:
            times = np.arange(0.0, LONGEST_CROWD_S, CONTROL_DT_S)
            poses = np.array([where_on_route(pedestrian, float(t)) for t in times])
        tracks.append(pose_track(times, poses, digits=3))
    return tracks


def surroundings(scene: Scene, person: str) -> Surroundings:
    """What stands around a robot or a walker, for the page. person: what the page's words call them."""
    pose = scene.person.pose
    return {
        "solids": [
            {
                "name": furniture.name(solid, index),
                "x": solid.pose.x,
                "y": solid.pose.y,
                "yaw": solid.pose.yaw,
                "length": solid.length,
                "width": solid.width,
            }
            for index, solid in enumerate(solids_near(scene, AROUND_M))
        ],
        "person": {"name": person, "x": pose.x, "y": pose.y, "radius": scene.person.radius},
        "robot_radius": get_setup(scene.setup).robot.radius_m,
    }


@dataclass(frozen=True)
class Paper:
    """One sheet. id: comes back with the stroke. kept: paths of the same situation, drawn thin, metres.

    drawn: a stroke that is on it already, {points [[x, y], ...] m, speeds m/s, times_s of the hand}. resting: nothing
    can be drawn now. problem: what is wrong with that stroke, {"code": one of StrokeProblem's, "at": [x, y] m, "thing":
    what is touched or None}. walks: scenes with the walks to choose from; chosen: which one the stroke is for.
    most_points: so many the server takes.
    """

    id: str
    kept: Sequence[Points] = ()
    drawn: Mapping[str, Sequence[Any]] | None = None
    resting: bool = False
    problem: Mapping[str, Any] | None = None
    walks: Sequence[Scene] = ()
    chosen: int | None = None
    most_points: int = 4_000

    def as_message(self, scene: Scene, view: View) -> PaperOrder:
        """Plain data for the page."""
        limits = drawn_limits(scene.setup)
        return {
            **surroundings(scene, "person" if view == "top_down" else "you"),
            "id": self.id,
            "start": [scene.start.x, scene.start.y, scene.start.yaw],
            "goal": [scene.goal.x, scene.goal.y, scene.goal_radius],
            "speeds": [limits.v_min, limits.v_max],
            "kept": [[list(point) for point in path] for path in self.kept],
            "drawn": cast("Drawn", dict(self.drawn)) if self.drawn else None,
            "resting": self.resting,
            "problem": cast("StrokeTrouble", dict(self.problem)) if self.problem else None,
            "walks": [track for walked in self.walks if (track := walk_track(walked)) is not None],
            "chosen": self.chosen,
            "most_points": self.most_points,
            "tight_m": TIGHT_M,
        }
