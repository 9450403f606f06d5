"""I take our trajectories into the tools of others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.recordings.bags import read_bag
from desirepath.recordings.episodes import read_lerobot
from desirepath.recordings.exporting import unlike
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Keys, Mapping
from desirepath.recordings.socnav3 import read_socnav3

READ = {"socnav3": read_socnav3, "mcap": read_bag}


@pytest.fixture
def mine(hall: Path, tmp_path: Path) -> Path:
    import_recordings(hall, "study_room").query_set.save(tmp_path / "mine.npz")
    return tmp_path / "mine.npz"


def export(name: object, form: str, out: Path) -> dict:
    said = CliRunner().invoke(app, ["queries", "export", str(name), "--format", form, "--out", str(out), "--json"])
    return json.loads(said.stdout)


@pytest.mark.parametrize("form", READ)
def test_a_file_for_each_trajectory_reads_back_to_its_poses(mine: Path, tmp_path: Path, form: str) -> None:
    told = export(mine, form, tmp_path / "out")
    assert (told["trajectories"], len(told["files"])) == (3, 3)
    ours = {one.digest()[:12]: one for one in _of(mine)}
    for name in told["files"]:
        (back,) = READ[form](tmp_path / "out" / name, Mapping())
        one = ours[Path(name).stem.split("_")[1]]
        np.testing.assert_allclose(back.robot.poses, one.poses, atol=1e-5)
        np.testing.assert_allclose(back.robot.times_s - back.robot.times_s[0], one.times, atol=1e-3)


def test_all_of_them_as_lerobot(mine: Path, tmp_path: Path) -> None:
    export(mine, "lerobot", tmp_path / "out")
    found = read_lerobot(tmp_path / "out", Mapping(people={"anna": Keys(field="observation.person", x=0, y=1, yaw=2)}))
    for back, one in zip(found, _of(mine), strict=True):
        np.testing.assert_allclose(back.robot.poses, one.poses, atol=1e-5)
        np.testing.assert_allclose(back.people["anna"].poses[0, :2], [3.0, 0.9], atol=1e-5)
    about = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())
    table = pq.read_table(tmp_path / "out" / about["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(about["features"])
    assert (about["total_frames"], about["fps"]) == (len(table), 5)
    tasks = pq.read_table(tmp_path / "out" / "meta" / "tasks.parquet").to_pandas()
    assert tasks.iloc[0].name == "drive to the goal past people"
    described = json.loads((tmp_path / "out" / "meta" / "desirepath.json").read_text())
    assert described["episodes"][0]["recorded"]["file"] == "hall.csv"


def test_shipped_queries_go_out_as_well_but_over_nothing(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    assert "must be a new or an empty folder" in export("study_room/queries_500", "lerobot", tmp_path / "full")["error"]


def _of(file: Path) -> list:
    from desirepath.learning.queries.queries import QuerySet

    return unlike(t for query in QuerySet.load(file).queries for t in (query.trajectory_a, query.trajectory_b))
