"""A scene as viser nodes: floor, shadows, walls, furniture, person, robots.

Takes plain scenes, returns the names of what it made; poses over time are the player's business.
"""

from __future__ import annotations

import io
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
import viser
from numpy.typing import ArrayLike

from desirepath.simulation.pedestrians import where_on_route
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import own_map, solids_near
from desirepath.simulation.setups import Robot, get_setup
from desirepath_stage import bodies, furniture, surfaces
from desirepath_stage.glb import Surface, to_glb
from desirepath_stage.kept_files import MIB, kept
from desirepath_stage.shapes import Colour, Shape, disc, merge
from desirepath_stage.views import Camera, View

Detail = Literal["full", "light"]
"""`light` is for slow machines: a plain floor with the 1 m grid instead of a material with shadows."""

SHADOWS_M = 6.0  # ours: walls of a map farther from what happens cast none
BEYOND_M = 3.0  # ours: of a building around what must be in sight from above, as windows show more
GRID_LINE_M = 0.025  # width of a line of the plain floor
TRAIL_PIECES = 60  # as in client/trail.js
FIELD_SOLID_M = 12.0  # open ground is fully there up to here, from the middle of the scene
FIELD_RADIUS_M = 26.0  # and gone here

KEPT_PLACES = 256 * MIB  # a quarter of one each, of which a query set has 200, drawn in 20 ms; maps take 20
KEPT_ROBOTS = 64 * MIB  # a URDF of 100,000 triangles takes 12

Bounds = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max in metres

_drawing = threading.Lock()  # floors are drawn one at a time: twenty pages at once would need half a gigabyte


@dataclass(frozen=True)
class Nodes:
    """Names of what stands on the stage: everything with a mesh, and what moves, robots in the order asked for."""

    meshes: tuple[str, ...]
    robots: tuple[str, ...]
    person: str = ""
    crowd: tuple[str, ...] = ()


def build(
    api: viser.SceneApi,
    root: str,
    scene: Scene,
    view: View,
    camera: Camera,
    robots: tuple[bodies.RobotColours, ...],
    detail: Detail = "full",
) -> Nodes:
    """Add the scene under the node name `root`, robots at the start. Nothing tells the goal; see `add_marks`."""
    meshes = [f"{root}/place"]
    with _drawing:
        cut = view == "top_down" and _material(scene) != "concrete"
        place = place_file(scene, floor_bounds(scene, camera), detail, cut=cut)
    api.add_glb(f"{root}/place", place, cast_shadow=False, receive_shadow=False)

    if view == "immersive":
        api.add_glb(f"{root}/square", _square(), scale=0.001, position=_BELOW, cast_shadow=False, receive_shadow=False)
        meshes.append(f"{root}/square")

    if scene.has_person:
        person = scene.person
        api.add_glb(
            f"{root}/person",
            # in the other two views the participant stands there
            _person(person.height, seen=view == "top_down", sits=person.sits),
            position=(person.pose.x, person.pose.y, 0.0),
            wxyz=_about_z(person.pose.yaw),
            cast_shadow=False,
            receive_shadow=False,
        )
        meshes.append(f"{root}/person")

    crowd = []
    for index, pedestrian in enumerate(scene.crowd.pedestrians if scene.crowd else ()):
        x, y, yaw = where_on_route(pedestrian, 0.0)
        name = f"{root}/pedestrian{index}"
        api.add_glb(
            name, _pedestrian(), position=(x, y, 0.0), wxyz=_about_z(yaw), cast_shadow=False, receive_shadow=False
        )
        crowd.append(name)
    meshes += crowd

    frames, robot = [], get_setup(scene.setup).robot
    for index, colours in enumerate(robots):
        frame = f"{root}/robot{index}"
        api.add_frame(
            frame, show_axes=False, position=(scene.start.x, scene.start.y, 0.0), wxyz=_about_z(scene.start.yaw)
        )
        api.add_glb(f"{frame}/body", _robot(robot, colours), cast_shadow=False, receive_shadow=False)
        frames.append(frame)
        meshes.append(f"{frame}/body")
    return Nodes(tuple(meshes), tuple(frames), f"{root}/person" if scene.has_person else "", tuple(crowd))


def add_paths(
    api: viser.SceneApi, name: str, paths: Sequence[ArrayLike], colour: tuple[int, int, int], height: float = 0.02
) -> None:
    """Paths of one colour on the floor for analysts. paths: (n, 2 or more) each, metres; height: above the floor, m."""
    segments = np.concatenate([_segments(np.asarray(path, np.float32), height) for path in paths])
    # viser takes line colours to linear light; the page shows them unconverted, so they are sent brighter.
    encoded = tuple(round(255 * (part / 255) ** (1 / 2.2)) for part in colour)
    api.add_line_segments(name, segments, encoded, thickness=3.0, thickness_units="screen")


def _segments(path: np.ndarray, height: float) -> np.ndarray:
    """(n - 1, 2, 3): from each point of a path to the next."""
    points = np.concatenate([path[:, :2], np.full((len(path), 1), height, np.float32)], axis=1)
    return np.stack([points[:-1], points[1:]], axis=1)


def add_marks(api: viser.SceneApi, root: str, scene: Scene, robots: Sequence[str]) -> list[str]:
    """What the eye holds on to: the scene's goal, the trail that the page draws behind a robot, a ring around each.
    Returns their names. robots: names of their frames.
    """
    at = (scene.goal.x, scene.goal.y, 0.0)
    marks = [
        (f"{root}/goal", _goal(scene.goal_radius), at),
        (f"{root}/trail", squares(TRAIL_PIECES, 4, (0, 0, 0)), _HERE),
    ]
    ring = _robot_ring(get_setup(scene.setup).robot)
    marks += [(f"{robot}/ring", ring, _HERE) for robot in robots]
    for name, glb, position in marks:
        api.add_glb(name, glb, position=position, cast_shadow=False, receive_shadow=False)
    return [name for name, _, _ in marks]


_HERE = (0.0, 0.0, 0.0)
_BELOW = (0.0, 0.0, -1.0)  # the floor


@cache
def _robot_ring(robot: Robot) -> bytes:
    return to_glb([Surface(bodies.robot_ring(robot), translucent=True)])


@cache
def squares(count: int, corners: int, colour: Colour) -> bytes:
    """So many times `corners` / 4 squares, all in one place: the page moves their corners."""
    positions = np.zeros((count * corners, 3), np.float32)
    positions[:, 2] = -1.0  # under the floor until it does
    colours = np.ones((len(positions), 4), np.float32)
    colours[:, :3] = np.asarray(colour, np.float32) / 255
    first = 4 * np.arange(count * corners // 4)
    faces = np.concatenate([first[:, None] + [0, 1, 2], first[:, None] + [0, 2, 3]]).astype(np.uint32)
    return to_glb([Surface(Shape(positions, positions, colours, faces), translucent=True)])


@cache
def _goal(radius: float) -> bytes:
    ring = Surface(bodies.goal_ring(radius), translucent=True)
    return to_glb([ring, _shade(0.22, 0.007, 0.5), Surface(bodies.goal_cone())])


@cache
def _square() -> bytes:
    """A white square with a picture, a metre wide: the page makes panels for a headset of it."""
    from PIL import Image  # as in surfaces.py

    picture = io.BytesIO()
    Image.new("RGB", (1, 1), "white").save(picture, "PNG")
    shape = _rectangle((-0.5, -0.5, 0.5, 0.5))
    return to_glb([Surface(shape, uv=_RECTANGLE_UV, image=picture.getvalue(), translucent=True)])


def _shade(radius: float, height: float, alpha: float) -> Surface:
    """The contact shadow under what stands on the floor, m."""
    return Surface(disc(radius, height, bodies.SHADE, alpha=alpha, rim_alpha=0.0), translucent=True)


def _robot(robot: Robot, colours: bodies.RobotColours) -> bytes:
    return _robot_file(robot, colours, bodies.changed(robot))


@kept(KEPT_ROBOTS)
def _robot_file(robot: Robot, colours: bodies.RobotColours, changed: tuple[int, int]) -> bytes:
    return to_glb([Surface(bodies.robot_glow(robot, colours), translucent=True), Surface(bodies.robot(robot, colours))])


@cache
def _person(height: float, *, seen: bool, sits: bool) -> bytes:
    """The person's place, and the person on it when they are `seen`."""
    marks = [Surface(bodies.person_place(facing=seen), translucent=True)]
    if seen:
        marks.insert(0, _shade(0.34, 0.008, 0.55))
        figure = Surface(bodies.mannequin(height), marks=bodies.gait_marks(height))
        marks.append(Surface(bodies.seated()) if sits else figure)
    return to_glb(marks)


@cache
def _pedestrian() -> bytes:
    """Somebody of the crowd: seen in every view, without the mark of the participant's place."""
    return to_glb([_shade(0.34, 0.008, 0.55), Surface(bodies.mannequin(), marks=bodies.gait_marks())])


def _about_z(yaw: float) -> tuple[float, float, float, float]:
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


@kept(KEPT_PLACES)
def place_file(scene: Scene, bounds: Bounds, detail: Detail, *, cut: bool) -> bytes:
    """Floor, furniture and walls; `cut` low for the view from above. Kept, as participants share their queries."""
    shapes = [furniture.piece(obstacle, index, cut=cut) for index, obstacle in enumerate(scene.obstacles)]
    if scene.room is not None:
        shapes.append(furniture.room_walls(scene.room, cut=cut))
    here = own_map(scene)
    if here is not None:
        shapes.append(furniture.map_walls(here, cut=cut))
    standing = [Surface(merge(shapes))] if shapes else []
    return to_glb([*(_ground(scene, bounds) if detail == "full" else plain_ground(scene, bounds)), *standing])


def floor_bounds(scene: Scene, camera: Camera) -> Bounds:
    """How far the floor reaches: to the walls; in the open, as far as the view from above shows; in a building, with
    shadows of walls, a little farther."""
    if scene.room is None:
        x_min, y_min, x_max, y_max = camera.frame
        more = BEYOND_M if _material(scene) == "linoleum" else 0.0
        return x_min - more, y_min - more, x_max + more, y_max + more
    half_x, half_y = scene.room.length / 2, scene.room.width / 2
    return -half_x, -half_y, half_x, half_y


def _ground(scene: Scene, bounds: Bounds) -> list[Surface]:
    """The floor with its shadows; in the open, ground around it that fades out."""
    material = _material(scene)
    picture = surfaces.floor(material, solids_near(scene, SHADOWS_M), bounds)
    ground = [Surface(_rectangle(bounds), uv=_RECTANGLE_UV, image=picture)]
    if scene.room is None:
        around = _fading_ground(bounds)
        uv = (around.positions[:, :2] * [1, -1] / surfaces.TILE_M).astype(np.float32)
        ground.append(Surface(around, uv=uv, image=surfaces.tile(material), repeat=True, translucent=True))
    return ground


def _material(scene: Scene) -> surfaces.Material:
    """Wood in rooms, concrete in the open; in a building of which nothing says what its floor is like, linoleum."""
    if scene.room is not None:
        return "wood"
    walled = scene.ground is not None or any(obstacle.kind == "wall" for obstacle in scene.obstacles)
    return "linoleum" if walled else "concrete"


def plain_ground(scene: Scene, bounds: Bounds) -> list[Surface]:
    """The floor in one colour with a line every metre."""
    colour = surfaces.MIDDLE[_material(scene)]
    x_min, y_min, x_max, y_max = bounds
    half = GRID_LINE_M / 2
    lines = [(x - half, y_min, x + half, y_max) for x in range(math.ceil(x_min), math.floor(x_max) + 1)]
    lines += [(x_min, y - half, x_max, y + half) for y in range(math.ceil(y_min), math.floor(y_max) + 1)]
    darker = tuple(round(0.88 * part) for part in colour)
    grid = [_coloured(line, darker, height=0.003) for line in lines]
    return [Surface(merge([_coloured(bounds, colour), *grid]))]


def _coloured(bounds: Bounds, colour: tuple[int, ...], height: float = 0.0) -> Shape:
    """A rectangle of one colour (0 to 255) so high (m) above the floor."""
    white = _rectangle(bounds)
    tint = np.asarray([*(part / 255 for part in colour), 1.0], np.float32)
    raised = white.positions + np.asarray([0.0, 0.0, height], np.float32)
    return replace(white, positions=raised, colours=white.colours * tint)


_RECTANGLE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # glTF counts rows from the top


def _rectangle(bounds: Bounds) -> Shape:
    """A white rectangle on the floor, facing up."""
    x_min, y_min, x_max, y_max = bounds
    corners = [[x_min, y_min, 0.0], [x_max, y_min, 0.0], [x_max, y_max, 0.0], [x_min, y_max, 0.0]]
    return Shape(
        np.asarray(corners, np.float32),
        np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        np.ones((4, 4), np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
    )


def _fading_ground(bounds: Bounds) -> Shape:
    """White ground outside `bounds` that turns transparent far away, so that it has no edge."""
    x_min, y_min, x_max, y_max = bounds
    middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2])
    half = np.array([(x_max - x_min) / 2, (y_max - y_min) / 2])
    corners = [math.atan2(sy * half[1], sx * half[0]) for sx in (-1, 1) for sy in (-1, 1)]
    angles = np.unique(np.concatenate([np.linspace(-math.pi, math.pi, 48, endpoint=False), corners]))
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    to_edge = np.min(half / np.maximum(np.abs(directions), 1e-9), axis=1, keepdims=True)
    solid, far = np.maximum(FIELD_SOLID_M, to_edge), np.maximum(FIELD_RADIUS_M, to_edge + 5.0)
    rings = [middle + directions * reach for reach in (to_edge, solid, far)]
    count = len(angles)
    positions = np.concatenate([np.concatenate(rings), np.zeros((3 * count, 1))], axis=1).astype(np.float32)
    colours = np.ones((3 * count, 4), np.float32)
    colours[2 * count :, 3] = 0.0
    row = np.arange(count)
    following = (row + 1) % count
    faces = [
        face
        for first in (0, count)
        for face in (
            np.stack([first + row, first + count + row, first + count + following], axis=1),
            np.stack([first + row, first + count + following, first + following], axis=1),
        )
    ]
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(positions), 1))
    return Shape(positions, normals, colours, np.concatenate(faces).astype(np.uint32))
