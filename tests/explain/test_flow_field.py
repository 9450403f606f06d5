"""Flow fields in real scenes with policies simple enough to know the answer, and the figures made of them."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.explain import flow_field as flow
from desirepath.explain.flow_files import flow_files, starts_files
from desirepath.learning.policies.shipped import load_ensemble, load_policy
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Obstacle, Person, Pose, Room, Scene, SceneError
from desirepath.simulation.scenes import check_scene, draw_scene
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.trajectory import Outcome

OPEN_FIELD = get_setup("open_field")
STUDY_ROOM = get_setup("study_room")

GAIN = math.pi / (STUDY_ROOM.robot.limits.w_max * 0.2)  # turns by exactly the goal's bearing in one step, where it can


def room(**changes: object) -> Scene:
    scene = Scene(
        setup="study_room",
        seed=0,
        start=Pose(-2.0, 0.0, 0.0),
        goal=Pose(2.0, 0.0),
        goal_radius=STUDY_ROOM.goal_radius_m,
        person=Person(Pose(0.0, 1.5, math.pi)),
        obstacles=(Obstacle("box", Pose(0.0, -2.0, 0.5), 0.8, 1.6, 1.2),),
        room=Room(8.0, 11.0),
    )
    return replace(scene, **changes)


def turn_to_goal(observations: np.ndarray) -> np.ndarray:
    """Half speed straight on, turning towards the goal."""
    return np.stack([np.zeros(len(observations)), np.clip(GAIN * observations[:, 1], -1, 1)], axis=1).astype("float32")


def turn_round(observations: np.ndarray) -> np.ndarray:
    return np.full((len(observations), 2), (-1.0, 0.4), dtype=np.float32)


def swing(observations: np.ndarray) -> np.ndarray:
    """Overshoots: to the right whenever the goal lies ahead or to the right, to the left otherwise, 0.2 rad each."""
    right = observations[:, 1] <= 0
    return np.stack([np.full(len(observations), -1.0), np.where(right, -1, 1) / math.pi], axis=1).astype(np.float32)


def goal_bearing(field: flow.FlowField) -> np.ndarray:
    x, y = np.meshgrid(field.grid.xs, field.grid.ys)
    return np.arctan2(field.scene.goal.y - y, field.scene.goal.x - x)


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


@pytest.fixture(scope="module")
def field() -> flow.FlowField:
    return flow.flow_field(turn_to_goal, STUDY_ROOM, room())


def test_who_turns_to_the_goal_settles_towards_it_everywhere(field):
    assert np.isfinite(field.heading[field.free]).all()
    assert np.isnan(field.heading[~field.free]).all()
    assert apart(field.heading, goal_bearing(field))[field.free].max() < 1e-3
    np.testing.assert_allclose(field.speed[field.free], 0.5, atol=1e-6)
    assert field.oscillation[field.free].max() == 0
    along_x, along_y = field.velocity()
    np.testing.assert_allclose(np.hypot(along_x, along_y)[field.free], 0.5, atol=1e-6)


def test_who_turns_to_the_person_settles_towards_the_person():
    def turn_to_person(observations: np.ndarray) -> np.ndarray:
        return turn_to_goal(np.roll(observations, -2, axis=1))  # the person's polar stands where the goal's was

    towards = flow.flow_field(turn_to_person, STUDY_ROOM, room(), cell_m=1.0)
    x, y = np.meshgrid(towards.grid.xs, towards.grid.ys)
    person = towards.scene.person.pose
    bearing = np.arctan2(person.y - y, person.x - x)
    assert apart(towards.heading, bearing)[towards.free].max() < 1e-3


def test_free_cells_are_those_in_which_the_disc_touches_nothing(field):
    scene, grid = field.scene, field.grid
    assert grid.shape == (44, 32)
    assert grid.extent == (-4.0, 4.0, -5.5, 5.5)
    box = scene.obstacles[0]
    for (row, column), free in np.ndenumerate(field.free):
        x, y = grid.xs[column], grid.ys[row]
        c, s = math.cos(box.pose.yaw), math.sin(box.pose.yaw)
        along, across = c * (x - box.pose.x) + s * (y - box.pose.y), c * (y - box.pose.y) - s * (x - box.pose.x)
        to_box = math.hypot(max(abs(along) - box.length / 2, 0), max(abs(across) - box.width / 2, 0))
        to_person = math.dist((x, y), (scene.person.pose.x, scene.person.pose.y)) - scene.person.radius
        assert free == (min(to_box, to_person, 4 - abs(x), 5.5 - abs(y)) >= 0.18), (x, y)


def test_every_drive_counts_once_in_every_cell_it_enters(field):
    """Counted again from whole trajectories, sampled far more finely than the field does."""
    grid, scene = field.grid, field.scene
    expected: Counter[int] = Counter()
    starts = [
        replace(scene, start=Pose(float(grid.xs[column]), float(grid.ys[row]), float(field.heading[row, column])))
        for row, column in np.argwhere(field.outcome != flow.NOTHING)
    ]
    drives = rollout(STUDY_ROOM, turn_to_goal, starts)
    for drive in drives:
        path = drive.poses[:, :2].astype(float)
        fine = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(path)])
        cells = grid.cells_of(fine)
        entered = cells[np.flatnonzero(np.diff(cells, prepend=-2))]
        expected.update(entered[entered >= 0].tolist())
    counted = field.traversals.ravel()
    exact = np.array([expected[cell] for cell in range(counted.size)])
    # a drive that grazes a corner for less than a fifth of a cell may be missed
    assert abs(int(counted.sum()) - int(exact.sum())) < 0.02 * exact.sum()
    assert np.abs(counted - exact).max() <= max(3, 0.05 * exact.max())
    told = [Outcome(int(one)) for one in field.outcome[field.outcome != flow.NOTHING]]
    assert told == [drive.outcome for drive in drives]
    assert field.share(Outcome.SUCCESS) == pytest.approx(np.mean([one is Outcome.SUCCESS for one in told]))


def test_robot_that_stands_still_leaves_one_traversal_per_cell():
    still = flow.flow_field(lambda seen: np.tile(np.float32([-1, 0]), (len(seen), 1)), STUDY_ROOM, room(), cell_m=0.5)
    assert (still.traversals[still.outcome != flow.NOTHING] == 1).all()
    assert still.traversals.sum() == still.rollouts
    assert still.share(Outcome.TIMEOUT) == 1
    in_goal = np.hypot(*(a - b for a, b in zip(np.meshgrid(still.grid.xs, still.grid.ys), (2.0, 0.0), strict=True)))
    assert (still.outcome[still.free & (in_goal <= still.scene.goal_radius)] == flow.NOTHING).all()


def test_oscillation_is_told_with_its_middle_and_turning_round_has_no_heading():
    swinging = flow.flow_field(swing, STUDY_ROOM, room(), cell_m=1.0)
    assert swinging.oscillation[swinging.free] == pytest.approx(0.2, abs=1e-3)
    assert apart(swinging.heading, goal_bearing(swinging))[swinging.free].max() <= 0.101
    turning = flow.flow_field(turn_round, STUDY_ROOM, room(), cell_m=1.0)
    assert np.isnan(turning.heading).all()
    assert np.isnan(turning.speed).all()
    assert turning.share(Outcome.TIMEOUT) == 1


@pytest.mark.parametrize("setup", [STUDY_ROOM, OPEN_FIELD], ids=lambda setup: setup.name)
def test_shipped_policy_arrives_from_nearly_everywhere_and_gives_the_same_field_twice(setup):
    policy, scene = load_policy(f"{setup.name}/base"), draw_scene(setup, 3_500_000_002)
    first, again = (flow.flow_field(policy.act, setup, scene, cell_m=0.5) for _ in range(2))
    for name in ("free", "heading", "speed", "oscillation", "outcome", "traversals"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.share(Outcome.SUCCESS) > 0.85
    assert np.nanmax(first.speed) <= setup.robot.limits.v_max
    places = [(scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y)]
    assert (first.grid.cells_of(np.array(places)) >= 0).all()


def test_difference_is_the_angle_and_the_count_between_two_fields(field):
    alike = flow.difference(field, field)
    assert alike.mean_angle == 0
    assert not alike.traversals.any()
    mirrored = flow.flow_field(turn_round, STUDY_ROOM, room())
    other = flow.difference(field, mirrored)
    assert np.isnan(other.heading).all()
    assert math.isnan(other.mean_angle)
    np.testing.assert_array_equal(other.traversals, mirrored.traversals - field.traversals)
    quarter = replace(field, heading=((field.heading + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi).astype(np.float32))
    assert flow.difference(field, quarter).mean_angle == pytest.approx(math.pi / 2, abs=1e-5)
    with pytest.raises(ValueError, match="two scenes or grids"):
        flow.difference(field, replace(field, scene=room(seed=1)))


def test_what_makes_no_field_is_refused():
    with pytest.raises(SetupError):
        flow.flow_field(turn_to_goal, OPEN_FIELD, room())
    with pytest.raises(SceneError, match="goal"):
        flow.flow_field(turn_to_goal, STUDY_ROOM, room(goal=Pose(9.0, 0.0)))
    for cell_m, says in ((0.01, "at least 0.05"), (math.nan, "at least"), (0.05, "at most 20000")):
        with pytest.raises(ValueError, match=says):
            flow.grid_of(room(), cell_m)
    with pytest.raises(ValueError, match="one or two"):
        flow_files([], STUDY_ROOM, room())


def test_starts_lie_apart_and_can_all_reach_the_goal():
    scene = draw_scene("study_room", 3_500_000_000)
    starts = flow.spread_starts(scene, 5)
    assert starts[0] == scene
    assert len(starts) == 5
    for one in starts:
        check_scene(one)
    places = np.array([(one.start.x, one.start.y) for one in starts])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(5, 1)]
    assert gaps.min() > 2.0


def rows_of(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def test_figure_of_two_policies_has_its_numbers_beside_it():
    scene = draw_scene("open_field", 3_500_000_000)
    pair = [("one <&>", load_policy("open_field/base").act), ("two", load_policy("open_field/ensemble/1").act)]
    made, again = (flow_files(pair, OPEN_FIELD, scene, cell_m=0.5) for _ in range(2))
    assert made == again
    assert set(made.files) == {
        *("flow_field.png", "flow_field.svg", "flow_field_a.csv", "flow_field_b.csv", "difference.csv")
    }
    assert Image.open(io.BytesIO(made.files["flow_field.png"])).width > 1_000
    drawn = ElementTree.fromstring(made.files["flow_field.svg"])
    assert "3500000000" in "".join(drawn.itertext())
    a, b, gap = (rows_of(made.files[name]) for name in ("flow_field_a.csv", "flow_field_b.csv", "difference.csv"))
    for first, second, between in zip(a, b, gap, strict=True):
        assert int(between["traversals_difference"]) == int(second["traversals"]) - int(first["traversals"])
        assert (between["heading_difference_rad"] == "") == ("" in (first["heading_rad"], second["heading_rad"]))
    told = made.numbers["policies"][0]
    assert sum(row["outcome"] == "success" for row in a) == pytest.approx(told["success_rate"] * told["trajectories"])
    assert sum(int(row["free"]) for row in a) == told["free_cells"]
    json.dumps(made.numbers, allow_nan=False)


def test_field_without_any_heading_is_drawn_too():
    made = flow_files([("spins", turn_round)], STUDY_ROOM, room(), cell_m=1.0)
    assert made.numbers["policies"][0]["mean_oscillation_rad"] is None
    assert {row["heading_rad"] for row in rows_of(made.files["flow_field.csv"])} == {""}
    assert made.files["flow_field.svg"].startswith(b"<?xml")


def test_ensemble_is_drawn_from_several_starts():
    scene = draw_scene("study_room", 3_500_000_001)
    members = {f"member {k}": one.act for k, one in enumerate(load_ensemble("study_room"))}
    made = starts_files({**members, "stands": turn_round}, STUDY_ROOM, scene, starts=3)
    rows = rows_of(made.files["trajectories.csv"])
    assert {(row["policy"], row["start"]) for row in rows} == {
        (name, str(k)) for name in [*members, "stands"] for k in range(3)
    }
    assert {row["outcome"] for row in rows if row["policy"] == "stands"} == {"timeout"}
    assert made.numbers["policies"][-1] == {"name": "stands", "arrived": 0}
    ElementTree.fromstring(made.files["trajectories.svg"])


def test_command_line_writes_files_and_says_what_it_wrote(tmp_path):
    out = tmp_path / "new" / "folder"
    done = CliRunner().invoke(
        app, ["policies", "flow-field", "study_room/base", "--scene", "3", "--cell", "1", "--out", str(out), "--json"]
    )
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert (said["setup"], said["scene_seed"], said["cell_m"]) == ("study_room", 3, 1.0)
    assert {Path(one["path"]).name for one in said["files"]} == {one.name for one in out.iterdir()}
    refused = CliRunner().invoke(app, ["policies", "flow-field", "study_room/base", "open_field/base", "--json"])
    assert refused.exit_code == 1
    assert "setups differ" in json.loads(refused.stdout)["error"]
