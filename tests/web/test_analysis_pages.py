"""The whole report in the browser, made by a process of its own."""

from __future__ import annotations

import io
import json
import threading
import time
import zipfile

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, true, update
from starlette.responses import Response

from desirepath.cli import study as study_commands
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import analyse
from desirepath.report.tidy_tables import read_study
from desirepath.store.models import Participant, Session, Study, new_id, utc_now
from desirepath.store.models import Response as Answer
from desirepath.study.protocol.freezing import find_shipped_protocols, freeze
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services
from desirepath.web.lab import study_rows
from desirepath.web.lab.whole_reports import ReportError, ReportFiles, Reports
from tests.web.lab_services import QUICK

PATIENCE_S = 120.0


def awaited(lab: TestClient, address: str) -> Response:
    """The page once the report is there, or cannot be."""
    until = time.monotonic() + PATIENCE_S
    while "data-live" in (page := lab.get(address)).text:
        assert time.monotonic() < until
        time.sleep(0.2)
    return page


@pytest.fixture
def here(lab_services: Services) -> str:
    with lab_services.database.session() as s:
        return f"/lab/studies/{s.scalars(select(Study.id)).one()}"


def test_the_report_is_made_shown_and_taken_away(walked, lab, lab_services, here):
    assert f"{here}/analysis/people" in lab.get(f"{here}/report").text
    first = lab.get(f"{here}/analysis/people")
    assert "is being made" in first.text
    assert f'{here}/analysis/people/report.html"' in awaited(lab, f"{here}/analysis/people").text
    assert "data-live" not in lab.get(f"{here}/analysis/people", headers={"X-Fragment": "1"}).text
    report = lab.get(f"{here}/analysis/people/report.html")
    assert report.status_code == 200
    assert "default-src 'none'" in report.headers["Content-Security-Policy"]
    assert "From joining to the analysis" in report.text
    packed = zipfile.ZipFile(io.BytesIO(lab.get(f"{here}/analysis/people/report.zip").content))
    assert {"report/report.html", "report/findings.json"} <= set(packed.namelist())
    assert lab.get(f"{here}/analysis/people/../../report.html").status_code == 404
    assert lab.get(f"{here}/analysis/everybody").status_code == 404
    with lab_services.database.transaction() as s:  # what it was made from has changed: yesterday's report is not shown
        s.execute(update(Participant).values(excluded_at=utc_now(), excluded_reason="test"))
    assert lab.get(f"{here}/analysis/people/report.zip").status_code == 404


def test_looking_again_after_new_answers_starts_no_other_report(walked, lab, lab_services, here, monkeypatch):
    """Twelve looks, an answer before each: one report is made; who wants the newer answers in it asks for that."""
    begun, go_on = [], threading.Event()

    def made(reports: Reports, study: str, who: str) -> ReportFiles:
        begun.append(threading.current_thread())
        assert go_on.wait(PATIENCE_S)
        return ReportFiles({"report.html": b"<html></html>"})

    monkeypatch.setattr(Reports, "remake", made)  # the process takes half a minute; here only who starts it matters

    def another_answer() -> None:
        with lab_services.database.transaction() as s:
            session = s.scalars(select(Session.id)).first()
            s.add(
                Answer(
                    session_id=session, step_key=f"more-{new_id()}", kind="information", value={}, request_id=new_id()
                )
            )

    for _ in range(12):
        another_answer()
        assert "is being made" in lab.get(f"{here}/analysis/people").text
    go_on.set()
    assert "report.html" in awaited(lab, f"{here}/analysis/people").text
    assert len(begun) == 1
    page = lab.get(f"{here}/analysis/people").text
    assert "11 answers came since" in page, "made when the first of twelve was there"
    assert lab.get(f"{here}/analysis/people/report.zip").status_code == 200
    assert len(begun) == 1
    assert lab.get(f"{here}/analysis/people?recompute=1").status_code == 303
    assert "came since" not in awaited(lab, f"{here}/analysis/people").text
    assert len(begun) == 2


def test_why_there_is_no_report_is_said(walked, lab, here):
    page = awaited(lab, f"{here}/analysis/simulated")
    assert "There is no report" in page.text
    assert "nobody whose answers count has completed the study" in page.text


def test_a_report_of_pilots_alone_says_where_the_pilot_phase_ends(lab, lab_services, monkeypatch):
    def refused(reports: Reports, study: str, who: str) -> ReportFiles:
        raise ReportError("none of them counts")

    monkeypatch.setattr(Reports, "remake", refused)
    with lab_services.database.transaction() as s:
        study = create_study(s, lab_services.files, freeze(QUICK), name="Pilot", created_by=None)
        study.pilot = True
        here = f"/lab/studies/{study.id}"
        s.add(Participant(study_id=study.id, code="B-90", simulated=True, pilot=True))
    page = awaited(lab, f"{here}/analysis/simulated").text
    assert "joined during the pilot phase" in page
    assert f'href="{here}/recruit">End the pilot phase' in page
    assert "none of them counts" not in page
    german = lab.get(f"{here}/analysis/simulated", headers={"Accept-Language": "de"}).text
    assert "während der Pilotphase" in german


def test_counts_of_simulated_people_agree_whatever_the_phase(lab, lab_services, monkeypatch, capsys):
    """Three walk through a study's pilot: pages, tabs, the list and the full report count the same three."""
    services = lab_services
    drawing = next(file for file in find_shipped_protocols() if file.stem == "crowd_explanation_study")
    with services.database.transaction() as s:
        study = create_study(s, services.files, freeze(drawing), name="Simulated", created_by=None)
        study.pilot = True
    walk_in_process(services.database, services.files, study, 3)
    here = f"/lab/studies/{study.id}"
    report = lab.get(f"{here}/report").text  # opens at who is there
    assert "No participant of the main study" not in report
    assert '?who=simulated" aria-current="true">Simulated <span class="number soft">3<' in report
    assert "No participant of the main study has joined yet" in lab.get(f"{here}/report?who=people").text
    assert (
        "An der Pilotphase hat noch niemand"
        in lab.get(f"{here}/report?who=pilot", headers={"Accept-Language": "de"}).text
    )
    assert lab.get(f"/api/lab/studies/{study.id}/report?who=simulated").json()["joined"] == 3
    assert 'Simulated <span class="number soft">3<' in lab.get(f"{here}/people").text
    with services.database.session() as s:
        (line,) = [one for one in study_rows.study_lines(s, true()) if one.study.id == study.id]
        assert (line.people, line.simulated, line.completed_simulated) == (0, 3, 3)
        data, _ = read_study(s, services.files, s.get_one(Study, study.id))
    assert len([one for one in data.people if one.simulated]) == 3
    assert analyse(data, None, "simulated", AnalysisPlan(metrics=())).flow.analysed == 3
    monkeypatch.setattr(study_commands, "open_store", lambda: (services.database, services.files))
    study_commands.list_studies(as_json=True)
    (listed,) = [
        one for one in json.loads(capsys.readouterr().out.splitlines()[-1])["studies"] if one["study"] == study.id
    ]
    assert (listed["people"], listed["pilot_participants"], listed["simulated"]) == (0, 0, 3)


def test_the_report_needs_a_sign_in(visitor, lab_services):
    assert visitor.get("/lab/studies/1/analysis/people").status_code in (303, 401, 403)
