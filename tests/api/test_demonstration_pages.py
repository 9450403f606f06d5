"""The analysts' page of drawn paths: what was drawn, what is left out and why, training from it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from backend.api.dependencies import House
from backend.store.models import Artefact, Job, StrokeRow
from backend.store.strokes import read_demonstrations
from backend.study.in_process import walk_in_process
from backend.study.protocol import freeze_text
from backend.study.studies import create_study
from tests.api.lab_house import csrf

QUICK = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_demonstration_study.yaml"


@pytest.fixture
def study(lab_house: House) -> str:
    """A study in which one programmed demonstrator drew two paths in one place."""
    text = QUICK.read_text().replace("pairs: 2, per_pair: 2", "pairs: 1, per_pair: 2")
    with lab_house.database.transaction() as s:
        made = create_study(s, lab_house.files, freeze_text(text), name="Drawing", created_by=None)
    walk_in_process(lab_house.database, lab_house.files, made, 1, without_jobs=True)
    return made.id


def test_paths_are_shown_left_out_taken_back_and_learned_from(lab: TestClient, lab_house: House, study: str):
    here = f"/lab/studies/{study}/paths"
    shown = lab.get(here).text
    assert f'<a href="{here}" aria-current="page">Paths</a>' in shown
    assert shown.count("<polyline") == 2
    assert "drawn by S001" in shown
    with lab_house.database.session() as s:
        first, second = s.scalars(select(StrokeRow.id).order_by(StrokeRow.step_key))
    token = {"csrf": csrf(lab)}
    assert lab.post(f"{here}/{first}/leave-out", data=token | {"reason": " "}).status_code == 422
    assert lab.post(f"{here}/{first}/leave-out", data=token | {"reason": "the hand <b>slipped</b>"}).status_code == 303
    shown = lab.get(f"{here}?participant=S001").text
    assert "the hand &lt;b&gt;slipped&lt;/b&gt;" in shown
    assert shown.count("<polyline") == 1

    started = lab.post(f"{here}/train", data=token | {"environment": "corridor", "participant": "S001"})
    assert re.fullmatch(r"/lab/jobs/[0-9a-f]{32}", started.headers["location"])
    with lab_house.database.session() as s:
        job = s.get_one(Job, started.headers["location"].rsplit("/", 1)[1])
        _, kept = read_demonstrations(lab_house.files.get(s.get_one(Artefact, job.params["snapshot"]).id))
        assert [one.stroke for one in kept] == [second]
    assert lab.post(f"{here}/train", data=token | {"environment": "room"}).status_code == 422
    assert lab.post(f"{here}/{first}/take-back", data=token).status_code == 303
    assert lab.get(here).text.count("<polyline") == 2
    assert lab.post(f"{here}/{'0' * 32}/take-back", data=token).status_code == 404
