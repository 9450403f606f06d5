"""A lab's own building: a map of ROS, read, driven in and seen; parity with the same walls as boxes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.demonstrations.cost_map import free_grid
from desirepath.demonstrations.demonstrators import STYLES, draw_stroke
from desirepath.demonstrations.social_cost import SocialCost
from desirepath.demonstrations.stroke import StrokeProblem, check_stroke
from desirepath.explain.sight import BUILDING, sight_of
from desirepath.grammar.source import ProtocolError
from desirepath.installed import DATASETS
from desirepath.simulation import kernels as k
from desirepath.simulation import setups
from desirepath.simulation.fast import beams_of, evaluate, make_engine, raw_ranges, rollout
from desirepath.simulation.ground_maps import GroundMap, read_map
from desirepath.simulation.scene import Obstacle, Pose, Scene, SceneError
from desirepath.simulation.scenes import check_scene, draw_scenes, extent_m, ground_of, scene_to_row, solids_near
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath.study.personalising.live_rollouts import path_of, roll_out
from desirepath_experiments.benchmarks.map_lidar import LidarConfig, benchmark_lidar
from desirepath_stage import furniture
from desirepath_stage.scene_nodes import place_file
from tests.fences import fences_of
from tests.simulation.simple_policies import towards_goal
from tests.stage.test_looks import outward

CELL_M = 0.05
MAP = """\
image: map.pgm
resolution: 0.05
origin: [-4.0, -3.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
BOXES = (
    (-4, -3, -3.8, 3),
    (3.8, -3, 4, 3),
    (-4, -3, 4, -2.8),
    (-4, 2.8, 4, 3),
    (-0.6, -1.0, 0.4, 0.2),
    (1.5, 1, 2, 2.8),
)
"""Walls and two blocks on whole cells: smallest x and y, largest x and y."""


def draw_map(folder: Path, boxes: tuple[tuple[float, ...], ...] = BOXES) -> Path:
    """A map of 8 x 6 m with those boxes; white is free, as map_server writes it."""
    grey = np.full((120, 160), 254, dtype=np.uint8)
    for x1, y1, x2, y2 in boxes:
        i, j, u, v = (round((value + half) / CELL_M) for value, half in ((x1, 4), (y1, 3), (x2, 4), (y2, 3)))
        grey[j:v, i:u] = 0
    Image.fromarray(grey[::-1]).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(MAP)
    return folder / "map.yaml"


def boxes_as_obstacles() -> tuple[Obstacle, ...]:
    return tuple(
        Obstacle("wall", Pose((x1 + x2) / 2, (y1 + y2) / 2), x2 - x1, y2 - y1, 2.0) for x1, y1, x2, y2 in BOXES
    )


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], setups.Setup]]:
    """Makes a setup of the study room's robot and task in a building of its own."""

    def make(building: str) -> setups.Setup:
        folder = tmp_path / "setups" / "own_place"
        folder.mkdir(parents=True, exist_ok=True)
        draw_map(folder)
        text = (DATASETS / "study_room/setup.yaml").read_text()
        (folder / "setup.yaml").write_text(
            text.replace("  name: study_room", f"  name: building\n  building: {building}")
        )
        forget()
        return get_setup("own_place")

    monkeypatch.setenv("DESIREPATH_SETUPS", str(tmp_path / "setups"))
    (tmp_path / "setups").mkdir()
    yield make
    monkeypatch.delenv("DESIREPATH_SETUPS")
    forget()


def forget() -> None:
    for cached in (setups._find, setups._read):
        cached.cache_clear()


def test_rays_and_clearances_on_the_grid_are_those_of_the_same_boxes(own):
    """Within a cell, wherever the robot stands and however it is turned."""
    setup = own("{map: map.yaml}")
    scene = draw_scenes(setup, [1])[0]
    bare = scene_to_row(scene)
    boxed = scene_to_row(setups_free_of_ground(scene))
    ground, beams, random = ground_of(scene), beams_of(setup, pooled=False), np.random.default_rng(3)
    on_grid, on_boxes = np.empty(beams.number), np.empty(beams.number)
    looked = 0
    while looked < 200:
        x, y, yaw = random.uniform(-3.6, 3.6), random.uniform(-2.6, 2.6), random.uniform(-np.pi, np.pi)
        apart = k.surface_distance(boxed, x, y)
        if apart < 0.02:
            continue
        assert k.surface_distance(bare, x, y, ground) == pytest.approx(apart, abs=1e-6)
        k.scan(bare, x, y, yaw, beams, on_grid, ground)
        k.scan(boxed, x, y, yaw, beams, on_boxes)
        off = np.abs(on_grid - on_boxes)
        assert np.quantile(off, 0.99) <= CELL_M
        # A ray that grazes a corner passes it here and meets it there: never more than one in a hundred beams.
        assert np.median(off) < 1e-4
        looked += 1


def setups_free_of_ground(scene: Scene) -> Scene:
    """The same place with boxes instead of the map."""
    return replace(scene, ground=None, obstacles=boxes_as_obstacles())


def empty(scene: Scene) -> Scene:
    return replace(scene, ground=None)


def test_robots_drive_and_collide_as_among_the_same_boxes(own):
    setup = own("{map: map.yaml}")
    scenes = draw_scenes(setup, range(12))
    random = np.random.default_rng(1)
    actions = [random.uniform(-1, 1, (200, 2)).astype(np.float32) for _ in scenes]
    for scene in scenes:
        check_scene(scene)
    on_grid = make_engine(setup, 12, auto_reset=False, scenes=scenes)
    rows = np.stack([scene_to_row(setups_free_of_ground(scene)) for scene in scenes])
    on_boxes = make_engine(setup, 12, auto_reset=False, scenes=scenes)
    on_boxes._ground = None
    on_boxes._state = on_boxes._state._replace(rows=rows)
    for step in range(200):
        taken = np.stack([one[step] for one in actions])
        on_grid.step(taken)
        on_boxes.step(taken)
    assert (on_grid.outcomes == on_boxes.outcomes).all()
    assert (on_grid.outcomes == Outcome.COLLISION).sum() > 6
    assert np.abs(on_grid.poses[:, :2] - on_boxes.poses[:, :2]).max() < 0.002


def test_scenes_in_a_map_are_solvable_and_the_same_again(own):
    setup = own("{map: map.yaml}")
    for scene in draw_scenes(setup, range(30)):
        check_scene(scene)
        assert scene == draw_scenes(setup, [scene.seed])[0]
        assert type(scene).from_dict(scene.as_dict()) == scene
    table = evaluate(towards_goal(setup), setup, draw_scenes(setup, range(30)))
    assert table.success.any()
    assert np.isfinite(table.min_clearance).all()


def test_named_places_are_used(own):
    setup = own("{map: map.yaml, starts: [{x: -3, y: -2}], goals: [{x: -3, y: 2}], people: [{x: -2, y: 0, yaw: 3.1}]}")
    scene = draw_scenes(setup, [5])[0]
    assert (scene.start, scene.goal, scene.person.pose) == (Pose(-3, -2), Pose(-3, 2), Pose(-2, 0, 3.1))


def test_a_room_may_be_a_list_of_walls_and_furniture(own):
    table = "{kind: table, x: 2, y: 3, length: 1.2, width: 0.8, height: 0.75}"
    walls = "[[0,0,8,0],[8,0,8,6],[8,6,0,6],[0,6,0,0],[4,0,4,2.5],[4,3.8,4,6]]"
    setup = own(f"{{walls: {walls}, furniture: [{table}]}}")
    scenes = draw_scenes(setup, range(20))
    for scene in scenes:
        check_scene(scene)
        assert 0 < scene.start.x < 8
        assert 0 < scene.start.y < 6
    assert len(scenes[0].obstacles) == 7
    assert rollout(setup, towards_goal(setup), scenes[:1])[0].observations.shape[1] == setup.observation_size


def test_a_map_is_seen_raised_on_the_stage_and_explained(own):
    setup = own("{map: map.yaml}")
    scene = draw_scenes(setup, [2])[0]
    bounds = (-4.0, -3.0, 4.0, 3.0)
    low, high = (place_file(scene, bounds, "plain", cut=cut) for cut in (True, False))
    assert low != high
    here = read_map(setup.plan.map)
    shape = furniture.map_walls(here, cut=False)
    assert outward(shape).min() > 0.99
    assert shape.positions[:, 2].max() == furniture.MAP_WALL_HEIGHT_M
    sides, facing = here.wall_sides
    length = np.abs(sides[:, :2] - sides[:, 2:]).sum()
    assert length == pytest.approx(2 * (8 + 6) + 2 * (7.6 + 5.6) + 2 * (1.0 + 1.2) + 2 * 1.8)  # one block joins a wall
    beside = (sides[:, :2] + sides[:, 2:]) / 2 + 0.01 * facing
    assert not any(here.occupied[tuple(((place - here.origin) / CELL_M).astype(int))] for place in beside)
    walls = len(place_file(scene, bounds, "plain", cut=True)) - len(place_file(empty(scene), bounds, "plain", cut=True))
    assert walls > 2_000  # bytes: faces of a hundred each
    sight = sight_of(rollout(setup, towards_goal(setup), [scene])[0])
    assert sight.things == (BUILDING, "person")
    seen = sight.ranges.min(axis=1) / setup.robot.lidar.range_m
    assert np.allclose(seen, sight.observations[:, sight.first_ray :], atol=1e-5)


def test_of_a_map_the_walls_near_a_scene_stop_what_the_page_draws(own):
    setup = own("{map: map.yaml, starts: [{x: -3, y: -2}], goals: [{x: -3, y: 2}], people: [{x: -2, y: 0}]}")
    scene = draw_scenes(setup, [5])[0]
    assert {solid.kind for solid in solids_near(scene, 1.0)} == {"wall"}
    assert len(solids_near(scene, 0.5)) < len(solids_near(scene, 1.0)) < len(solids_near(scene, 9.0))
    assert sum(solid.length * solid.width for solid in solids_near(scene, 9.0)) == pytest.approx(
        48 - 7.6 * 5.6 + 1.2 + 0.9
    )


WALLS = "{walls: [[0,0,8,0],[8,0,8,6],[8,6,0,6],[0,6,0,0],[4,0,4,2.5],[4,3.8,4,6]], way_m: [3, 8]}"


@pytest.mark.parametrize("building", ["{map: map.yaml, way_m: [3, 8]}", WALLS])
def test_ways_are_planned_drawn_and_driven_anew_in_a_building(own, building):
    setup = own(building)
    scene = draw_scenes(setup, [4])[0]
    low, high = extent_m(scene)
    assert (high - low).tolist() == pytest.approx([8.1, 6.1], abs=0.05)
    grid = free_grid(scene, spare_m=0.05)
    row, ground = scene_to_row(scene), ground_of(scene)
    for x, y in grid.places()[grid.free][::97]:
        assert k.surface_distance(row, x, y, ground) >= setup.robot.radius_m + 0.05
    for style in STYLES:
        stroke = draw_stroke(style, scene, 1)
        check_stroke(stroke, scene)
    social = SocialCost(scene)
    steered = social.steer(scene.start, scene.person.pose)
    assert np.isfinite(steered).all()
    policy = SimpleNamespace(rollout_policy=towards_goal(setup))
    again = roll_out(policy, scene, (scene.start.x + 0.01, scene.start.y, 0.0))
    assert len(path_of(again).track) > 1
    with pytest.raises(SceneError, match="lies outside the room"):
        roll_out(policy, scene, (float(high[0]) + 0.5, 0.0, 0.0))
    points = stroke.points.copy()
    points[len(points) // 2] = high + 1.0
    with pytest.raises(StrokeProblem, match="leaves the room"):
        check_stroke(replace(stroke, points=points), scene)


def test_the_benchmark_counts_scans_that_are_those_of_boxes():
    told = benchmark_lidar(LidarConfig(side_m=6.0, beams=120, sectors=12))
    assert told["scans_per_s"] >= told["median_scans_per_s"] > 0
    assert told["map"]["walls"] > 10
    assert told["off_m"]["p99"] <= 0.05


def test_a_scene_of_another_map_is_refused(own):
    setup = own("{map: map.yaml}")
    scene = draw_scenes(setup, [1])[0]
    with pytest.raises(SceneError, match="is not the map that setup own_place has now"):
        check_scene(replace(scene, ground="0" * 64))
    with pytest.raises(SceneError, match="is missing: setup own_place lies in a map"):
        check_scene(replace(scene, ground=None))


def test_unknown_cells_stop_rays_and_robots(tmp_path):
    path = draw_map(tmp_path)
    grey = np.asarray(Image.open(tmp_path / "map.pgm")).copy()
    grey[50:60, 70:90] = 205
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    read = read_map(path)
    assert isinstance(read, GroundMap)
    assert read.unknown[1:-1, 1:-1].sum() == 200
    assert read.unknown_parts.tolist() == [pytest.approx([-0.5, 0.0, 0.5, 0.5])]
    assert k.ground_distance(read.ground, 0.0, 0.25) < 0


@pytest.mark.parametrize(
    ("was", "instead", "problem"),
    [
        ("map.pgm", "gone.pgm", "map.yaml:1: image = 'gone.pgm': no file gone.pgm lies beside it"),
        ("map.pgm", "../map.pgm", "must be the name of a picture in the same folder"),
        ("map.pgm", "map.yaml", "is no whole PGM, PNG or BMP"),
        ("resolution: 0.05", "resolution: 5", "map.yaml:2: resolution = 5: .*less than or equal to 1|at most 1"),
        ("resolution: 0.05\n", "", "resolution: is missing"),
        ("origin: [-4.0, -3.0, 0.0]\n", "", "origin: is missing"),
        ("-3.0, 0.0]", "-3.0, 0.7]", "its yaw must be 0"),
        ("-3.0, 0.0]", ".nan, 0.0]", "map.yaml:3: .*holds a number"),
        ("free_thresh: 0.196", "free_thresh: 0.7", "free_thresh = 0.7: must be below occupied_thresh"),
        ("negate: 0", "negate: 1", "has no free cell by these thresholds|is `negate` right"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_map_is_said_by_line_and_field(tmp_path, was, instead, problem):
    path = draw_map(tmp_path, ())
    path.write_text(MAP.replace(was, instead))
    with pytest.raises(ProtocolError, match=problem):
        read_map(path)


def test_a_cut_or_vast_picture_is_refused_before_it_is_read(tmp_path):
    path = draw_map(tmp_path)
    whole = (tmp_path / "map.pgm").read_bytes()
    (tmp_path / "map.pgm").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ProtocolError, match="is no whole PGM"):
        read_map(path)
    (tmp_path / "map.pgm").write_bytes(b"P5 100000 100000 255\n" + b"\0" * 100)
    with pytest.raises(ProtocolError, match=r"has too many cells; at most 16,000,000 are read"):
        read_map(path)
    (tmp_path / "map.pgm").write_bytes(b"P5 5000 5000 255\n" + b"\0" * 100)
    with pytest.raises(ProtocolError, match=r"has 5000 x 5000 cells; at most 16,000,000 are read"):
        read_map(path)


def test_a_map_of_sixteen_bits_or_of_endless_length_is_refused(tmp_path):
    path = draw_map(tmp_path)
    Image.fromarray(np.full((60, 80), 40_000, dtype=np.uint16)).save(tmp_path / "map.png")
    path.write_text(MAP.replace("map.pgm", "map.png"))
    with pytest.raises(ProtocolError, match="has more than 8 bits a cell"):
        read_map(path)
    Image.fromarray(np.full((2, 33_000), 254, dtype=np.uint8)).save(tmp_path / "map.pgm")
    path.write_text(MAP)
    with pytest.raises(ProtocolError, match="is 33,000 cells long"):
        read_map(path)


def test_a_setup_says_what_is_wrong_with_its_building(own):
    with pytest.raises(SetupError, match=r"world.building.map = 'nowhere.yaml'|nowhere.yaml:1"):
        own("{map: nowhere.yaml}")
    with pytest.raises(SetupError, match=r"world.building.mop.* did you mean map"):
        own("{mop: map.yaml}")


def test_raw_ranges_are_the_map_s(own):
    setup = own("{map: map.yaml, starts: [{x: -3, y: -2}], goals: [{x: -3, y: 2}]}")
    scene = draw_scenes(setup, [5])[0]
    assert raw_ranges(setup, scene, Pose(-3, -2))[360] == pytest.approx(0.8, abs=CELL_M)


def run(*words: str) -> dict[str, object]:
    """What a command says, as an object; its exit code beside."""
    result = CliRunner().invoke(app, [*words, "--json"])
    return {**json.loads(result.stdout), "exit_code": result.exit_code}


def test_the_building_of_the_guide_is_checked_and_driven_in(tmp_path):
    robot, fence = fences_of("docs/extending.md", "A building", "yaml")
    folder = (tmp_path / fence.file).parent
    folder.mkdir(parents=True)
    (tmp_path / robot.file).write_text(robot.text)
    assert run("robots", "check", str(tmp_path / robot.file))["left_out"] == []
    (tmp_path / fence.file).write_text(fence.text.replace("turtlebot3_burger", "our_robot.yaml"))
    assert run("setups", "check", str(folder))["valid"]
    (tmp_path / fence.file).write_text(fence.text)
    told = run("setups", "check", str(folder))
    assert (told["valid"], told["exit_code"], told["setup"]) == (True, 0, "our_flat")
    assert told["scenes"]["drawn"] == 20
    assert told["scenes"]["longest_m"] <= 6.0
    (tmp_path / fence.file).write_text(fence.text.replace("turtlebot3_burger", "turtlebot3_burgr"))
    told = run("setups", "check", str(folder))
    assert (told["valid"], told["exit_code"]) == (False, 1)
    assert "did you mean turtlebot3_burger?" in told["errors"][0]["message"]
    assert told["errors"][0]["line"] == 1
    for was, instead, problem in (
        ("way_m: [1.5, 6.0]", "way_m: [6.0, 1.5]", "the shorter one first"),
        ("height: 0.75", "height: 0.1", "must exceed the lidar's 0.182 m"),
        ("x: 2, y: 3", "x: 0.2, y: 3", "overlaps obstacles"),
        ("[8, 0, 8, 6]", "[8, 0, 900, 6]", "at most 500 m are plausible"),
    ):
        (tmp_path / fence.file).write_text(fence.text.replace(was, instead))
        told = run("setups", "check", str(folder))
        assert (told["valid"], told["exit_code"]) == (False, 1)
        assert problem in told["errors"][0]["message"]


def test_robots_are_checked_by_name_and_by_file(tmp_path):
    told = run("robots", "check", "turtlebot3_waffle_pi", "--picture", str(tmp_path / "robot.png"))
    assert (told["valid"], told["left_out"]) == (True, [])
    assert told["inscribed_m"] == 0.077
    assert Image.open(tmp_path / "robot.png").width > 100
    (tmp_path / "robot.yaml").write_text(
        "robot:\n  name: own\n  height_m: 0.3\n  footprint: [[0.1, 0.1], [0.2, 0.1], [0.2, 0.2]]\n"
        "  limits: {v_min: 0, v_max: 1, w_max: 1}\n  lidar: {beams: 10, sectors: 3, range_m: 5, height_m: 0.2}\n"
    )
    told = run("robots", "check", str(tmp_path / "robot.yaml"))
    assert told["exit_code"] == 1
    assert [error["field"] for error in told["errors"]] == ["robot.lidar"]


def test_a_robot_s_urdf_is_checked_shown_and_drawn(tmp_path):
    """As ROBOTIS publishes one: its meshes are not beside it."""
    mesh = '<mesh filename="package://own/meshes/base.stl"/>'
    text = '<robot name="r"><link name="l"><visual><geometry>SHAPE</geometry></visual></link></robot>'
    described = (
        "name: own\n  height_m: 0.3\n  radius_m: 0.3\n  urdf: own.urdf\n  limits: {v_min: 0, v_max: 1, w_max: 1}\n"
        "  lidar: {beams: 10, sectors: 5, range_m: 5, height_m: 0.2}\n"
    )
    (tmp_path / "robot.yaml").write_text(f"robot:\n  {described}")
    (tmp_path / "own.urdf").write_text(text.replace("SHAPE", mesh))
    picture = tmp_path / "robot.png"
    told = run("robots", "check", str(tmp_path / "robot.yaml"), "--picture", str(picture))
    assert (told["valid"], told["exit_code"]) == (False, 1)
    assert "is missing: put it beside own.urdf, as meshes/base.stl or as base.stl" in told["errors"][0]["message"]
    without = picture.read_bytes()
    (tmp_path / "own.urdf").write_text(text.replace("SHAPE", '<box size="0.4 0.3 0.2"/>'))
    told = run("robots", "check", str(tmp_path / "robot.yaml"), "--picture", str(picture))
    assert told["urdf"] == {"parts": 1, "triangles": 12, "size_m": [0.4, 0.3, 0.2]}
    assert picture.read_bytes() != without
    _, fence = fences_of("docs/extending.md", "A building", "yaml")
    folder = tmp_path / "our_flat"
    folder.mkdir()
    (folder / "setup.yaml").write_text(fence.text.replace("robot: turtlebot3_burger", f"robot:\n  {described}"))
    (folder / "own.urdf").write_text(text.replace("SHAPE", mesh))
    told = run("setups", "check", str(folder))
    assert told["valid"]
    assert "base.stl" in told["not_shown"][0]


def test_every_seed_gives_a_scene_in_a_large_building_with_a_slow_robot(tmp_path, monkeypatch):
    """Goals are near the start, as it is slow: of two places drawn anywhere, hardly any are so near."""
    folder = tmp_path / "large_hall"
    folder.mkdir()
    walls = "[[0, 0, 60, 0], [60, 0, 60, 60], [60, 60, 0, 60], [0, 60, 0, 0]]"
    told = f"robot: turtlebot3_burger\nworld: {{name: building, building: {{walls: {walls}}}}}\n"
    (folder / "setup.yaml").write_text(told)
    monkeypatch.setattr(setups, "_included", [])
    setups.include(folder)
    for scene in draw_scenes("large_hall", range(400)):
        far = np.hypot(scene.goal.x - scene.start.x, scene.goal.y - scene.start.y)
        assert 1.6 <= far <= 3.3


def test_a_map_far_away_or_full_of_noise_is_refused(tmp_path):
    path = draw_map(tmp_path)
    path.write_text(MAP.replace("-4.0, -3.0", "500000, 5400000"))
    with pytest.raises(ProtocolError, match=r"origin.*must be within 10,000 m"):
        read_map(path)
    noise = np.where(np.random.default_rng(0).random((1_000, 1_000)) < 0.5, 0, 254).astype(np.uint8)
    Image.fromarray(noise).save(tmp_path / "map.pgm")
    path.write_text(MAP)
    with pytest.raises(ProtocolError, match=r"pieces of wall; at most 100,000 are read"):
        read_map(path)
