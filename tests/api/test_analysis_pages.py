"""The whole report in the browser, made by a process of its own."""

from __future__ import annotations

import io
import time
import zipfile

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, update
from starlette.responses import Response

from backend.api.core.dependencies import Services
from backend.store.models import Participant, Study, utc_now

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


def test_why_there_is_no_report_is_said(walked, lab, here):
    page = awaited(lab, f"{here}/analysis/simulated")
    assert "There is no report" in page.text
    assert "none of them has a completed session" in page.text


def test_the_report_needs_a_sign_in(visitor, lab_services):
    assert visitor.get("/lab/studies/1/analysis/people").status_code in (303, 401, 403)
