"""What an explanation adds to a scene: outlines of objects, lidar rays, the goal's ring and the line to it.

Meshes are made here once; how thick, how long and where they are at each moment is the page's (`client/explained.js`).
"""

from __future__ import annotations

import math
from functools import cache, lru_cache

import numpy as np
import viser

from desirepath.explain.shown_explanation import ShownAttention, ShownExplanation, solids_of
from desirepath.simulation.crowds.crowd_setups import PED_DEPTH_M, PED_WIDTH_M
from desirepath.simulation.scene import Obstacle, Scene
from desirepath.simulation.scenes import solids_near
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_stage import furniture
from desirepath_stage.glb import Surface, to_glb
from desirepath_stage.orders import Attention, Explained, Solid
from desirepath_stage.outlines import body
from desirepath_stage.scene_nodes import squares
from desirepath_stage.shapes import Colour, rotate

THICKEST_M = 0.15  # ours: outline of an object that scores 1, in the world, so it is thinner far away
DASHES = 48  # of the line to the goal, 0.3 m each: 14 m
CORNERS_PER_RAY = 8  # four of the ray, four of the mark at its end
CORNERS_PER_WEIGHT = 4  # of a lidar sector or a descriptor ray that a policy looks at
RING_TUBE_M = 0.045
_WHITE: Colour = (255, 255, 255)
_RIM: Colour = (30, 34, 40)  # around the white, so that it stands out from a light floor
_GREEN: Colour = (24, 122, 66)


def add_explained(api: viser.SceneApi, root: str, scene: Scene, shown: ShownExplanation) -> tuple[Explained, list[str]]:
    """Add the meshes; returns what the page must know of them, and their names."""
    names: dict[str, str] = {"ring": f"{root}/ring", "line": f"{root}/line"}
    _add(api, names["ring"], _ring(scene.goal_radius), (scene.goal.x, scene.goal.y))
    _add(api, names["line"], squares(DASHES, 4, _GREEN))
    robot = get_setup(scene.setup).robot
    lidar = robot.lidar
    if shown.lidar:
        names["rays"] = f"{root}/rays"
        _add(api, names["rays"], squares(lidar.beams, CORNERS_PER_RAY, _GREEN))
    objects = solids_of(scene, shown.things, (len(shown.scores) - 1) * CONTROL_DT_S)
    if shown.outlines:
        for index, obstacle in enumerate(objects):
            names[f"outline{index}"] = f"{root}/outline{index}"
            _add(api, names[f"outline{index}"], _outline(obstacle, index))
    if shown.attention is not None:
        names["attention"] = f"{root}/attention"
        attended = len(shown.attention.spatial[0]) + len(shown.attention.temporal[0])
        _add(api, names["attention"], squares(attended, CORNERS_PER_WEIGHT, _GREEN))
    attention = None
    if shown.attention is not None:
        attention = _attention(shown.attention, names["attention"], robot.radius_m)
    person = scene.person
    order: Explained = {
        "objects": [
            {**_solid(obstacle), "thing": thing, "outline": names.get(f"outline{index}", ""), "height": obstacle.height}
            for index, (thing, obstacle) in enumerate(zip(shown.things, objects, strict=True))
        ],
        "scores": [list(moment) for moment in shown.scores],
        "thickest_m": THICKEST_M,
        "rays": names.get("rays", ""),
        "bearings": list(lidar.bearings()),
        "mount": [lidar.x_m, lidar.y_m, lidar.yaw_rad],
        "range_m": lidar.range_m,
        "solids": [_solid(solid) for solid in solids_near(scene, lidar.range_m)],
        "person": {"name": "person", "x": person.pose.x, "y": person.pose.y, "radius": person.radius},
        "walker": [PED_DEPTH_M, PED_WIDTH_M],
        "robot_radius": robot.radius_m,
        "robot_height": robot.height_m,
        "line": names["line"],
        "goal": [scene.goal.x, scene.goal.y, scene.goal_radius],
        "attention": attention,
    }
    return order, list(names.values())


def _attention(shown: ShownAttention, mesh: str, radius: float) -> Attention:
    spatial, temporal = (
        [[round(weight, 4) for weight in row] for row in rows] for rows in (shown.spatial, shown.temporal)
    )
    return {"mesh": mesh, "spatial": spatial, "temporal": temporal, "radius": radius}


def _solid(obstacle: Obstacle) -> Solid:
    x, y, yaw = obstacle.pose.x, obstacle.pose.y, obstacle.pose.yaw
    return {"name": obstacle.kind, "x": x, "y": y, "yaw": yaw, "length": obstacle.length, "width": obstacle.width}


def _add(api: viser.SceneApi, name: str, glb: bytes, at: tuple[float, float] = (0.0, 0.0)) -> None:
    api.add_glb(name, glb, position=(*at, 0.0), cast_shadow=False, receive_shadow=False)


@cache
def _ring(radius: float) -> bytes:
    """A green torus on the floor (ch. 8)."""
    around = np.linspace(-math.pi, math.pi, 13)
    tube = [(radius + RING_TUBE_M * math.cos(a), RING_TUBE_M * (1.05 + math.sin(a))) for a in around]
    return to_glb([Surface(rotate(tube, _GREEN, segments=40, smooth=True).lit(turning=True))])


@lru_cache(maxsize=256)
def _outline(obstacle: Obstacle, index: int) -> bytes:
    """An object's body twice, white and rim, marked with the way outwards of each corner: the page moves corners
    along it and shows the far sides alone, so that what sticks out behind the object is its outline.
    """
    own = furniture.piece(obstacle, index)
    hulls = [body(own, colour) for colour in (_WHITE, _RIM)]
    return to_glb([Surface(hull, marks=hull.normals) for hull in hulls])
