"""People judge my recordings in a study like any other, and report and export say what they were."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from desirepath.recordings.importing import import_recordings
from desirepath.report.study_report import write_study_report
from desirepath.report.tidy_tables import read_folder, read_study
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Artefact, Study
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import StudyError, create_study
from desirepath_stage.views import camera_for
from tests.recordings.walks import csv_of, rows
from tests.study.small_protocol import RATING, VIEWS, small_protocol

BLOCK = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2}}]}}
HEADS = "run,who,time_s,x_m,y_m,yaw_rad"


@pytest.fixture
def open_study(tmp_path: Path, database: Database, files: ArtefactStore, hall: Path):
    """Opens a study of these stages about recordings; people: whether any were recorded."""

    def opened(*stages: dict, people: bool = True, **keys) -> Study:
        if not people:
            hall.write_text(csv_of(HEADS, [row for row in rows() if row[1] == "robot"]))
        found = import_recordings(hall, "study_room")
        found.query_set.save(tmp_path / "mine.npz")
        frozen = small_protocol(tmp_path, list(stages), query_set=str(tmp_path / "mine.npz"), **keys)
        with database.transaction() as s:
            return create_study(s, files, frozen, name="Mine", created_by=None)

    return opened


@pytest.mark.parametrize("people", [True, False], ids=["with people", "with nobody"])
def test_a_session_about_recordings_goes_to_its_end(
    tmp_path: Path, database: Database, files: ArtefactStore, open_study, people: bool
) -> None:
    study = open_study(BLOCK, RATING, people=people)
    with database.session() as s:
        query_set = s.get_one(Artefact, s.get_one(Study, study.id).protocol["materials"]["query_set"])
        assert query_set.card["recorded"]["has"] == ["poses", "heading", *["people"] * people]
        assert list(query_set.card["recorded"]["files"]) == ["hall.csv"]
        assert not query_set.simulated

    from desirepath.study.simulated.participant import Character

    walked = walk_in_process(database, files, study, 2, Character("shortest" if people else "random"))
    assert walked["completed"] == 2

    written = export_study(database, files, study.id, tmp_path / "out")
    assert written["study"] == study.id
    table = pq.read_table(tmp_path / "out" / "trajectories.parquet").to_pylist()
    assert all(row["made_by"].endswith(":hall.csv") for row in table)
    metrics = pq.read_table(tmp_path / "out" / "trajectory_metrics.parquet").to_pylist()
    assert all((row["min_human_distance_m"] is not None) == people for row in metrics)
    assert all(row["path_length_m"] > 5 for row in metrics)
    steps = pq.read_table(tmp_path / "out" / "trajectory_steps.parquet")
    assert steps["action_linear"].null_count == steps["reward"].null_count == steps.num_rows
    one = Trajectory.load(tmp_path / "out" / "trajectories" / f"{table[0]['trajectory']}.npz")
    assert one.recorded.file == "hall.csv"

    data, load = read_folder(tmp_path / "out")
    told = write_study_report(data, load, tmp_path / "report", who="simulated", command="desirepath studies report")
    assert told["answers"] == 4
    assert "nan" not in (tmp_path / "report" / "findings.json").read_text().lower()
    with database.session() as s:
        here, _ = read_study(s, files, s.get_one(Study, study.id))
    assert len(here.choices) == len(data.choices)

    elsewhere = Database(f"sqlite:///{tmp_path / 'elsewhere.sqlite'}")
    elsewhere.migrate()
    assert import_dataset(elsewhere, ArtefactStore((tmp_path / "there").as_uri()), tmp_path / "out")
    elsewhere.close()


def test_a_protocol_that_needs_what_was_not_recorded_is_refused(open_study) -> None:
    crossed = {"block": {"each": VIEWS, "trials": [{"queries": {"count": 2}}]}}
    with pytest.raises(StudyError, match="people were not recorded, view first_person needs them"):
        open_study(crossed, people=False)
    chosen = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2, "choose": "information"}}]}}
    with pytest.raises(StudyError, match="people were not recorded, choose: information needs them"):
        open_study(chosen, people=False)
    with pytest.raises(StudyError, match="observations were not recorded, train needs them"):
        open_study(BLOCK, {"train": {"while": {"questionnaire": "rating"}}}, {"comparison": {"scenes": 2}})
    with pytest.raises(StudyError, match="each recording has a scene of its own"):
        open_study({"order": {"view": "top_down", "count": 1, "of": 3}})


def test_the_stage_frames_a_scene_with_nobody(hall: Path) -> None:
    hall.write_text(csv_of(HEADS, [row for row in rows() if row[1] == "robot"]))
    query = import_recordings(hall, "study_room").query_set.queries[0]
    pair = [query.trajectory_a, query.trajectory_b]
    camera = camera_for(query.scene, "top_down", pair, close=True, goal=True)
    assert camera.frame[2] - camera.frame[0] > 5
    assert json.dumps(query.scene.as_dict())
