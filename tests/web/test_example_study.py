"""The example study on the lab's pages: none is empty, all say that nobody took part, one click removes it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.settings import Settings
from desirepath.store.example_study import add_example, example_id
from desirepath.store.models import Artefact, Job, Participant
from desirepath.store.shipped_policies import register_shipped
from desirepath.web.application import build_services, create_application
from desirepath.web.core.auth import add_user
from desirepath.web.core.dependencies import Services
from tests.web.lab_services import csrf, sign_in

MARK = "no person took part"


@pytest.fixture(scope="module")
def shown(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Services, TestClient, str]]:
    """An installation with the example study, its owner's browser, and the study's page."""
    data = shutil.copytree(fresh_data, tmp_path_factory.mktemp("example") / "data")
    services = build_services(Settings(data=data, _env_file=None))
    with services.database.transaction() as s:
        register_shipped(s, services.files)
    study_id = add_example(services.database, services.files)
    with TestClient(create_application(services), follow_redirects=False) as client:
        yield services, sign_in(client), f"/lab/studies/{study_id}"
    services.database.close()


@pytest.mark.parametrize("tab", ["now", "people", "protocol", "recruit", "data", "report", "team", "answers", "events"])
def test_every_page_of_the_study_says_that_nobody_took_part(shown, tab):
    _, lab, study = shown
    page = lab.get(f"{study}/{tab}")
    assert (page.status_code, MARK in page.text) == (200, True)


def test_people_answers_policies_and_jobs_are_there_and_say_that_they_are_simulated(shown):
    services, lab, study = shown
    with services.database.session() as s:
        codes = s.scalars(select(Participant.code).order_by(Participant.code)).all()
        policy = s.scalars(select(Artefact).where(Artefact.kind == "policy", Artefact.study_id.is_not(None))).first()
        job = s.scalars(select(Job).where(Job.kind == "compare")).one()
    person = lab.get(f"{study}/people/{codes[0]}").text
    assert MARK in person
    assert "Replay" in person
    assert MARK in lab.get(f"{study}/people/{codes[0]}/learnt").text
    assert "simulated" in lab.get(f"/lab/policies/{policy.id}").text
    assert policy.name in lab.get("/lab/policies").text
    assert "simulated" in lab.get(f"/lab/jobs/{job.id}").text
    listed = lab.get("/lab/studies").text
    assert "example, simulated" in listed


def test_one_click_of_who_may_erase_removes_it(shown):
    services, lab, study = shown
    viewer = TestClient(lab.app, follow_redirects=False)
    form = {"csrf": csrf(lab, f"{study}/now")}
    password = add_user(services.database, "looker", "viewer")
    assert sign_in(viewer, "looker", password).post(f"{study}/remove-example", data=form).status_code in (303, 403)
    assert lab.post("/lab/studies/another/remove-example", data=form).status_code == 404
    with services.database.session() as s:
        assert example_id(s) is not None
    removed = lab.post(f"{study}/remove-example", data=form)
    assert removed.headers["location"] == "/lab/studies?done=example_removed"
    assert lab.get(f"{study}/now").status_code == 404
    assert "example study is gone" in lab.get(removed.headers["location"]).text
    services.brings_example = True
    assert "is being added" not in lab.get("/lab/studies").text
