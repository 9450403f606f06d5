"""Analysts' pages about what was recorded, and answered, elsewhere."""

from __future__ import annotations

import re

import pytest
from sqlalchemy import select

from desirepath.recordings.csv_tables import read_csv
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Mapping
from desirepath.store.imported_answers import ImportedAnswer, save_imported_answers
from desirepath.store.models import Artefact, Response, Session
from desirepath.store.query_sets import save_query_set
from desirepath.study.protocol.freezing import freeze
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath.web.analyst.recording_drafts import find_recording_draft
from tests.recordings.films import mp4, webm
from tests.recordings.walks import csv_of, robot_at, times
from tests.study.small_protocol import small_protocol
from tests.web.lab_services import QUICK, csrf


@pytest.fixture
def filmed(lab_services, tmp_path):
    """A study of two videos that a bot has answered."""
    films = tmp_path / "films"
    films.mkdir()
    (films / "one.mp4").write_bytes(mp4(2.0))
    (films / "two.webm").write_bytes(webm(3.0))
    (films / "pairs.csv").write_text("a,b\none.mp4,two.webm\n")
    found = import_recordings(films, "study_room")
    found.query_set.save(tmp_path / "films.npz")
    block = {"block": {"view": "top_down", "trials": [{"queries": {"count": 1}}]}}
    frozen = small_protocol(tmp_path, [block], query_set=str(tmp_path / "films.npz"))
    with lab_services.database.transaction() as s:
        save_query_set(s, lab_services.files, found.query_set, name="Films", card={}, videos=found.videos)
        study = create_study(s, lab_services.files, frozen, name="Films", created_by=None)
    walk_in_process(lab_services.database, lab_services.files, study, 1, Character("random"))
    return study


def test_a_preview_and_an_answer_show_the_videos_that_were_shown(lab, lab_services, filmed):
    preview = lab.get(f"/lab/studies/{filmed.id}/preview/2").text
    (one, two) = re.findall(r"/lab/videos/[0-9a-f]{64}", preview)
    whole = lab.get(one)
    assert whole.headers["content-type"] in ("video/mp4", "video/webm")
    assert lab.get(two, headers={"Range": "bytes=4-7"}).status_code == 206
    with lab_services.database.session() as s:
        given = s.scalars(select(Response.id).where(Response.kind == "preference")).one()
        assert s.scalars(select(Session)).one().state == "completed"
        policy = s.scalars(select(Artefact.id).where(Artefact.kind == "query_set")).one()
    shown = lab.get(f"/lab/studies/{filmed.id}/answers/{given}")
    assert shown.status_code == 200
    assert set(re.findall(r"/lab/videos/[0-9a-f]{64}", shown.text)) == {one, two}
    assert lab.get(f"/lab/videos/{policy}").status_code == 404
    assert lab.get(f"/lab/artefacts/{one.rsplit('/', 1)[1]}").status_code == 200


def test_recordings_and_answers_from_elsewhere_have_pages_and_say_so(lab, lab_services, tmp_path):
    lines = [("r0", 0.0), ("r1", 1.2), ("r2", -1.5)]
    poses = [(run, t, *robot_at(t, aside)) for run, aside in lines for t in map(float, times())]
    (tmp_path / "mine.csv").write_text(csv_of("run,time_s,x_m,y_m,yaw_rad", poses))
    (tmp_path / "answers.csv").write_text("a,b,choice,person\nr0,r1,a,p1\nr1,r2,r2,p1\n")
    found = import_recordings(tmp_path / "mine.csv", "study_room", answers=tmp_path / "answers.csv")
    with lab_services.database.transaction() as s:
        queries = save_query_set(
            s, lab_services.files, found.query_set, name="Mine", card={"imported": found.recorded_card()}
        )
        given = [ImportedAnswer(one.line, query, one.choice, one.person) for query, one in found.answers]
        source = found.lineage[-1]
        snapshot = save_imported_answers(s, lab_services.files, queries, given, name="Mine", source=source).id
        query_set = queries.id
    for path in (f"/lab/snapshots/{snapshot}", f"/lab/artefacts/{query_set}"):
        page = lab.get(path)
        assert page.status_code == 200
        assert "recorded elsewhere" in page.text
        assert "built-in" not in page.text
    page = lab.get(f"/lab/snapshots/{snapshot}").text
    assert "people, imported from a file" in page
    answer = re.search(rf"/lab/snapshots/{snapshot}/answers/[^\"]+", page).group()
    shown = lab.get(answer)
    assert shown.status_code == 200
    assert "<svg" in shown.text
    assert lab.get("/lab/snapshots").status_code == 200


def test_the_example_is_two_runs_that_can_be_read(lab, lab_services):
    page = "/lab/recordings"
    assert "/recordings/example" not in lab.get(page).text, "there is no query set that came with the product yet"
    with lab_services.database.transaction() as s:
        create_study(s, lab_services.files, freeze(QUICK), name="Pairs", created_by=None)
    assert "/recordings/example" in lab.get(page).text
    made = lab.post("/lab/recordings/example", data={"csrf": csrf(lab, page)}, follow_redirects=False)
    draft = find_recording_draft(lab_services.settings.data, made.headers["location"].rpartition("/")[2])
    (file,) = draft.recordings.iterdir()
    runs = read_csv(file, Mapping())
    assert [one.run for one in runs] == ["first", "second"]
    assert all(one.goal and one.things for one in runs)
