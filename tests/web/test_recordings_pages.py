"""Analysts' pages about what was recorded, and answered, elsewhere."""

from __future__ import annotations

import re

from desirepath.recordings.importing import import_recordings
from desirepath.store.imported_answers import ImportedAnswer, save_imported_answers
from desirepath.store.query_sets import save_query_set
from tests.recordings.walks import csv_of, robot_at, times


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
        assert "comes with the product" not in page.text
    page = lab.get(f"/lab/snapshots/{snapshot}").text
    assert "people, imported from a file" in page
    answer = re.search(rf"/lab/snapshots/{snapshot}/answers/[^\"]+", page).group()
    shown = lab.get(answer)
    assert shown.status_code == 200
    assert "<svg" in shown.text
    assert lab.get("/lab/snapshots").status_code == 200
