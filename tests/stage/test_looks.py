"""What the stage is made of, without a browser: shapes, files, floors, frames."""

from __future__ import annotations

import io
import json
import math
import os
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from desirepath.simulation.scene import Obstacle, Pose
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setup_files import read_robot, shipped_robots
from desirepath.simulation.setups import get_setup
from desirepath_stage import bodies, furniture, scene_nodes, surfaces
from desirepath_stage.glb import Surface, to_glb
from desirepath_stage.kept_files import kept
from desirepath_stage.shapes import Shape, ball, box, limb, merge, rotate
from desirepath_stage.views import CLOSEST_M, ViewError, camera_for, frame_of, holds, require_view
from tests.stage.stage_rig import drive, open_field, study_room

STUDY_ROOM = get_setup("study_room")
HUSKY = read_robot(shipped_robots()["husky_a200"])
ARROW = ((0.6, 0.0), (-0.3, 0.4), (-0.1, 0.0), (-0.3, -0.4))  # not convex


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
        rotate([(0.2, 0), (0.2, 1), (0, 1)], (1, 2, 3)),
        bodies.mannequin(),
        bodies.robot(STUDY_ROOM.robot),
        bodies.robot(HUSKY),
        bodies.robot(replace(HUSKY, radius_m=0.0, footprint=ARROW)),
        bodies.robot(replace(HUSKY, radius_m=0.0, footprint=ARROW[::-1])),
    ],
)
def test_every_triangle_shows_its_outside(shape: Shape) -> None:
    assert outward(shape).min() > 0.0
    assert shape.colours.min() >= 0
    assert shape.colours.max() <= 1


def lid_area(shape: Shape, height: float) -> float:
    """m^2 of what faces up at that height."""
    corners = shape.positions[shape.faces]
    at = np.isclose(corners[..., 2], height).all(axis=1)
    (ax, ay), (bx, by) = np.moveaxis(np.diff(corners[at][..., :2], axis=1), (1, 2), (0, 1))
    return float((ax * by - ay * bx).sum() / 2)


def test_a_robot_that_is_no_disc_has_the_body_of_its_outline_and_a_front() -> None:
    for footprint, area in ((HUSKY.footprint, 0.99 * 0.67), (ARROW, 0.28), (ARROW[::-1], 0.28)):
        robot = replace(HUSKY, radius_m=0.0, footprint=footprint)
        body = bodies.robot(robot)
        (low_x, low_y), (high_x, high_y) = np.min(footprint, axis=0), np.max(footprint, axis=0)
        assert body.positions[:, 0].min() >= low_x - 0.003
        assert body.positions[:, 0].max() <= high_x + 0.003
        assert np.abs(body.positions[:, 1]).max() == pytest.approx(max(-low_y, high_y), abs=0.003)
        assert body.positions[:, 2].max() == pytest.approx(HUSKY.height_m, abs=0.003)
        assert lid_area(body, 0.42 * HUSKY.height_m) == pytest.approx(area, rel=1e-4)
        assert bodies.front_m(robot) == pytest.approx(high_x)
    lamps = body_of_colour(bodies.robot(HUSKY), bodies.NEUTRAL.lamp)
    assert lamps[:, 0].min() > 0.45


def body_of_colour(shape: Shape, colour: tuple[int, int, int]) -> np.ndarray:
    """The corners that are as blue against red as that colour is: light is baked into the rest of it."""
    ratio = shape.colours[:, 2] / np.maximum(shape.colours[:, 0], 1e-6)
    return shape.positions[ratio > 0.9 * colour[2] / colour[0]]


def test_the_ring_and_the_lamp_s_light_fit_the_robot() -> None:
    small = read_robot(shipped_robots()["turtlebot3_waffle_pi"])
    for robot in (HUSKY, small, STUDY_ROOM.robot):
        reach = np.linalg.norm(bodies.robot_ring(robot).positions[:, :2], axis=1)
        assert robot.radius_m < reach.min() < reach.max() <= robot.radius_m + 0.1501
        lit = bodies.robot_glow(robot).positions
        assert lit[:, 0].max() > bodies.front_m(robot) + robot.radius_m


URDF = """<robot name="own"><link name="base"><visual><geometry>SHAPE</geometry>
<material name="m"><color rgba="0.8 0.1 0.1 1"/></material></visual></link></robot>"""


def test_a_robot_with_a_urdf_looks_as_that_says_and_else_as_its_footprint(tmp_path: Path) -> None:
    file = tmp_path / "own.urdf"
    own = replace(HUSKY, radius_m=0.0, footprint=HUSKY.footprint, urdf=file)
    file.write_text(URDF.replace("SHAPE", '<box size="0.4 0.3 0.2"/>'))
    shown = bodies.robot(own)
    assert np.ptp(shown.positions, axis=0) == pytest.approx([0.4, 0.3, 0.2], abs=1e-6)
    assert shown.positions[:, 2].min() == pytest.approx(0.0)
    assert outward(shown).min() > 0.99
    left, right = (bodies.robot(own, colours).colours.mean(axis=0) for colours in (bodies.LEFT, bodies.RIGHT))
    assert left[2] > right[2] + 0.1  # two robots are told apart
    file.write_text(URDF.replace("SHAPE", '<mesh filename="gone.stl"/>'))
    assert np.array_equal(bodies.robot(own).positions, bodies.robot(HUSKY).positions)


def test_a_urdf_is_read_once_until_it_changes_and_its_pictures_with_it(tmp_path: Path, monkeypatch) -> None:
    read: list[Path] = []
    reader = bodies.read_looks
    monkeypatch.setattr(bodies, "read_looks", lambda file: read.append(file) or reader(file))
    file = tmp_path / "own.urdf"
    own = replace(HUSKY, urdf=file)
    file.write_text(URDF.replace("SHAPE", '<box size="0.4 0.3 0.2"/>'))
    before = scene_nodes._robot(own, bodies.NEUTRAL)
    assert scene_nodes._robot(own, bodies.NEUTRAL) is before
    assert len(read) == 1
    file.write_text(URDF.replace("SHAPE", '<box size="0.8 0.3 0.2"/>'))
    os.utime(file, ns=(1, 1))
    assert scene_nodes._robot(own, bodies.NEUTRAL) != before
    assert len(read) == 2
    assert bodies._robot.cache_info().maxsize == 8


def test_pictures_are_kept_up_to_so_many_bytes() -> None:
    drawn: list[int] = []

    @kept(100)
    def picture(size: int, *, cut: bool) -> bytes:
        drawn.append(size)
        return bytes(size)

    for size in (40, 50, 40, 30, 40, 50, 1_000, 1_000):  # 50 goes for 30, 40 was asked for since
        assert len(picture(size, cut=True)) == size
    assert drawn == [40, 50, 30, 50, 1_000]


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
    robot = bodies.robot(STUDY_ROOM.robot).positions
    assert np.hypot(robot[:, 0], robot[:, 1]).max() == pytest.approx(STUDY_ROOM.robot.radius_m, rel=0.03)
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
    shape = merge([box((1, 1, 1), (0, 0, 0.5), (200, 100, 50)), ball((0, 0, 2), (0.3, 0.3, 0.3), (0, 0, 255))])
    picture = surfaces.tile("concrete")
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


def luminance(colour: np.ndarray | tuple[int, ...]) -> float:
    """WCAG 2.2's, of sRGB from 0 to 255."""
    share = np.clip(np.asarray(colour, float) / 255, 0, 1)
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(a: np.ndarray | tuple[int, ...], b: np.ndarray | tuple[int, ...]) -> float:
    light, dark = sorted((luminance(a), luminance(b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


CLIENT = Path(scene_nodes.__file__).parent / "client"


@pytest.mark.parametrize("floor", surfaces.MIDDLE.values())
def test_people_stand_out_from_every_floor_in_the_light_and_in_the_dark(floor: tuple[int, int, int]) -> None:
    room, people = (
        float(one) for one in re.findall(r"GOAL\] = \[([\d.]+), ([\d.]+),", CLIENT.joinpath("scheme.js").read_text())[0]
    )
    body = bodies.mannequin().colours[:, :3] * 255
    seen_from_above = body[bodies.mannequin().normals[:, 2] > 0.5].mean(axis=0)
    assert contrast(seen_from_above, floor) >= 3
    assert contrast(people * seen_from_above, room * np.asarray(floor)) >= 3


def test_words_on_the_stage_can_be_read_in_both_schemes() -> None:
    style = CLIENT.joinpath("stage.css").read_text()
    light, dark = (
        dict(re.findall(r"(--[\w-]+): ([^;]+);", part)) for part in style.split("prefers-color-scheme: dark")[:2]
    )

    def colour(text: str) -> tuple[int, ...]:
        if text.startswith("rgb"):
            return tuple(int(part) for part in re.findall(r"\d+", text)[:3])
        digits = text.removeprefix("#")
        digits = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
        return tuple(int(digits[k : k + 2], 16) for k in (0, 2, 4))

    for scheme in (light, dark):
        words = [("--ink", "--paper"), ("--soft", "--paper"), ("--on-path", "--path")]
        signs = [(name, "--paper") for name in ("--path", "--wrong", "--free", "--hit", "--sector")]
        for least, pairs in ((4.5, words), (3.0, signs)):
            for over, under in pairs:
                assert contrast(colour(scheme[over]), colour(scheme[under])) >= least, (over, under)


def test_a_figure_is_marked_by_what_swings_when_it_walks() -> None:
    marks, corners = bodies.gait_marks(1.8), bodies.mannequin(1.8).positions
    assert len(marks) == len(corners)
    for part, low, high in ((bodies.SHIN, 0.0, 0.6), (bodies.THIGH, 0.4, 1.05), (bodies.ARM, 0.85, 1.52)):
        for side in (-1, 1):
            mine = corners[(marks[:, 0] == part) & (marks[:, 1] == side)]
            assert low - 0.01 <= mine[:, 2].min() < mine[:, 2].max() <= high
            assert np.all(np.sign(mine[:, 1]) == side)


def test_a_close_frame_holds_what_matters_of_a_pair_and_no_more() -> None:
    scene = study_room()
    pair = [drive(scene, bend_m=bend) for bend in (1.0, -1.0)]
    close, whole = frame_of(scene, pair, close=True, goal=True), frame_of(scene, pair)
    assert (close[2] - close[0]) * (close[3] - close[1]) < 0.75 * (whole[2] - whole[0]) * (whole[3] - whole[1])
    for one in (scene.start, scene.goal, scene.person.pose):
        assert close[0] < one.x < close[2]
        assert close[1] < one.y < close[3]
    assert all(holds(close, one) for one in pair)
    elsewhere = replace(scene, goal=Pose(-scene.goal.x, -scene.goal.y))
    shown = [replace(one, scene=elsewhere) for one in pair]
    hidden = frame_of(elsewhere, shown, close=True)
    assert hidden == frame_of(scene, pair, close=True), "where the goal is not shown the frame tells nothing of it"
    lone = frame_of(scene, [drive(replace(scene, goal=replace(scene.start, x=scene.start.x + 0.1)))], close=True)
    assert min(lone[2] - lone[0], lone[3] - lone[1]) >= CLOSEST_M - 0.2


def test_where_nothing_stands_a_close_frame_is_closer_and_still_holds_the_ring_around_the_robot() -> None:
    hall = draw_scene("crowd_hall", 1)
    assert hall.room is not None
    pair = [drive(hall, bend_m=bend) for bend in (1.0, 4.0)]
    bare = frame_of(hall, pair, close=True, goal=True)
    furnished = replace(hall, obstacles=(Obstacle("cube", Pose(0.0, -2.5), 0.3, 0.3, 0.3),))
    filled = frame_of(furnished, [replace(one, scene=furnished) for one in pair], close=True, goal=True)
    assert bare[3] - bare[1] < filled[3] - filled[1]
    for one in pair:
        rings = np.asarray(one.poses)[:, :2]
        rings = rings[np.abs(rings[:, 1]) < hall.room.width / 2 - 1.75 * STUDY_ROOM.robot.radius_m]
        assert (rings - 1.75 * STUDY_ROOM.robot.radius_m > bare[:2]).all()
        assert (rings + 1.75 * STUDY_ROOM.robot.radius_m < bare[2:]).all()
    assert hall.room.width / 2 < bare[3] < hall.room.width / 2 + hall.room.wall_thickness, (
        "a wall is told from the floor"
    )


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
