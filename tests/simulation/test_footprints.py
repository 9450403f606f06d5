"""Robots that are no discs, lidars that do not look all round or sit elsewhere, speeds that change at a limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.simulation import kernels as k
from desirepath.simulation.fast import FastEngine, beams_of, clearance_m, outline_of, table_of
from desirepath.simulation.reference import ReferenceEngine
from desirepath.simulation.scene import Obstacle, Person, Pose, Room, Scene
from desirepath.simulation.scenes import draw_scenes, scene_to_row
from desirepath.simulation.setup_files import read_robot, shipped_robots
from desirepath.simulation.setups import Lidar, Limits, Robot, Setup, SetupError, get_setup
from desirepath.simulation.trajectory import Outcome

BOX = ((0.5, 0.3), (-0.5, 0.3), (-0.5, -0.3), (0.5, -0.3))
ARROW = ((0.6, 0.0), (-0.3, 0.4), (-0.1, 0.0), (-0.3, -0.4))  # not convex
PLAIN = get_setup("study_room")


def shaped(footprint=None, **lidar: float) -> Setup:
    robot = PLAIN.robot
    body = replace(robot, lidar=replace(robot.lidar, **lidar))
    if footprint is not None:
        body = replace(body, radius_m=0.0, footprint=footprint)
    return replace(PLAIN, robot=body)


def scene_with(*obstacles: Obstacle, start: Pose = Pose(0, 0), person: Pose = Pose(3, 3)) -> Scene:  # noqa: B008
    return Scene("study_room", 1, start, Pose(-3, -3), 0.3, Person(person), obstacles, Room(10, 10))


def driven(setup: Setup, scene: Scene, action: tuple[float, float], steps: int) -> FastEngine:
    engine = FastEngine(setup, 1, auto_reset=False, scenes=[scene])
    for _ in range(steps):
        engine.step(np.array([action], dtype=np.float32))
    return engine


@pytest.mark.parametrize("outline", [BOX, ARROW])
def test_the_gap_to_boxes_is_the_smallest_distance_of_any_two_points(outline):
    """Against points along both outlines, laid a centimetre apart."""
    random, corners = np.random.default_rng(2), np.array(outline)
    for _ in range(60):
        at = random.uniform(-2, 2, 2)
        box = Obstacle("box", Pose(*at, random.uniform(0, 3)), random.uniform(0.2, 1), random.uniform(0.2, 1), 1.0)
        row = scene_to_row(replace(scene_with(box), room=None))
        pose = (random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-3, 3))
        body = k.body_corners(corners, *pose)
        gap = k.body_surface_gap(row, body)
        points = along(body)
        by_hand = min(float(box.distance_m(points[:, 0], points[:, 1]).min()), 10.0)
        if by_hand > 0:
            assert gap == pytest.approx(by_hand, abs=0.006)
        else:
            assert gap <= 0


def along(corners: np.ndarray) -> np.ndarray:
    """(n, 2) points every centimetre of an outline."""
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return np.concatenate([a + np.linspace(0, 1, 1 + int(math.dist(a, b) / 0.01))[:, None] * (b - a) for a, b in sides])


def test_a_long_robot_stops_with_its_front_at_the_wall_and_a_round_one_with_its_middle_nearer():
    ahead = replace(scene_with(), start=Pose(3, 0, 0))
    long, round_one = (driven(shaped(body), ahead, (1, 0), 20) for body in (BOX, None))
    assert long.outcomes[0] == round_one.outcomes[0] == Outcome.COLLISION
    assert long.poses[0, 0] == pytest.approx(4.5, abs=0.002)
    assert round_one.poses[0, 0] == pytest.approx(4.82, abs=0.002)


def test_it_turns_where_its_corners_have_room_and_not_where_they_touch():
    """Its half diagonal is 0.583 m."""
    for apart, hits in ((0.60, False), (0.57, True)):
        beside = Obstacle("wall", Pose(0, apart + 0.1), 4.0, 0.2, 2.0)
        engine = driven(shaped(BOX), scene_with(beside), (-1, 1), 5)
        assert (engine.outcomes[0] == Outcome.COLLISION) == hits
        if hits:
            assert 0 <= clearance_m_of(shaped(BOX), scene_with(beside), engine) < 0.002


def clearance_m_of(setup: Setup, scene: Scene, engine: FastEngine) -> float:
    body = k.body_corners(outline_of(setup), *engine.poses[0])
    return float(k.body_surface_gap(scene_to_row(scene), body))


def test_it_passes_a_gap_lengthwise_that_its_circle_does_not():
    walls = [Obstacle("wall", Pose(1.0, side * (0.4 + 0.5)), 1.0, 1.0, 2.0) for side in (-1, 1)]
    engine = driven(shaped(BOX), scene_with(*walls, start=Pose(-0.5, 0, 0)), (1, 0), 15)
    assert engine.outcomes[0] == Outcome.RUNNING
    assert engine.poses[0, 0] == pytest.approx(2.5, abs=1e-6)
    assert engine.min_clearance[0] == pytest.approx(0.1, abs=1e-3)


def test_it_hits_the_person_with_its_side():
    scene = scene_with(start=Pose(0, 0, 0), person=Pose(0.9, 0.55))
    engine = driven(shaped(BOX), scene, (1, 0), 10)
    assert engine.outcomes[0] == Outcome.COLLISION
    body = k.body_corners(np.array(BOX), *engine.poses[0])
    assert 0 <= k.body_person_gap(scene_to_row(scene), body) < 0.002


def test_a_robot_of_many_corners_drives_as_the_disc_that_it_is():
    turns = np.linspace(0, 2 * math.pi, 40, endpoint=False)
    disc = tuple((0.18 * math.cos(turn), 0.18 * math.sin(turn)) for turn in turns)
    scenes = draw_scenes("study_room", range(20))
    random = np.random.default_rng(5)
    engines = [FastEngine(shaped(body), 20, auto_reset=False, scenes=scenes) for body in (None, disc)]
    for _ in range(150):
        actions = random.uniform(-1, 1, (20, 2)).astype(np.float32)
        for engine in engines:
            engine.step(actions)
    one, other = engines
    assert (one.outcomes == Outcome.COLLISION).sum() > 5
    assert (one.outcomes == other.outcomes).mean() >= 0.9
    same = one.outcomes == other.outcomes
    assert np.abs(one.min_clearance - other.min_clearance)[same].max() < 0.004


def test_a_lidar_that_looks_ahead_sees_those_sectors_of_one_that_looks_all_round():
    scene = draw_scenes("study_room", [4])[0]
    whole, ahead = shaped(), shaped(field_of_view_rad=1.5 * math.pi, beams=540, sectors=54)
    all_round = replace(whole, robot=replace(whole.robot, lidar=replace(whole.robot.lidar, beams=720, sectors=72)))
    seen = [FastEngine(one, 1, scenes=[scene]).observations[0, one.polar_size :] for one in (all_round, ahead)]
    assert len(seen[1]) == 54
    assert (seen[1] == np.concatenate([seen[0][:27], seen[0][-27:]])).all()
    assert ahead.robot.lidar.bearings()[:2] == pytest.approx((0, math.radians(0.5)))
    assert ahead.robot.lidar.bearings()[-1] == pytest.approx(math.radians(359.5))
    assert max(ahead.robot.lidar.middles()) - math.radians(225) == pytest.approx(math.radians(132.5))


def test_a_lidar_that_is_mounted_ahead_measures_from_there():
    scene = scene_with(start=Pose(0, 0, 0))
    forward, back = (
        k.seen_ranges(scene_to_row(scene), 0.0, 0.0, 0.0, beams_of(shaped(**mount), pooled=False))
        for mount in ({"x_m": 0.3}, {"yaw_rad": math.pi})
    )
    assert forward[0] == pytest.approx(4.7)
    assert forward[180] == pytest.approx(5.0 / math.cos(0), abs=1e-6)
    assert back[0] == pytest.approx(5.0)


def scans(setup: Setup, scenes: list[Scene], steps: int = 12) -> np.ndarray:
    """(steps + 1, n, sectors) what robots that drive straight on see, m."""
    engine = FastEngine(setup, len(scenes), auto_reset=False, scenes=scenes)
    seen = [engine.observations[:, setup.polar_size :].copy()]
    for _ in range(steps):
        engine.step(np.full((len(scenes), 2), (-0.9, 0.0), dtype=np.float32))
        seen.append(engine.observations[:, setup.polar_size :].copy())
    return np.stack(seen) * setup.robot.lidar.range_m


def test_a_lidar_s_noise_and_drop_outs_are_as_large_as_said_and_the_same_again():
    """Beam by beam: each its own sector."""
    one_by_one = {"beams": 360, "sectors": 360}
    scenes = draw_scenes("study_room", range(40))
    exact, noisy = scans(shaped(**one_by_one), scenes), scans(shaped(**one_by_one, noise_m=0.03), scenes)
    off = (noisy - exact)[exact < 5.5]
    assert off.std() == pytest.approx(0.03, rel=0.03)
    assert abs(off.mean()) < 0.001
    assert (noisy[exact >= 6.0 - 1e-6] == 6.0).all()
    assert (noisy == scans(shaped(**one_by_one, noise_m=0.03), scenes)).all()
    apart = [
        np.corrcoef(off_of[:-1].ravel(), off_of[1:].ravel())[0, 1] for off_of in (noisy - exact, (noisy - exact).T)
    ]
    assert max(map(abs, apart)) < 0.02  # steps and beams tell nothing of each other
    gone = scans(shaped(**one_by_one, drop_out=0.1), scenes)
    seen = exact < 5.9
    assert (gone[seen] == 6.0).mean() == pytest.approx(0.1, abs=0.005)
    assert (gone[gone < 6.0] == exact[gone < 6.0]).all()


def test_errors_come_before_pooling_and_what_is_too_near_is_not_seen():
    scenes = draw_scenes("study_room", range(10))
    whole, pooled = (scans(shaped(beams=360, sectors=n, noise_m=0.05), scenes) for n in (360, 36))
    assert pooled == pytest.approx(whole.reshape(*whole.shape[:2], 36, 10).min(axis=-1), abs=1e-6)
    blind = scans(shaped(beams=360, sectors=360, min_range_m=1.0), scenes)
    exact = scans(shaped(beams=360, sectors=360), scenes)
    assert (blind == np.where(exact < 1.0, np.float32(6.0), exact)).all()


def test_between_two_scans_the_last_one_is_seen_also_of_a_new_episode():
    slow = shaped(rate_hz=2.0)
    assert slow.robot.lidar.steps_per_scan == 2.5
    seen, exact = scans(slow, draw_scenes("study_room", range(5))), scans(shaped(), draw_scenes("study_room", range(5)))
    new = [0, 3, 5, 8, 10]  # 0, 0.6, 1.0, 1.6, 2.0 s
    for step in range(13):
        assert seen[step] == pytest.approx(exact[max(one for one in new if one <= step)], abs=1e-6)
    engine = FastEngine(slow, 4, seed=3)
    for _ in range(400):
        engine.step(np.tile(np.array([1.0, 0.0], np.float32), (4, 1)))
        begun = np.flatnonzero(engine.dones)
        first = engine.observations[begun, slow.polar_size :].copy()
        if len(begun):
            break
    engine.step(np.tile(np.array([-1.0, 0.3], np.float32), (4, 1)))
    assert len(begun)
    assert (engine.observations[begun, slow.polar_size :] == first).all()


def test_speeds_change_no_faster_than_the_robot_can():
    limits = replace(PLAIN.robot.limits, v_change=0.5, w_change=1.0)
    slow = replace(PLAIN, robot=replace(PLAIN.robot, limits=limits))
    engine = FastEngine(slow, 1, auto_reset=False, scenes=[scene_with(start=Pose(-4, 0, 0))])
    gone = [-4.0]
    for _ in range(4):
        engine.step(np.array([[1.0, 0.0]], dtype=np.float32))
        gone.append(float(engine.poses[0, 0]))
    assert np.diff(gone) / 0.2 == pytest.approx([0.1, 0.2, 0.3, 0.4], abs=1e-6)


def test_tables_and_measures_use_the_body():
    engine = driven(shaped(BOX), scene_with(), (1, 0), 3)
    poses = np.array([[0, 0, 0], [0.6, 0, 0]])
    assert clearance_m(scene_with(), poses) == pytest.approx(5 - 0.6 - 0.18)  # study_room's own robot is a disc
    assert engine.min_clearance[0] == pytest.approx(5 - 0.6 - 0.5, abs=1e-6)
    with pytest.raises(ValueError, match="trajectories"):
        table_of([])


@pytest.mark.parametrize(
    ("setup", "what"),
    [
        (shaped(BOX), "footprint"),
        *(
            (shaped(**{key: 0.1}), "lidar.noise_m, drop_out")
            for key in ("noise_m", "drop_out", "min_range_m", "rate_hz")
        ),
    ],
)
def test_pybullet_refuses_what_it_does_not_know(setup, what):
    pytest.importorskip("pybullet")
    with pytest.raises(SetupError, match=f"PyBullet cannot do with `{what}"):
        ReferenceEngine(setup)


@pytest.mark.parametrize(
    ("footprint", "problem"),
    [
        (((0.2, 0.1), (0.2, -0.1), (0.4, 0.0)), "must go once around 0, 0"),
        (((0.5, 0.3), (-0.5, -0.3), (-0.5, 0.3), (0.5, -0.3)), "must go once around|its sides cross"),
        (((0.5, 0.3), (0.5, 0.3), (-0.5, 0.0), (0.5, -0.3)), "two neighbouring corners are one"),
    ],
)
def test_outlines_that_are_none_are_refused(footprint, problem):
    with pytest.raises(SetupError, match=problem):
        Robot("x", 0.3, Limits(0.0, 1.0, 1.0), Lidar(360, 36, 6.0, 0.2), footprint=footprint)


def test_a_robot_is_round_or_has_corners():
    with pytest.raises(SetupError, match="give it for a round robot, or else `footprint`"):
        Robot("x", 0.3, Limits(0.0, 1.0, 1.0), Lidar(360, 36, 6.0, 0.2))
    with pytest.raises(SetupError, match=r"min_range_m = 6: must be below range_m, 6 m"):
        Lidar(100, 20, 6.0, 0.2, min_range_m=6.0)
    long = Robot("x", 0.3, Limits(0.0, 1.0, 1.0), Lidar(360, 36, 6.0, 0.2), footprint=BOX)
    assert replace(long, height_m=0.5).radius_m == long.radius_m
    with pytest.raises(SetupError, match=r"sectors = 25: must divide the 100 beams, be even, and fill 171.887 degrees"):
        Lidar(100, 25, 6.0, 0.2, field_of_view_rad=3.0)


def test_every_shipped_robot_is_read_with_its_source():
    robots = {name: read_robot(path) for name, path in shipped_robots().items()}
    assert set(robots) == {"turtlebot2", "turtlebot3_burger", "turtlebot3_waffle_pi", "husky_a200"}
    assert all(robot.source and robot.name == name for name, robot in robots.items())
    assert robots["husky_a200"].radius_m == pytest.approx(math.hypot(0.495, 0.335))
    assert robots["husky_a200"].inscribed_m == pytest.approx(0.335)
    assert robots["turtlebot3_burger"].limits.v_max == 0.22
    # husky_description: wheels, top plate, laser mount, bracket; turtlebot3_burger.urdf: base_footprint, base_link
    assert robots["husky_a200"].lidar.height_m == pytest.approx(0.13228 + 0.245 + 0.00635 + 0.0566, abs=0.001)
    assert robots["husky_a200"].lidar.x_m == pytest.approx(0.0812 + 0.2206 + 0.0352, abs=0.001)
    assert robots["turtlebot3_burger"].lidar.height_m == pytest.approx(0.010 + 0.172)
