"""The depth camera: what it sees of known things, the same as PyBullet's renderer, and a real camera's noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.simulation.depth_camera import (
    DEPTH_CAMERA,
    WIDE_CAMERA,
    CameraNoise,
    DepthCamera,
    Sights,
)
from desirepath.simulation.depth_shapes import UprightBox, parts_of
from desirepath.simulation.scene import Obstacle, Person, Pose, Room, Scene
from desirepath.simulation.scenes import draw_scenes
from tests.simulation.reference_camera import ReferenceCamera

EMPTY = Scene(
    setup="home",
    seed=0,
    start=Pose(0.0, 0.0),
    goal=Pose(2.0, 0.0),
    goal_radius=0.3,
    person=Person(Pose(-3.0, 0.0)),  # behind the robot
    room=Room(10.0, 8.0),
)
AXIS_ROW, AXIS_COLUMN = 39, 64  # just above, just right of the camera's axis


def person_of(scene: Scene) -> np.ndarray:
    """(4,) where the scene's person stands at first, and how tall they are."""
    pose = scene.person.pose
    return np.array([pose.x, pose.y, pose.yaw, scene.person.height])


def depth_frame(scene: Scene, pose: tuple[float, ...], camera: DepthCamera = DEPTH_CAMERA) -> np.ndarray:
    """(rows, columns) what the camera sees of the scene from a robot's pose x, y (m), yaw (rad)."""
    taken = Sights([scene]).pictures(camera, np.asarray(pose, dtype=np.float64)[None], person_of(scene)[None])
    first: np.ndarray = taken[0]
    return first


def at_origin(scene: Scene, camera: DepthCamera = DEPTH_CAMERA) -> np.ndarray:
    return depth_frame(scene, (-camera.ahead_m, 0.0, 0.0), camera)


def test_a_picture_has_the_thesiss_size_angle_and_range():
    frame = at_origin(EMPTY)
    assert frame.shape == (80, 128)
    assert math.degrees(2 * math.atan(DEPTH_CAMERA.lens.left[0] + 0.5 / DEPTH_CAMERA.focal_px)) == pytest.approx(87)
    assert frame.max() <= 6.0
    assert frame[AXIS_ROW, AXIS_COLUMN] == pytest.approx(5.0)  # the wall


def test_the_floor_is_seen_where_geometry_says():
    below = at_origin(EMPTY)[79, AXIS_COLUMN]
    assert below == pytest.approx(DEPTH_CAMERA.height_m * DEPTH_CAMERA.focal_px / 39.5, rel=1e-6)


def test_a_box_has_its_face_its_top_and_its_edge_where_they_are():
    box = Obstacle("box", Pose(2.0, 0.0), 0.5, 1.0, 0.2)  # lower than the camera
    frame = at_origin(replace(EMPTY, obstacles=(box,)))
    face = np.isclose(frame, 1.75)
    rows, columns = np.nonzero(face)
    top = 39.5 - DEPTH_CAMERA.focal_px * (0.2 - DEPTH_CAMERA.height_m) / 1.75
    assert rows.min() == math.ceil(top)
    assert len(set(columns)) == pytest.approx(DEPTH_CAMERA.focal_px / 1.75, abs=1)  # 1 m wide
    above = frame[rows.min() - 1, AXIS_COLUMN]  # on its top
    assert 1.75 < above < 2.25


def test_under_a_table_one_sees_through_between_its_legs():
    table = Obstacle("table", Pose(2.0, 0.0), 1.4, 0.8, 0.75)
    frame = at_origin(replace(EMPTY, obstacles=(table,)))
    assert frame[AXIS_ROW, AXIS_COLUMN] == pytest.approx(5.0)
    assert frame[AXIS_ROW].min() == pytest.approx(2.0 - 0.62 - 0.035)  # a leg


def test_the_person_is_as_tall_as_they_are_and_no_cylinder():
    standing = replace(EMPTY, person=Person(Pose(3.0, 0.0, math.pi), height=1.7))
    without = at_origin(EMPTY)
    for height in (1.5, 1.9):
        frame = at_origin(replace(standing, person=replace(standing.person, height=height)))
        rows, columns = np.nonzero(frame != without)
        head = 39.5 - DEPTH_CAMERA.focal_px * (height - DEPTH_CAMERA.height_m) / 3.0
        assert rows.min() == pytest.approx(head, abs=1.5)
        widths = [len(set(columns[rows == row])) for row in (rows.min() + 2, 25, 45)]
        assert widths[0] < widths[1]  # a head is narrower than a trunk with arms
    beside = depth_frame(replace(standing, person=Person(Pose(3.0, 0.0, math.pi / 2))), (0.0, 0.0, 0.0))
    before = depth_frame(standing, (0.0, 0.0, 0.0))
    assert (beside != without).sum() < (before != without).sum()  # from the side one is narrower


def test_what_is_seen_of_furniture_is_inside_what_the_robot_collides_with():
    for obstacle in draw_scenes("home", [5])[0].obstacles:
        for part in parts_of(obstacle):
            half = (part.length / 2, part.width / 2) if isinstance(part, UprightBox) else (part.radius, part.radius)
            assert abs(part.x) + half[0] <= obstacle.length / 2 + 1e-9
            assert abs(part.y) + half[1] <= obstacle.width / 2 + 1e-9
            assert 0.0 <= part.low < part.high <= obstacle.height + 1e-9


def test_nobody_is_seen_where_nobody_is():
    sights, pose = Sights([EMPTY]), np.zeros((1, 3))
    person = np.array([[2.0, 0.0, 0.0, 1.7]])
    with_person = sights.pictures(DEPTH_CAMERA, pose, person)
    alone = sights.pictures(DEPTH_CAMERA, pose, np.full((1, 4), np.nan))
    assert (with_person < alone).any()
    assert not (with_person > alone).any()


def test_in_view_is_what_lies_within_angle_and_range():
    poses = np.zeros((4, 3))
    people = np.array([[3.0, 0.0], [3.0, 3.5], [-1.0, 0.0], [6.5, 0.0]])
    assert DEPTH_CAMERA.sees(poses, people).tolist() == [True, False, False, False]
    assert WIDE_CAMERA.sees(poses, people).tolist() == [True, True, False, False]


@pytest.mark.parametrize("camera", [DEPTH_CAMERA, WIDE_CAMERA])
def test_pybullets_renderer_sees_the_same(camera: DepthCamera):
    scenes = draw_scenes("home", range(3))
    people = np.array([person_of(scene) for scene in scenes])
    poses = np.array([[s.start.x, s.start.y, math.atan2(*(people[i, :2] - (s.start.x, s.start.y))[::-1])]
                      for i, s in enumerate(scenes)])  # fmt: skip
    ours = Sights(scenes).pictures(camera, poses, people)
    with ReferenceCamera(camera) as reference:
        for scene, pose, frame in zip(scenes, poses, ours, strict=True):
            reference.build(scene)
            apart = np.abs(reference.picture(pose.tolist()) - frame)
            assert np.median(apart) < 1e-4
            assert (apart > 0.05).mean() < 0.01


def test_noise_grows_with_distance_loses_pixels_and_comes_back_with_its_seed():
    noise, camera = CameraNoise(), DEPTH_CAMERA
    clean = np.full((40, 80, 128), 2.0, dtype=np.float32)
    clean[20:] = 4.0
    clean[:, :, 100:] = 0.2  # nearer than anything is found
    seen = noise.applied(clean, camera, np.random.default_rng(1))
    assert (seen == noise.applied(clean, camera, np.random.default_rng(1))).all()
    assert (seen[:, :, 100:] == 0).all()
    near, far = seen[:20, :, :90], seen[20:, :, :90]
    assert (near == 0).mean() == pytest.approx(0.05, abs=0.005)
    assert near[near > 0].std() == pytest.approx(0.0016 * 4, rel=0.1)
    assert far[far > 0].std() == pytest.approx(0.0016 * 16, rel=0.1)
    assert (seen[:, :, 98:100] == 0).mean() > 0.4  # beside the jump
