"""I have videos of my real robot, and want people to say which they would rather live with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desirepath.learning.queries.queries import QuerySet
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.recording import RecordingError
from desirepath.recordings.videos import read_video
from desirepath.simulation.recorded import NotRecordedError
from desirepath.simulation.trajectory import Trajectory, require_poses
from desirepath.store.artefacts import ArtefactError, ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Artefact
from desirepath.store.query_sets import save_query_set
from desirepath.study.studies import StudyError, create_study
from tests.recordings.films import mp4, webm
from tests.recordings.walks import csv_of, rows
from tests.study.small_protocol import RATING, small_protocol

BLOCK = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2}}]}}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three videos in pairs; the first has poses."""
    made = tmp_path / "films"
    made.mkdir()
    (made / "one.mp4").write_bytes(mp4(8.0))
    (made / "two.webm").write_bytes(webm(3.0))
    (made / "three.webm").write_bytes(webm(None))
    (made / "hall.csv").write_text(csv_of("run,who,time_s,x_m,y_m,yaw_rad", list(rows())))
    (made / "pairs.csv").write_text(
        "a,b,poses_a,poses_b,seconds_a,seconds_b\none.mp4,two.webm,wide,,,\nthree.webm,two.webm,,,2.5,\n"
    )
    return made


@pytest.mark.parametrize(
    ("name", "content", "seconds", "media"),
    [
        ("a.mp4", mp4(3.0), 3.0, "video/mp4"),
        ("a.mp4", mp4(4.5, long=True), 4.5, "video/mp4"),
        ("a.MP4", mp4(5.0, fragments=True), 5.0, "video/mp4"),
        ("a.webm", webm(2.25), 2.25, "video/webm"),
    ],
)
def test_how_long_a_video_is_stands_in_its_container(tmp_path, name, content, seconds, media):
    (tmp_path / name).write_bytes(content)
    found = read_video(tmp_path / name)
    assert (found.duration_s, found.media, found.bytes) == (seconds, media, len(content))


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("cut.mp4", mp4()[:-20], "is cut: this part has 72 bytes"),
        ("no_index.mp4", mp4()[:16] + mp4()[-72:], "has no index"),
        ("renamed.mp4", webm(), "is no MP4, which begins with 'ftyp'; was it renamed"),
        ("renamed.webm", mp4(), "is no WebM"),
        ("page.webm", b"<html><script>alert(1)</script>", "is no WebM"),
        ("page.mp4", b"\0\0\0\x20<html><script>alert(1)</script>", "is no MP4"),
        ("matroska.webm", webm(doctype=b"matroska"), "must be webm"),
        ("sound.mp4", mp4(handler=b"soun"), "has no pictures"),
        ("sound.webm", webm(track=2), "has no pictures"),
        ("cut.webm", webm()[:-10], "is cut"),
        ("silent.webm", webm(None), "a column seconds_a or seconds_b in pairs.csv does"),
        ("long.mp4", mp4(4_000), "people watch it to its end"),
        ("empty.mp4", b"", "must be 1 to"),
        ("film.avi", b"RIFF", "is no video; MP4 and WebM are shown"),
    ],
)
def test_a_file_that_cannot_be_shown_says_why(tmp_path, name, content, why):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=why) as refused:
        read_video(tmp_path / name)
    assert name in str(refused.value)


@settings(max_examples=300, deadline=None)
@given(kind=st.sampled_from([mp4(), webm(), mp4(fragments=True)]), data=st.data())
def test_whatever_a_file_holds_it_is_read_or_refused(tmp_path_factory, kind, data):
    content = bytearray(kind)
    for at in data.draw(st.lists(st.integers(0, len(kind) - 1), max_size=4)):
        content[at] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(1, len(kind)))]
    file = tmp_path_factory.mktemp("film") / ("x.mp4" if kind[4:8] == b"ftyp" else "x.webm")
    file.write_bytes(content)
    try:
        seconds = read_video(file).duration_s
    except RecordingError:
        return
    assert 0 < seconds <= 300


def test_videos_become_pairs_with_poses_where_there_are(folder: Path) -> None:
    found = import_recordings(folder, "study_room")
    assert len(found.query_set) == 2
    one, two = found.query_set.queries[0].trajectory_a, found.query_set.queries[0].trajectory_b
    assert one.recorded.has == ("poses", "heading", "people", "video")
    assert np.isfinite(one.poses).all()
    assert two.recorded.has == ("video",)
    assert np.isnan(two.poses).all()
    assert (one.duration_s, two.duration_s) == (8.0, 3.0)
    assert found.query_set.queries[1].trajectory_a.duration_s == 2.5
    assert {one["format"] for one in found.lineage} == {"csv", "video"}
    again = QuerySet.from_bytes(found.query_set.to_bytes())
    assert again.queries[0].trajectory_b.recorded == two.recorded
    assert Trajectory.from_bytes(two.to_bytes()).recorded == two.recorded
    require_poses([one])
    with pytest.raises(NotRecordedError, match="only a video was recorded"):
        require_poses([two])


def test_pairs_of_videos_are_named_and_fit(folder: Path) -> None:
    (folder / "pairs.csv").write_text("a,b,poses_a\none.mp4,two.webm,gone\n")
    with pytest.raises(RecordingError, match="no run of that name"):
        import_recordings(folder, "study_room")
    (folder / "pairs.csv").write_text("a,b,seconds_b,poses_a\none.mp4,three.webm,3,\none.mp4,gone.mp4,,\n")
    with pytest.raises(RecordingError, match=r"gone\.mp4"):
        import_recordings(folder, "study_room")
    (folder / "pairs.csv").write_text("a,b,poses_b,seconds_b\none.mp4,two.webm,wide,\none.mp4,three.webm,,2\n")
    with pytest.raises(RecordingError, match="cut both to the same"):
        import_recordings(folder, "study_room")
    (folder / "pairs.csv").unlink()
    (folder / "three.webm").unlink()
    with pytest.raises(RecordingError, match="videos are not proposed"):
        import_recordings(folder, "study_room")


def test_a_study_of_videos_goes_to_its_end_and_its_data_hold_them(
    tmp_path: Path, database: Database, files: ArtefactStore, folder: Path
) -> None:
    from desirepath.study.simulated.in_process import walk_in_process
    from desirepath.study.simulated.participant import Character

    found = import_recordings(folder, "study_room")
    found.query_set.save(tmp_path / "films.npz")
    with pytest.raises(ArtefactError, match="is not here"), database.transaction() as s:
        save_query_set(s, files, found.query_set, name="Films", card={})
    with database.transaction() as s:
        save_query_set(s, files, found.query_set, name="Films", card={}, videos=found.videos)
        frozen = small_protocol(tmp_path, [BLOCK, RATING], query_set=str(tmp_path / "films.npz"))
        study = create_study(s, files, frozen, name="Mine", created_by=None)
    walked = walk_in_process(database, files, study, 2, Character("shortest"))
    assert walked["completed"] == 2
    export_study(database, files, study.id, tmp_path / "out")
    assert {one.suffix for one in (tmp_path / "out" / "videos").iterdir()} == {".mp4", ".webm"}
    measured = pq.read_table(tmp_path / "out" / "trajectory_metrics.parquet").to_pylist()
    assert sorted(one["time_s"] for one in measured if one["path_length_m"] is None) == [2.5, 3.0]
    elsewhere = Database(f"sqlite:///{tmp_path / 'elsewhere.sqlite'}")
    elsewhere.migrate()
    there = ArtefactStore((tmp_path / "there").as_uri())
    assert import_dataset(elsewhere, there, tmp_path / "out")
    with elsewhere.session() as s:
        assert s.query(Artefact).filter(Artefact.kind == "video").count() == 3
    elsewhere.close()
    trains = [BLOCK, {"train": {"while": {"questionnaire": "rating"}}}, {"comparison": {"scenes": 2}}]
    frozen = small_protocol(tmp_path, trains, query_set=str(tmp_path / "films.npz"))
    with pytest.raises(StudyError, match="were not recorded, train needs them"), database.transaction() as s:
        create_study(s, files, frozen, name="Trains", created_by=None)


def test_who_is_in_recordings_goes_with_them(database: Database, files: ArtefactStore, folder: Path) -> None:
    from desirepath.store.artefact_upkeep import delete_artefact
    from desirepath.store.imported_answers import ImportedAnswer, save_imported_answers
    from desirepath.store.models import TrajectoryRow
    from desirepath.store.outbox import enqueue_job

    found = import_recordings(folder, "study_room")
    other = replace(found.query_set, queries=found.query_set.queries[1:])
    with database.transaction() as s:
        queries = save_query_set(s, files, found.query_set, name="Films", card={}, videos=found.videos).id
        kept = save_query_set(s, files, other, name="One", card={}, videos=found.videos).id
        given = [ImportedAnswer(2, 0, "a", "p1"), ImportedAnswer(3, 1, "b", "p2")]
        source = {"file": "mine.csv", "sha256": "0" * 64}
        snapshot = save_imported_answers(s, files, s.get_one(Artefact, queries), given, name="Mine", source=source).id
        job = enqueue_job(s, "reward_model", {"snapshot": snapshot})
    with pytest.raises(ArtefactError, match="1 were made from it: Mine"), database.transaction() as s:
        delete_artefact(s, files, queries)
    with pytest.raises(ArtefactError, match="jobs stand on it"), database.transaction() as s:
        delete_artefact(s, files, snapshot)
    with database.transaction() as s:
        ended = s.get_one(type(job), job.id)
        ended.state, ended.result = "succeeded", {"held_out": [{"participant": "p1", "accuracy": 0.5}], "answers": 2}
    with database.transaction() as s:
        delete_artefact(s, files, snapshot)
        delete_artefact(s, files, queries)
        assert s.get_one(type(job), job.id).result == {"held_out": [], "answers": 2}
    assert not files.exists(snapshot)
    with database.session() as s:
        assert sorted(one.name for one in s.query(Artefact)) == ["One", "three.webm", "two.webm"]
        assert s.query(TrajectoryRow).count() == 2
    with database.transaction() as s:
        delete_artefact(s, files, kept)
    assert list(files.names()) == []
