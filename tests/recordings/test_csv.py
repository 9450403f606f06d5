"""I have a CSV of my robot's runs and want people to judge them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from desirepath.analysis.metrics import measure
from desirepath.cli.main import app
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.rewards.interface import fit_interface
from desirepath.learning.rewards.mlp import fit_mlp
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Mapping, read_mapping
from desirepath.recordings.recording import BOUNDS, RecordingError
from desirepath.simulation.recorded import NotRecordedError
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.trajectory import Outcome, Trajectory
from tests.recordings.walks import ANNA, RUNS, csv_of, robot_at, rows, times

HEADS = "run,who,time_s,x_m,y_m,yaw_rad"


def test_my_runs_become_pairs_of_one_scene(hall: Path) -> None:
    found = import_recordings(hall, "study_room")
    assert (found.scenes, found.trajectories, len(found.query_set)) == (1, 3, 3)
    first = found.query_set.queries[0]
    runs = {one.recorded.run for one in (first.trajectory_a, first.trajectory_b)}
    assert runs == {"straight", "other_side"}  # those that differ most come first


def test_poses_are_where_the_robot_was_at_every_control_step(hall: Path) -> None:
    found = import_recordings(hall, "study_room")
    trajectories = {q.trajectory_a.recorded.run: q.trajectory_a for q in found.query_set.queries}
    wide = trajectories["wide"]
    assert len(wide.poses) == 41  # 8 s at 5 Hz
    truth = np.array([robot_at(float(t), RUNS["wide"]) for t in wide.times])
    np.testing.assert_allclose(wide.poses, truth, atol=1e-3)
    assert wide.scene.person.pose.x == pytest.approx(ANNA[0])
    assert "linear interpolation" in wide.recorded.how[0]


def test_what_was_not_recorded_is_absent(hall: Path) -> None:
    one = import_recordings(hall, "study_room").query_set.queries[0].trajectory_a
    assert one.recorded.has == ("poses", "heading", "people")
    assert one.observations.shape == one.actions.shape == (40, 0)
    assert np.isnan(one.rewards).all()
    assert {"lidar", "actions", "observations", "rewards", "goal"} <= set(one.recorded.absent)


def test_without_people_there_is_nobody_and_distances_to_them_are_unknown(imported) -> None:
    alone = [row for row in rows() if row[1] == "robot"]
    found = imported(csv_of(HEADS, alone))
    one = found.query_set.queries[0].trajectory_a
    assert not one.scene.has_person
    assert Scene.from_dict(json.loads(json.dumps(one.scene.as_dict()))) == one.scene
    with pytest.raises(SceneError, match="'person' = None: was not recorded"):
        _ = one.scene.person.pose
    measured = measure([one])
    assert np.isnan(measured.min_human_distance).all()
    assert np.isnan(measured.social.personal_space_time).all()
    assert measured.path_length[0] > 5.0
    assert np.isfinite(measured.social.stalled_time).all()


def test_a_file_and_back_is_the_same_set(hall: Path, tmp_path: Path) -> None:
    found = import_recordings(hall, "study_room").query_set
    found.save(tmp_path / "set.npz")
    back = QuerySet.load(tmp_path / "set.npz")
    assert back.digest() == found.digest()
    for before, after in zip(found.queries, back.queries, strict=True):
        assert before.trajectory_b.recorded == after.trajectory_b.recorded
        assert before.trajectory_b.scene == after.trajectory_b.scene
        assert Trajectory.from_bytes(after.trajectory_a.to_bytes()).digest() == after.trajectory_a.digest()


def test_other_names_and_units_stand_in_a_mapping(imported) -> None:
    lines = [(run, who, round(t * 1000), 100 * x, 100 * y, math.degrees(yaw)) for run, who, t, x, y, yaw in rows()]
    mapping = """
columns: {run: Versuch, who: Wer, time: Zeit, x: Rechts, y: Hoch, yaw: Blick}
units: {length: cm, angle: deg, time: ms}
"""
    theirs = imported(csv_of("Versuch,Wer,Zeit,Rechts,Hoch,Blick", lines), mapping)
    usual = imported(csv_of(HEADS, rows()), name="usual.csv")
    for one, other in zip(theirs.query_set.queries, usual.query_set.queries, strict=True):
        np.testing.assert_allclose(one.trajectory_a.poses, other.trajectory_a.poses, atol=1e-4)


def test_a_column_for_each_body_is_read_as_well(imported) -> None:
    lines = [
        (run, t, *robot_at(t, aside), 3.0, 0.9 if t < 4 else "")
        for run, aside in RUNS.items()
        for t in map(float, times())
    ]
    lines = [(*line[:5], line[5] if line[6] != "" else "", line[6]) for line in lines]
    found = imported(
        csv_of("run;time [s];robot_x [m];robot_y [m];robot_yaw [rad];bo_x [m];bo_y [m]", lines).replace(",", ";")
    )
    one = found.query_set.queries[0].trajectory_a
    assert one.recorded.has == ("poses", "heading", "people")
    assert any("'bo' was not seen for 4.1 s" in warning for warning in found.warnings)


def test_goal_and_obstacles_come_along(imported) -> None:
    further = [(run, "goal", 0, 5.6, 0, 0, "", "", "goal") for run in RUNS] + [
        ("", "table", 0, 2.0, -3.0, 0.5, 1.2, 0.8, "obstacle")
    ]
    lines = [(*row, "", "", "robot" if row[1] == "robot" else "person") for row in rows()] + further
    found = imported(csv_of(f"{HEADS},length_m,width_m,kind", lines))
    one = found.query_set.queries[0].trajectory_a
    assert one.outcome == Outcome.SUCCESS
    assert (one.scene.goal.x, one.scene.obstacles[0].kind, one.scene.obstacles[0].length) == (5.6, "table", 1.2)
    assert not found.warnings
    assert set(one.recorded.has) == {"poses", "heading", "people", "obstacles", "goal"}
    assert measure([one]).min_obstacle_distance[0] < 3


def test_i_say_which_pairs_are_asked(hall: Path) -> None:
    (hall.parent / "pairs.csv").write_text("a,b\nwide,straight\n")
    found = import_recordings(hall.parent, "study_room")
    (query,) = found.query_set.queries
    assert (query.trajectory_a.recorded.run, query.trajectory_b.recorded.run) == ("wide", "straight")
    assert len(import_recordings(hall.parent, "study_room", pairs="proposed").query_set) == 3
    (hall.parent / "pairs.csv").write_text("a,b\nwide,stright\n")
    with pytest.raises(
        RecordingError, match=r"pairs.csv, pair 1, b = 'stright': no run of that name; there are straight"
    ):
        import_recordings(hall.parent, "study_room")


def test_a_long_file_is_cut_into_runs(imported) -> None:
    one = [row for row in rows() if row[0] == "wide"]
    mapping = """
runs:
  - {name: first, from_s: 0, to_s: 3.5}
  - {name: second, from_s: 3.5, goal: {x: 5.6, y: 0.0, radius_m: 0.4}}
pairs: [[first, second]]
"""
    found = imported(csv_of(HEADS, one), mapping)
    (query,) = found.query_set.queries
    assert query.trajectory_a.duration_s == pytest.approx(3.4, abs=0.11)
    assert query.trajectory_b.outcome == Outcome.SUCCESS


def test_a_pause_and_a_goal_for_all_runs_are_no_fault_of_a_file_that_is_cut(imported) -> None:
    lines = [("robot", t + 20 * k, *robot_at(t, aside)) for k, aside in enumerate((0.0, 0.6)) for t in times()]
    cut = "runs:\n  - {name: first, from_s: 0, to_s: 8}\n  - {name: second, from_s: 20, to_s: 28}\n"
    found = imported(csv_of("who,time_s,x_m,y_m,yaw_rad", lines), cut)
    assert found.trajectories == 2
    with pytest.raises(RecordingError, match="nothing is known of robot in run 'walk' for 12 s"):
        imported(csv_of("who,time_s,x_m,y_m,yaw_rad", lines))
    goal = [*rows(), ("", "goal", "", 3.5, 0.2, "")]
    found = imported(csv_of(HEADS, goal))
    assert {query.scene.goal.x for query in found.query_set.queries} == {3.5}


def test_reward_models_of_steps_refuse_and_say_what_is_missing(hall: Path) -> None:
    query = import_recordings(hall, "study_room").query_set.queries[0]
    answers = [Preference(query.trajectory_a, query.trajectory_b), Preference(query.trajectory_b, query.trajectory_a)]
    for fit in (fit_mlp, fit_interface):
        with pytest.raises(NotRecordedError, match=r"hall\.csv: observations and actions were not recorded"):
            fit(answers)


WRONG = {
    "a cell that is no number": (
        f"{HEADS}\nr,robot,0,0,0,0\nr,robot,0.1,eins,0,0\n",
        r"line 3, column x_m = 'eins': must be a",
    ),
    "NaN poses": (f"{HEADS}\nr,robot,0,0,0,0\nr,robot,0.1,nan,0,0\n", r"line 3, column x_m = 'nan': must be a finite"),
    "time going back": (
        f"{HEADS}\nr,robot,0,0,0,0\nr,robot,0.2,0,0,0\nr,robot,0.1,0,0,0\n",
        r"line 4, time of robot in run 'r' = 0.1: goes back from 0.2 s",
    ),
    "no unit": (
        "run,who,time,x_m,y_m\nr,robot,0,0,0\n",
        r"head = 'time': names no unit; write it behind the name, as time_s",
    ),
    "an unknown unit": ("run,who,time_s,x [furlong],y_m\nr,robot,0,0,0\n", r"unit 'furlong' is unknown; known: m, cm"),
    "no robot": (f"{HEADS}\nr,anna,0,0,0,0\nr,anna,1,0,0,0\n", r"walk.csv = \['anna'\]: no robot in it"),
    "no place": ("run,who,time_s,y_m\nr,robot,0,0\n", r"no column for x; name it x or map it with `columns`"),
    "an empty file": ("", r"walk.csv: is empty \(0 bytes\)"),
    "heads alone": (f"{HEADS}\n", r"no robot in it"),
    "a torn row": (f"{HEADS}\nr,robot,0,0,0,0\nr,robot\n", r"line 3 = 2: cells, the heads are 6"),
    "two robots in one run": (
        f"{HEADS}\nr,robot,0,0,0,0\nr,robot,0,5,0,0\nr,robot,1,0,0,0\n",
        r"line 3, time of robot in run 'r' = 0.0: robot in run 'r' is at two places at one time",
    ),
    "wrong frame": (
        f"{HEADS}\nr,robot,0,452000,5411000,0\nr,robot,0.1,452000,5411000,0\n",
        r"`origin: \[x, y\]` in the mapping",
    ),
    "a jump": (f"{HEADS}\nr,robot,0,0,0,0\nr,robot,0.1,9,0,0\n", r"jumps 9 m in 0.1 s; is the unit right"),
    "a gap": (f"{HEADS}\nr,robot,0,0,0,0\nr,robot,9,0,0,0\n", r"nothing is known of robot in run 'r' for 9 s before"),
    "a moment": (f"{HEADS}\nr,robot,0,0,0,0\nr,robot,0.1,0,0,0\n", r"duration = 0.1: at least 1 s are needed"),
    "an open quote": (f'{HEADS}\nr,"robot,0,0,0,0\n', r"line 2"),
    "binary": ("\x00\x01\x02", r"is not UTF-8 text"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_named_with_its_line(imported, wrong: str) -> None:
    text, message = WRONG[wrong]
    with pytest.raises(RecordingError, match=message):
        imported(text)


def test_ten_million_rows_are_refused_before_they_are_read(imported) -> None:
    with pytest.raises(RecordingError, match="lines = 10000001: at most 2000000 rows are read"):
        imported(HEADS + "\n" * 10_000_001)
    few = replace(BOUNDS, rows=20)
    with pytest.raises(RecordingError, match="line 22 = 21: at most 20 rows"):
        imported(csv_of(HEADS, list(rows())[:39]), bounds=few)
    with pytest.raises(RecordingError, match=r"bytes = [0-9]+: at most 100 are read"):
        imported(csv_of(HEADS, rows()), bounds=replace(BOUNDS, file_bytes=100))


def test_a_mapping_is_checked_by_line(tmp_path: Path) -> None:
    file = tmp_path / "mapping.yaml"
    file.write_text("units: {length: yards}\nrun: []\n")
    with pytest.raises(
        RecordingError, match=r"mapping.yaml:1: units.length = 'yards': must be one of m, cm.*:2: run"
    ) as wrong:
        read_mapping(file)
    assert "runs" in str(wrong.value)


def test_a_setup_that_judges_by_observations_takes_no_recordings(hall: Path) -> None:
    with pytest.raises(RecordingError, match="crowd_hall': judges by what its robot was told"):
        import_recordings(hall, "crowd_hall", Mapping())


def test_the_command_writes_a_file_or_into_the_installation(hall: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine.npz"
    said = CliRunner().invoke(
        app, ["queries", "import", str(hall), "--setup", "study_room", "--out", str(out), "--json"]
    )
    assert said.exit_code == 0, said.output
    told = json.loads(said.stdout)
    assert {"scenes": 1, "trajectories": 3, "queries": 3}.items() <= told.items()
    assert len(told["warnings"]) == 3
    assert len(QuerySet.load(out)) == 3
    said = CliRunner().invoke(
        app, ["queries", "import", str(hall), "--setup", "study_room", "--data", str(tmp_path / "data"), "--json"]
    )
    assert len(json.loads(said.stdout)["query_set"]) == 64
    said = CliRunner().invoke(app, ["queries", "import", str(tmp_path / "gone"), "--setup", "study_room", "--json"])
    assert said.exit_code == 1
    assert "there is no such file or folder" in json.loads(said.stdout)["error"]
