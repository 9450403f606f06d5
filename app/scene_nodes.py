"""A scene as viser nodes: floor, shadows, walls, furniture, person, robots.

Takes plain scenes, returns the names of what it made; poses over time are the player's business.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import viser

from app import figures, furniture, surfaces
from app.glb import Surface, to_glb
from app.shapes import Shape, box, disc, merged
from app.views import Camera, View
from backend.simulation.scene import Pose, Scene

FIELD_RADIUS_M = 26.0  # open ground fades out here
_FIELD_SOLID_M = 12.0  # and is fully there up to here


@dataclass(frozen=True)
class Nodes:
    """Names of what stands on the stage: everything with a mesh, and the frames that move, in the order asked for."""

    meshes: tuple[str, ...]
    robots: tuple[str, ...]


def build(
    api: viser.SceneApi, root: str, scene: Scene, view: View, camera: Camera, robots: tuple[figures.RobotColours, ...]
) -> Nodes:
    """Add the scene under the node name `root`, robots at the start. Nothing tells start or goal."""
    meshes = [f"{root}/place"]
    ground = [*_ground(scene, camera), _standing(scene, view)]
    api.add_glb(f"{root}/place", to_glb(ground), cast_shadow=False, receive_shadow=False)

    person = scene.person
    turn = _about_z(person.pose.yaw)
    spot = (person.pose.x, person.pose.y, 0.0)
    marks = [Surface(figures.person_place(), translucent=True)]
    if view == "top_down":  # in the other two the participant stands there
        marks.insert(0, Surface(disc(0.34, 0.008, (38, 26, 18), alpha=0.55, rim_alpha=0.0), translucent=True))
        marks.append(Surface(figures.mannequin(person.height)))
    api.add_glb(f"{root}/person", to_glb(marks), position=spot, wxyz=turn, cast_shadow=False, receive_shadow=False)
    meshes.append(f"{root}/person")

    frames = []
    for index, colours in enumerate(robots):
        frame = f"{root}/robot{index}"
        api.add_frame(
            frame, show_axes=False, position=(scene.start.x, scene.start.y, 0.0), wxyz=_about_z(scene.start.yaw)
        )
        body = [Surface(figures.robot_glow(colours), translucent=True), Surface(figures.robot(colours))]
        api.add_glb(f"{frame}/body", to_glb(body), cast_shadow=False, receive_shadow=False)
        frames.append(frame)
        meshes.append(f"{frame}/body")
    return Nodes(tuple(meshes), tuple(frames))


def add_path(api: viser.SceneApi, name: str, poses: np.ndarray, colour: tuple[int, int, int]) -> None:
    """A path on the floor for analysts. poses: (N, 3) metres and radians."""
    points = np.concatenate([poses[:, :2], np.full((len(poses), 1), 0.02)], axis=1).astype(np.float32)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    api.add_line_segments(name, segments, colour, thickness=3.0, thickness_units="screen")


def _about_z(yaw: float) -> tuple[float, float, float, float]:
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def _standing(scene: Scene, view: View) -> Surface:
    """Furniture and walls as one mesh; walls are cut low for the view from above."""
    shapes = [furniture.piece(obstacle, index) for index, obstacle in enumerate(scene.obstacles)]
    if scene.room is not None:
        shapes.append(furniture.room_walls(scene.room, cut=view == "top_down"))
    if not shapes:  # an empty field still needs a mesh here, or the page would wait for it
        shapes = [box((0.001, 0.001, 0.001), (0.0, 0.0, -0.01), (0, 0, 0))]
    return Surface(merged(shapes))


def _ground(scene: Scene, camera: Camera) -> list[Surface]:
    """The floor and the shadow picture that lies on it."""
    if scene.room is not None:
        half_x, half_y = scene.room.length / 2, scene.room.width / 2
        bounds = (-half_x, -half_y, half_x, half_y)
        floor = _rectangle(bounds, 0.0)
        image = surfaces.wood_tile()
    else:
        bounds = camera.frame
        middle = Pose((bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2)
        floor = _fading_disc().moved(middle.x, middle.y)
        image = surfaces.concrete_tile()
    x_min, y_min, x_max, y_max = bounds
    shade = _rectangle(bounds, 0.004)
    spread = (shade.positions[:, :2] - [x_min, y_min]) / [x_max - x_min, y_max - y_min]
    return [
        Surface(
            floor,
            uv=(floor.positions[:, :2] / surfaces.TILE_M).astype(np.float32),
            image=image,
            repeat=True,
            translucent=scene.room is None,
        ),
        Surface(
            shade,
            uv=np.stack([spread[:, 0], 1.0 - spread[:, 1]], axis=1).astype(np.float32),
            image=surfaces.shadow(scene.solids(), bounds),
            translucent=True,
        ),
    ]


def _rectangle(bounds: tuple[float, float, float, float], height: float) -> Shape:
    """A white rectangle on the floor, facing up."""
    x_min, y_min, x_max, y_max = bounds
    corners = [[x_min, y_min, height], [x_max, y_min, height], [x_max, y_max, height], [x_min, y_max, height]]
    return Shape(
        np.asarray(corners, np.float32),
        np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        np.ones((4, 4), np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
    )


def _fading_disc() -> Shape:
    """White ground about the origin that turns transparent towards its rim, so that it has no edge."""
    segments = 48
    angles = np.linspace(0, 2 * math.pi, segments, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(segments)], axis=1).astype(np.float32)
    positions = np.concatenate([np.zeros((1, 3), np.float32), ring * _FIELD_SOLID_M, ring * FIELD_RADIUS_M])
    colours = np.ones((len(positions), 4), np.float32)
    colours[segments + 1 :, 3] = 0.0
    row = np.arange(segments)
    following = (row + 1) % segments
    inner, outer = row + 1, row + 1 + segments
    inner_next, outer_next = following + 1, following + 1 + segments
    faces = np.concatenate(
        [
            np.stack([np.zeros(segments, int), inner, inner_next], axis=1),
            np.stack([inner, outer, outer_next], axis=1),
            np.stack([inner, outer_next, inner_next], axis=1),
        ]
    )
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(positions), 1))
    return Shape(positions, normals, colours, faces.astype(np.uint32))
