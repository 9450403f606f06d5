"""What the stage is made of, without a browser: shapes, files, floors, frames."""

from __future__ import annotations

import io
import json
import math
import struct

import numpy as np
import pytest
from PIL import Image

from app import bodies, furniture, scene_nodes, surfaces
from app.glb import Surface, to_glb
from app.shapes import Shape, ball, box, limb, merged, turned
from app.views import ViewError, camera_for, frame_of, require_view
from backend.simulation.scene import Obstacle, Pose
from backend.simulation.scenes import draw_scene
from backend.simulation.setups import ROBOT_RADIUS_M
from tests.app.stage_rig import drive, open_field, study_room


def test_a_light_place_has_no_picture_and_still_a_line_every_metre() -> None:
    scene = study_room()
    camera = camera_for(scene, "top_down")
    bounds = scene_nodes.floor_bounds(scene, camera)
    (floor,) = scene_nodes.plain_ground(scene, bounds)
    assert floor.image is None
    lines = len(floor.shape.faces) // 2 - 1
    assert lines == sum(
        len(range(math.ceil(a), math.floor(b) + 1)) for a, b in zip(bounds[:2], bounds[2:], strict=True)
    )
    full, light = (len(scene_nodes.place_file(scene, bounds, detail, cut=True)) for detail in ("full", "light"))
    assert light < full / 2


def outward(shape: Shape) -> np.ndarray:
    """For every triangle: how far its winding agrees with its own normals."""
    corners = shape.positions[shape.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    solid = area > 1e-9
    return np.einsum("ij,ij->i", normal[solid] / area[solid, None], shape.normals[shape.faces[solid, 0]])


@pytest.mark.parametrize(
    "shape",
    [
        box((1, 2, 3), (0, 0, 0), (1, 2, 3)),
        ball((0, 0, 1), (0.1, 0.2, 0.3), (1, 2, 3)),
        limb((0, 0, 0), (1, 0.3, 0.2), 0.1, 0.05, (1, 2, 3)),
        turned([(0.2, 0), (0.2, 1), (0, 1)], (1, 2, 3)),
        bodies.mannequin(),
        bodies.robot(),
    ],
)
def test_every_triangle_shows_its_outside(shape: Shape) -> None:
    assert outward(shape).min() > 0.0
    assert shape.colours.min() >= 0
    assert shape.colours.max() <= 1


@pytest.mark.parametrize("kind", ["box", "pillar", "cube", "wall"])
@pytest.mark.parametrize("size", [(0.8, 1.6, 1.2), (0.3, 0.3, 2.0), (0.5, 0.6, 0.55)])
def test_furniture_stays_inside_what_the_robot_collides_with(kind: str, size: tuple[float, float, float]) -> None:
    for index in range(3):
        obstacle = Obstacle(kind, Pose(0.0, 0.0, 0.0), *size)
        made = furniture.piece(obstacle, index)
        half = np.array([size[0] / 2, size[1] / 2])
        assert np.all(np.abs(made.positions[:, :2]) <= half + 1e-5)
        assert made.positions[:, 2].min() >= -1e-6
        assert made.positions[:, 2].max() <= size[2] + 1e-5
        turned_piece = furniture.piece(Obstacle(kind, Pose(1.0, 2.0, math.pi / 2), *size), index)
        assert np.all(np.abs(turned_piece.positions[:, :2] - [1.0, 2.0]) <= half[::-1] + 1e-5)


def test_what_stands_in_a_home_stays_inside_what_the_robot_collides_with_and_inner_walls_are_cut_from_above() -> None:
    for obstacle in draw_scene("home", 5).obstacles:
        here = Obstacle(obstacle.kind, Pose(0.0, 0.0, 0.0), obstacle.length, obstacle.width, obstacle.height)
        made = furniture.piece(here, 0).positions
        assert np.all(np.abs(made[:, :2]) <= np.array([here.length, here.width]) / 2 + 0.005), obstacle.kind
        assert made[:, 2].min() >= -1e-6
        assert made[:, 2].max() <= here.height + 0.005
        if obstacle.kind == "wall":
            low = furniture.piece(here, 0, cut=True).positions[:, 2].max()
            assert low == pytest.approx(furniture.CUT_WALL_HEIGHT_M)


def test_robot_and_person_have_their_size_and_a_front() -> None:
    robot = bodies.robot().positions
    assert np.hypot(robot[:, 0], robot[:, 1]).max() == pytest.approx(ROBOT_RADIUS_M, rel=0.03)
    person = bodies.mannequin(1.8).positions
    assert person[:, 2].max() == pytest.approx(1.8, abs=0.03)
    assert person[:, 0].max() > 1.5 * -person[:, 0].min(), "nose, hands and feet reach forward"


def test_from_above_walls_are_cut_so_that_they_hide_nothing() -> None:
    room = study_room().room
    assert room is not None
    assert furniture.room_walls(room, cut=True).positions[:, 2].max() <= furniture.CUT_WALL_HEIGHT_M
    full = furniture.room_walls(room, cut=False).positions
    assert full[:, 2].max() == pytest.approx(room.wall_height)


def test_glb_is_a_file_that_others_read() -> None:
    trimesh = pytest.importorskip("trimesh")
    shape = merged([box((1, 1, 1), (0, 0, 0.5), (200, 100, 50)), ball((0, 0, 2), (0.3, 0.3, 0.3), (0, 0, 255))])
    picture = surfaces.concrete_tile()
    uv = shape.positions[:, :2]
    data = to_glb([Surface(shape), Surface(shape, uv=uv, image=picture, repeat=True, translucent=True)])
    magic, version, length = struct.unpack("<III", data[:12])
    assert (magic, version, length) == (0x46546C67, 2, len(data))
    size = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + size])
    assert document["materials"][1]["alphaMode"] == "BLEND"
    scene = trimesh.load(io.BytesIO(data), file_type="glb")
    assert len(scene.geometry) == 2
    assert np.allclose(scene.bounds, [[-0.5, -0.5, 0], [0.5, 0.5, 2.3]], atol=1e-5)
    with pytest.raises(ValueError, match=r"'uv'"):
        to_glb([Surface(shape, image=picture)])


def test_the_floor_is_darker_where_things_stand() -> None:
    scene = study_room()
    bounds = (-4.0, -5.5, 4.0, 5.5)
    picture = np.asarray(Image.open(io.BytesIO(surfaces.floor("wood", scene.solids(), bounds))).convert("L"), float)
    rows, columns = picture.shape
    assert columns / rows == pytest.approx(8 / 11, rel=0.01)

    def brightness(x: float, y: float) -> float:
        row, column = int((5.5 - y) / 11 * rows), int((x + 4.0) / 8 * columns)
        return float(picture[max(0, row - 8) : row + 8, max(0, column - 8) : column + 8].mean())

    obstacle = scene.obstacles[0].pose
    assert brightness(obstacle.x, obstacle.y) < 0.75 * brightness(0.0, -1.0)
    assert brightness(-3.97, 0.0) < 0.9 * brightness(0.0, -1.0)


def test_a_frame_holds_the_room_or_all_that_happens_in_the_open() -> None:
    room = frame_of(study_room())
    assert room[0] < -4.0
    assert room[3] > 5.5
    scene = open_field()
    wide = drive(scene, bend_m=6.0)
    frame = frame_of(scene, [wide])
    assert frame[0] < wide.poses[:, 0].min()
    assert frame[3] > wide.poses[:, 1].max()
    assert frame_of(scene)[3] < frame[3]


def test_cameras_stand_where_the_view_says() -> None:
    scene = study_room()
    person = scene.person.pose
    for view in ("first_person", "immersive"):
        camera = camera_for(scene, require_view(view))
        assert camera.eye == (person.x, person.y, scene.person.eye_height_m)
    assert camera_for(scene, "first_person").fov_rad == pytest.approx(math.radians(60))
    with pytest.raises(ViewError, match=r"'vr'.*top_down, first_person, immersive"):
        require_view("vr")
