"""I have a Minari or LeRobot data set of my robot's episodes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from desirepath.learning.policies.shipped import load_queries
from desirepath.recordings.episodes import read_lerobot, read_minari
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Keys, Mapping
from desirepath.recordings.recording import BOUNDS, RecordingError
from desirepath.store.dataset.minari_episodes import MinariWriter
from desirepath.store.models import TrajectoryRow
from tests.recordings.walks import ANNA, RUNS, refusal, robot_at, times

FEATURES = {
    "observation.state": {"dtype": "float32", "shape": [3], "names": {"axes": ["x", "y", "theta"]}},
    "observation.people": {"dtype": "float32", "shape": [2], "names": None},
    "action": {"dtype": "float32", "shape": [2], "names": ["v", "w"]},
}


def lerobot(folder: Path, *, version: str = "v3.0", features: dict | None = None, **columns: object) -> Path:
    """A data set of three episodes, in the columns that lerobot writes."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    about = {"codebase_version": version, "fps": 10, "features": features or FEATURES}
    (folder / "meta" / "info.json").write_text(json.dumps(about))
    rows = [(k, float(t), robot_at(float(t), aside)) for k, aside in enumerate(RUNS.values()) for t in times()]
    table = {
        "observation.state": pa.array([list(place) for _, _, place in rows], pa.list_(pa.float32(), 3)),
        "observation.people": pa.array([list(ANNA[:2]) for _ in rows], pa.list_(pa.float32())),
        "action": pa.array([[0.0, 0.0] for _ in rows], pa.list_(pa.float32(), 2)),
        "timestamp": pa.array([t for _, t, _ in rows], pa.float32()),
        "episode_index": pa.array([k for k, _, _ in rows], pa.int64()),
        **columns,
    }
    pq.write_table(pa.table(table), folder / "data" / "chunk-000" / "file-000.parquet")
    return folder


def test_episodes_of_lerobot_are_runs_of_one_scene(tmp_path: Path) -> None:
    mapping = Mapping(people={"anna": Keys(field="observation.people", x=0, y=1)})
    found = import_recordings(lerobot(tmp_path / "mine"), "study_room", mapping)
    assert (found.scenes, found.trajectories, len(found.query_set)) == (1, 3, 3)
    one = found.query_set.queries[0].trajectory_a
    assert one.recorded.has == ("poses", "heading", "people")
    assert any("observations and actions are in the data set" in how for how in one.recorded.how)
    places = dict(enumerate(RUNS.values()))
    aside = places[int(one.recorded.run.removeprefix("mine/"))]
    np.testing.assert_allclose(one.poses, [robot_at(float(t), aside) for t in one.times], atol=1e-3)


def test_what_we_export_for_minari_is_read_back(tmp_path: Path) -> None:
    writer, ours = MinariWriter(tmp_path), load_queries("study_room/queries_500").queries[0].trajectory_a
    row = TrajectoryRow(id="a" * 64, setup="study_room", scene_hash="b" * 64, outcome=1)
    writer.add(row, ours)
    writer.close()
    (found,) = read_minari(tmp_path / "minari" / "desirepath" / "study_room-v0", Mapping())
    np.testing.assert_allclose(found.robot.poses, ours.poses, atol=1e-6)
    assert found.robot.times_s[-1] == pytest.approx(ours.duration_s)


def test_minari_as_arrow_is_read_with_a_mapping(tmp_path: Path) -> None:
    for k, aside in enumerate(RUNS.values()):
        folder = tmp_path / "theirs" / "data" / str(k)
        folder.mkdir(parents=True)
        places = pa.array([list(robot_at(float(t), aside)) for t in times()], pa.list_(pa.float64()))
        table = pa.table({"observations": pa.StructArray.from_arrays([places], names=["pose"])})
        with pa.OSFile(str(folder / "data.arrow"), "wb") as out, pa.ipc.new_file(out, table.schema) as writer:
            writer.write_table(table, max_chunksize=20)
    (tmp_path / "theirs" / "data" / "metadata.json").write_text('{"data_format": "arrow", "dataset_id": "theirs-v0"}')
    mapping = Mapping(robot=Keys(field="observations.pose", x=0, y=1, yaw=2), dt_s=0.1)
    found = import_recordings(tmp_path / "theirs", "study_room", mapping)
    assert found.trajectories == 3
    with pytest.raises(RecordingError, match="dt_s: episodes have no times"):
        read_minari(tmp_path / "theirs", Mapping())
    (tmp_path / "theirs" / "data" / "metadata.json").write_text('{"dataset_id": "theirs-v0"}')
    with pytest.raises(RecordingError, match="data_format = 'hdf5': arrow and parquet are read"):
        read_minari(tmp_path / "theirs", mapping)


COUNT = len(RUNS) * len(times())
WRONG = {
    "an older version": ({"version": "v2.1"}, r"codebase_version = 'v2.1': only v3.0 is read"),
    "nothing says where x is": (
        {"features": {"observation.state": {"dtype": "float32", "shape": [3], "names": ["a", "b", "c"]}}},
        r"features = \['observation.state'\]: none names x and y; `robot:",
    ),
    "NaN poses": (
        {"observation.state": pa.array([[0.0, float("nan"), 0.0]] * COUNT, pa.list_(pa.float32(), 3))},
        r"row 0, y of the robot = nan",
    ),
    "time going back": (
        {"timestamp": pa.array([0.0 if k == 3 else 0.1 * k for k in range(COUNT)], pa.float32())},
        r"row 3, time of the robot = 0.0: goes back",
    ),
    "no numbers": ({"observation.state": pa.array(["x"] * COUNT)}, r"column observation.state = 'string': must hold"),
    "empty cells": ({"timestamp": pa.array([None] * COUNT, pa.float32())}, r"column timestamp, row 0: is empty"),
    "lists of several lengths": (
        {"observation.state": pa.array([[0.0] * (2 + k % 2) for k in range(COUNT)])}, r"= \[2, 3\]: lists must be"
    ),
    "too few numbers": ({"observation.state": pa.array([[0.0]] * COUNT)}, r"the robot, y = 1: there are 1 numbers"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_named(tmp_path: Path, wrong: str) -> None:
    changed, message = WRONG[wrong]
    with pytest.raises(RecordingError, match=message):
        import_recordings(lerobot(tmp_path / "mine", **changed), "study_room")


def test_a_missing_column_names_those_there_are(tmp_path: Path) -> None:
    mapping = Mapping(robot=Keys(field="observation.pose"))
    with pytest.raises(RecordingError, match=r"columns = 'observation.pose': no such column; .* observation.state"):
        import_recordings(lerobot(tmp_path / "mine"), "study_room", mapping)


def test_a_bomb_of_rows_is_refused_before_it_is_read(tmp_path: Path) -> None:
    folder = lerobot(tmp_path / "mine")
    bomb = pa.table({"episode_index": pa.array(np.zeros(10_000_000, np.int64)), "timestamp": np.zeros(10_000_000),
                     "observation.state": np.zeros(10_000_000)})  # fmt: skip
    pq.write_table(bomb, folder / "data" / "chunk-000" / "file-000.parquet")
    assert (folder / "data" / "chunk-000" / "file-000.parquet").stat().st_size < 2**20
    with pytest.raises(RecordingError, match="rows = 10000000: at most 2000000 are read"):
        import_recordings(folder, "study_room")


def test_types_and_rows_of_all_files_are_looked_at_before_a_file_is_read(tmp_path: Path, monkeypatch) -> None:
    folder = lerobot(tmp_path / "mine")
    file = folder / "data" / "chunk-000" / "file-000.parquet"
    file.with_name("file-001.parquet").write_bytes(file.read_bytes())
    read, whole = [], pq.ParquetFile.read
    monkeypatch.setattr(pq.ParquetFile, "read", lambda self, **asked: read.append(asked) or whole(self, **asked))
    with pytest.raises(RecordingError, match=f"file-001.parquet, rows = {2 * COUNT}: at most {COUNT + 1} are read of"):
        read_lerobot(folder, Mapping(), replace(BOUNDS, rows=COUNT + 1))
    assert len(read) == 1
    text = lerobot(tmp_path / "text", **{"observation.state": pa.array(["x" * 1_000] * COUNT)})
    with pytest.raises(RecordingError, match="must hold numbers"):
        read_lerobot(text, Mapping())
    assert len(read) == 1


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 20_000), st.binary(min_size=1, max_size=16))
def test_whatever_bytes_stand_there_it_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, at: int, noise: bytes
) -> None:
    folder = lerobot(tmp_path_factory.mktemp("any") / "mine")
    file = folder / "data" / "chunk-000" / "file-000.parquet"
    whole = file.read_bytes()
    at %= len(whole)
    file.write_bytes(whole[:at] + noise + whole[at + len(noise) :])
    refusal(read_lerobot, folder)


def test_a_data_set_is_found_in_whatever_folder_it_lies(tmp_path: Path) -> None:
    lerobot(tmp_path / "all" / "of" / "mine")
    found = import_recordings(tmp_path / "all", "study_room")
    assert (found.scenes, found.trajectories) == (1, 3)
