"""The analysts' page of drawn paths: what was drawn, what is left out and why, training from it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.store.demonstration_snapshots import read_demonstrations
from desirepath.store.models import Artefact, Job, StrokeRow, new_id
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from desirepath.web.analyst import demonstration_pages
from desirepath.web.core.dependencies import Services
from tests.web.lab_services import csrf

QUICK = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_demonstration_study.yaml"


def place_of(page: str) -> str:
    """Number of the first place on the page."""
    found = re.search(r"/paths/corridor-(\d)\.csv", page)
    assert found
    return found.group(1)


@pytest.fixture
def study(lab_services: Services) -> str:
    """A study in which one programmed demonstrator drew two paths in one place, for walks that were chosen."""
    text = QUICK.read_text().replace("pairs: 2, per_pair: 2", "pairs: 1, per_pair: 2, person: recorded")
    with lab_services.database.transaction() as s:
        made = create_study(s, lab_services.files, freeze_text(text), name="Drawing", created_by=None)
    walk_in_process(lab_services.database, lab_services.files, made, 1, without_jobs=True)
    return made.id


def test_paths_are_shown_left_out_taken_back_and_learned_from(lab: TestClient, lab_services: Services, study: str):
    here = f"/lab/studies/{study}/paths"
    people = lab.get(here).text
    assert "Simulated participants have drawn here, but no people yet." in people
    assert "S001" not in people
    simulated = f"{here}?who=simulated"
    shown = lab.get(simulated).text
    assert f'<a href="{here}" aria-current="page">Drawn paths</a>' in shown
    assert shown.count("<polyline") == 4  # two drives and two walks
    assert "drawn by S001" in shown
    assert "where the person walked meanwhile" in shown
    assert "walked a planned path" in shown
    assert "changes by more than 0.08 m/s²" in shown  # what the flag's rule has
    with lab_services.database.session() as s:
        first, second = s.scalars(select(StrokeRow.id).order_by(StrokeRow.step_key))
    token = {"csrf": csrf(lab), "who": "simulated"}
    assert lab.post(f"{here}/{first}/leave-out", data=token | {"reason": " "}).status_code == 422
    assert lab.post(f"{here}/{first}/leave-out", data=token | {"reason": "the hand <b>slipped</b>"}).status_code == 303
    shown = lab.get(f"{here}?participant=S001").text
    assert "the hand &lt;b&gt;slipped&lt;/b&gt;" in shown
    assert shown.count("<polyline") == 2

    started = lab.post(f"{here}/train", data=token | {"environment": "corridor", "participant": "S001"})
    assert re.fullmatch(r"/lab/jobs/[0-9a-f]{32}", started.headers["location"])
    with lab_services.database.session() as s:
        job = s.get_one(Job, started.headers["location"].rsplit("/", 1)[1])
        _, kept = read_demonstrations(lab_services.files.get(s.get_one(Artefact, job.params["snapshot"]).id))
        assert [one.stroke for one in kept] == [second]
    assert lab.post(f"{here}/train", data=token | {"environment": "room"}).status_code == 422
    of_people = {"environment": "corridor", "who": "people"}
    assert lab.post(f"{here}/train", data=token | of_people).status_code == 422  # nobody but bots has drawn
    back = lab.post(f"{here}/{first}/take-back", data=token | {"participant": "S001"}).headers["location"]
    assert back == f"{simulated}&participant=S001&place=corridor-{place_of(shown)}"
    assert lab.get(back).text.count("<polyline") == 4

    each = lab.post(f"{here}/train", data=token | {"environment": "corridor", "participant": "each"})
    assert each.headers["location"] == simulated
    with lab_services.database.transaction() as s:
        newest = s.scalars(select(Job).order_by(Job.created_at.desc())).first()
        strokes = s.scalars(select(StrokeRow).order_by(StrokeRow.step_key)).all()
        newest.state = "succeeded"  # the training is tested as a job; here its drives are the drawn ones
        newest.result = {
            "policy": "0" * 64,
            "passed": True,
            "judged": {"success_rate": 1.0, "frechet_m": 0.12, "t_star": 0.91, "speed_correlation": None},
            "rollouts": [
                {"demonstration": one.demonstration, "pair": one.pair, "trajectory": one.trajectory} for one in strokes
            ],
        }
    learned = lab.get(f"{simulated}&participant=S001&watch={second}").text
    assert learned.count("<polyline") == 6
    assert "learned controller, from the same starts" in learned
    assert re.search(r'<iframe class="replay" id="stage"[^>]+src="[^"]*/stage/([^/"]+)/"', learned)
    assert '<td class="number">0.12</td><td class="number">0.91</td><td class="number">–</td>' in learned
    assert (
        "learned controller, from the same starts" not in lab.get(simulated).text
    )  # of one person, among everybody's paths
    rows = lab.get(f"{here}/corridor-{place_of(learned)}.csv?who=simulated&participant=S001").text.splitlines()
    assert rows[0] == "kind,participant,path,time_s,x_m,y_m,yaw_rad"
    assert {tuple(row.split(",")[:3]) for row in rows[1:]} == {
        (kind, "S001", stroke) for kind in ("drawn", "learned") for stroke in (first, second)
    }
    assert lab.get(f"{here}/corridor-{place_of(learned)}.svg?who=simulated").text.startswith("<svg")
    assert lab.get(f"{here}/room-1.svg?who=simulated").status_code == 404
    assert lab.post(f"{here}/{'0' * 32}/take-back", data=token).status_code == 404


def test_of_many_paths_one_place_is_laid_open(
    lab: TestClient, lab_services: Services, study: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(demonstration_pages, "MOST_AT_ONCE", 3)  # instead of drawing 150
    with lab_services.database.transaction() as s:
        first, second = s.scalars(select(StrokeRow).order_by(StrokeRow.step_key))
        there = f"corridor-{first.pair + 1}"
        for stroke in (first, second):  # the same two once more, as if in another place
            copied = {column.key: getattr(stroke, column.key) for column in StrokeRow.__table__.columns}
            again = {"id": new_id(), "request_id": new_id(), "pair": (stroke.pair + 1) % 4, "step_key": "elsewhere"}
            s.add(StrokeRow(**copied | again | {"attempt": stroke.attempt + (stroke is second)}))
        elsewhere = f"corridor-{(first.pair + 1) % 4 + 1}"
        here = f"/lab/studies/{study}/paths?who=simulated"
    for place, other in ((there, elsewhere), (elsewhere, there)):
        page = lab.get(f"{here}&place={place}").text
        assert "There are 4 paths; one place is shown at a time." in page
        assert f"/paths/{place}.svg" in page
        assert f"/paths/{other}.svg" not in page
        assert f"place={other}#places" in page
        assert page.count("<polyline") == 4  # two drives and two walks
    assert f"/paths/{there}.svg" in lab.get(f"{here}&place={elsewhere}&watch={first.id}").text
    assert lab.get(f"{here}&place=moon-1").status_code == 200


def test_paths_of_the_study_room_are_shown_and_no_controller_is_offered_from_them(
    lab: TestClient, lab_services: Services, study: str
):
    with lab_services.database.transaction() as s:
        for stroke in s.scalars(select(StrokeRow)):
            stroke.environment = "study_room"
    page = lab.get(f"/lab/studies/{study}/paths?who=simulated").text
    assert "study room" in page
    assert "/paths/study_room-" in page
    assert "/paths/train" not in page
