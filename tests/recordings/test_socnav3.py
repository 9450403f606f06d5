"""I have SocNav3 files, and I want our trajectories as such."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from desirepath.learning.policies.shipped import load_queries
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Mapping
from desirepath.recordings.recording import RecordingError
from desirepath.recordings.socnav3 import read_socnav3, to_socnav3
from desirepath.simulation.trajectory import Outcome
from tests.recordings.walks import ANNA, RUNS, refusal, robot_at, times


def sequence(aside: float) -> dict:
    """A run as SocNav3 says it."""
    return {
        "grid": {"width": 2, "height": 1, "cell_size": 1.0, "x_orig": 0, "y_orig": 0, "data": [[0, 1]]},
        "walls": [{"x1": -1.0, "y1": 3.0, "x2": 7.0, "y2": 3.0}],
        "sequence": [
            {
                "timestamp": 1_700_000_000 + float(t),
                "robot": {
                    "id": 0, "shape": {"type": "circle", "width": 0.4, "length": 0.4},
                    **dict(zip(("x", "y", "angle"), robot_at(float(t), aside), strict=True)),
                    "speed_x": 0.7, "speed_y": 0.0, "speed_a": 0.0,
                },
                "goal": {
                    "type": "go-to", "human": None, "x": 5.6, "y": 0.0, "angle": 0.0,
                    "pos_threshold": 0.3, "angle_threshold": 3.2,
                },
                "people": [{"id": 7, "x": ANNA[0], "y": ANNA[1], "angle": ANNA[2]}],
                "objects": [
                    {"id": 1, "type": "table", "x": 2.0, "y": -3.0, "angle": 0.1,
                     "shape": {"type": "rectangle", "width": 0.8, "length": 1.6}},
                ],
            }
            for t in times()
        ],
    }  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inside = tmp_path / "hall"
    inside.mkdir()
    for name, aside in RUNS.items():
        (inside / f"{name}.json").write_text(json.dumps(sequence(aside)))
    return inside


def test_a_folder_of_files_is_one_scene(folder: Path) -> None:
    found = import_recordings(folder, "study_room")
    assert (found.scenes, found.trajectories, len(found.query_set), found.warnings) == (1, 3, 3, ())
    one = found.query_set.queries[0].trajectory_a
    assert one.outcome == Outcome.SUCCESS
    assert one.scene.goal_radius == 0.3
    assert {solid.kind for solid in one.scene.obstacles} == {"table", "wall"}
    assert any("the grid is left out" in how for how in one.recorded.how)
    assert {"people", "obstacles", "goal", "heading"} <= set(one.recorded.has)


def test_what_we_write_is_read_back_to_the_same_poses(tmp_path: Path) -> None:
    for number, query in enumerate(load_queries("study_room/queries_500").queries[:3]):
        ours = query.trajectory_a
        file = tmp_path / f"{number}.json"
        file.write_text(json.dumps(to_socnav3(ours, 0.18), allow_nan=False))
        (back,) = read_socnav3(file, Mapping())
        np.testing.assert_allclose(back.robot.poses[:, :2], ours.poses[:, :2], atol=1e-5)
        assert back.goal.radius == pytest.approx(ours.scene.goal_radius)
        assert len(back.people) == 1
        assert len(back.things) == len(ours.scene.obstacles) + 16  # four edges of each wall


def test_every_moment_has_what_the_schema_names(folder: Path) -> None:
    query = import_recordings(folder, "study_room").query_set.queries[0]
    written = to_socnav3(query.trajectory_a, 0.18)
    assert set(written) == {"metadata", "grid", "walls", "sequence"}
    for moment in written["sequence"]:
        assert set(moment) == {"timestamp", "robot", "goal", "people", "objects"}
        assert {"shape", "x", "y", "angle", "speed_x", "speed_y", "speed_a"} <= set(moment["robot"])
        assert moment["people"][0]["x"] == pytest.approx(ANNA[0])
    speeds = [math.hypot(m["robot"]["speed_x"], m["robot"]["speed_y"]) for m in written["sequence"][:-1]]
    assert 0.5 < min(speeds) <= max(speeds) < 1.2


def change(data: dict, **of_third) -> dict:
    changed = copy.deepcopy(data)
    changed["sequence"][2].update(of_third)
    return changed


WRONG = {
    "cut": (lambda d: json.dumps(d)[:-30], r"line 1: is no JSON .*; was it cut\?"),
    "NaN": (lambda d: json.dumps(change(d, timestamp=math.nan)), r"number = 'NaN': is none of JSON"),
    "no robot": (lambda d: json.dumps(change(d, robot=None)), r"sequence\[2\].robot: must be an object with x, y"),
    "no time": (lambda d: json.dumps(change(d, timestamp=None)), r"sequence\[2\].timestamp: is missing"),
    "time going back": (lambda d: json.dumps(change(d, timestamp=5)), r"sequence\[2\], time of robot = 5.0: goes back"),
    "a person without a place": (
        lambda d: json.dumps(change(d, people=[{"id": 7, "x": "here", "y": 0, "angle": 0}])),
        r"sequence\[2\].people\[0\].x = 'here': must be a finite number",
    ),
    "an object of no size": (
        lambda d: json.dumps(change(d, objects=[{"id": 3, "x": 0, "y": 0, "angle": 0}])),
        r"objects\[0\].shape: must be an object with type, width",
    ),
    "no sequence": (lambda d: json.dumps({"walls": []}), r"sequence = \['walls'\]: is missing; SocNav3 has sequence"),
    "an empty sequence": (lambda d: json.dumps({**d, "sequence": []}), r"duration = 0.0: at least 1 s"),
    "deep": (lambda d: "[" * 40 + "]" * 40, r"line 1: more than 32 objects and lists within each other"),
    "many values": (lambda d: "[" + "0," * 5_000_001 + "0]", r"values = 5000002: at most 5000000"),
    "a text without an end": (lambda d: '"' + '\\"' * 1_000_000 + "\\", r"is no JSON"),
    "a long number": (lambda d: json.dumps(d).replace("0.7", "9" * 5_000, 1), r""),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_named_by_field(folder: Path, wrong: str) -> None:
    spoil, message = WRONG[wrong]
    (folder / "wide.json").write_text(spoil(sequence(0.3)))
    if not message:
        import_recordings(folder, "study_room")
        return
    with pytest.raises(RecordingError, match=rf"wide.json.*{message}"):
        import_recordings(folder, "study_room")


def test_socnav1_says_what_it_is(tmp_path: Path) -> None:
    """A line as its data has them."""
    line = {"score": 79, "identifier": "01792 B", "room": [[-299, -47], [-170, 346]], "links": [], "objects": [],
            "humans": [{"yPos": 180, "xPos": -31, "id": 1, "orientation": -139}], "robot": {"id": 0}}  # fmt: skip
    (tmp_path / "a.json").write_text(f"{json.dumps(line)}\n" * 3)
    with pytest.raises(RecordingError, match="is SocNav1: moments without motion"):
        import_recordings(tmp_path, "study_room")


values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "y", "angle", "id", "shape"]), inner)
    ),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    where=st.sampled_from(["timestamp", "robot", "people", "objects", "goal", "walls", "sequence", "grid"]),
    value=values,
)
def test_whatever_stands_there_is_read_or_refused_with_its_place(tmp_path: Path, where: str, value: object) -> None:
    data = sequence(0.3)
    if where in data:
        data[where] = value
    else:
        data["sequence"][2][where] = value
    file = tmp_path / "any.json"
    file.write_text(json.dumps(data))
    assert refusal(read_socnav3, file) in ("", "any.json")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200), st.integers(0, 4_000))
def test_bytes_in_the_middle_are_read_or_refused(tmp_path: Path, noise: bytes, at: int) -> None:
    whole = json.dumps(sequence(0.3)).encode()
    file = tmp_path / "any.json"
    file.write_bytes(whole[:at] + noise + whole[at:])
    assert refusal(read_socnav3, file) in ("", "any.json")


def test_a_grid_stands_for_walls_where_no_walls_are_named(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    for name, aside in RUNS.items():
        told = sequence(aside) | {"walls": []}
        (tmp_path / "hall" / f"{name}.json").write_text(json.dumps(told))
    one = import_recordings(tmp_path / "hall", "study_room").query_set.queries[0].trajectory_a
    (wall,) = [thing for thing in one.scene.obstacles if thing.kind == "wall"]
    assert (wall.pose.x, wall.pose.y, wall.length, wall.width) == (1.5, 0.5, 1.0, 1.0)
    broken = sequence(0.0) | {"walls": []}
    broken["grid"]["data"] = [[0, 1, 1]]
    (tmp_path / "hall" / "wide.json").write_text(json.dumps(broken))
    with pytest.raises(RecordingError, match="grid, data = 3: cells, 2 x 1 are 2"):
        import_recordings(tmp_path / "hall", "study_room")
