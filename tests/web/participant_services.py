"""An installation with studies that a participant can join, and the first steps of one, for their pages' tests."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import uuid4

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.settings import Settings
from desirepath.store.models import Event, Study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.study import walking


@pytest.fixture(scope="session")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with studies of twenty queries; copied by every test."""
    folder = tmp_path_factory.mktemp("furnished")
    walking.furnish(folder, walking.twenty_queries(tmp_path_factory.mktemp("queries")))
    return folder


@pytest.fixture
def services(furnished: Path, tmp_path: Path, database_of: Callable[[Path], str]) -> Iterator[Services]:
    """Services of their own over the furnished folder, without a stage."""
    data = shutil.copytree(furnished, tmp_path / "data")
    found = build_services(Settings(data=data, database_url=database_of(data), _env_file=None))
    yield found
    found.database.close()


@pytest.fixture
def client(services: Services) -> Iterator[TestClient]:
    here = ("127.0.0.1", 50_000)
    with TestClient(create_application(services), follow_redirects=False, client=here) as client:
        yield client


@pytest.fixture
def link(services: Services) -> str:
    with services.database.session() as s:
        return s.scalars(select(Study.recruiting_token).where(Study.name == "Short")).one()


@pytest.fixture
def token(client: TestClient, link: str) -> str:
    """A person's session, joined the way the welcome page does it."""
    answered = client.post(f"/join/{link}", data={"language": "en", "device": '{"width": 1024, "webgl": true, "x": 1}'})
    assert answered.status_code == 303
    return answered.headers["location"].removeprefix("/p/")


def submit(client, token, key, value, request_id=None):
    body = {"request_id": request_id or uuid4().hex, "value": value, "client_time": "2026-11-21T10:00:00Z"}
    return client.post(f"/api/session/{token}/steps/{key}", json=body)


def to_first_trial(client, token):
    for key in ("information", "consent", "demographics", "instruction"):
        answered = submit(client, token, key, walking.VALUES[key])
        assert answered.json()["accepted"] is True, answered.text
    return answered.json()


def logged(services, code):
    with services.database.session() as s:
        return [e for e in s.scalars(select(Event).where(Event.kind == "refused")) if e.data["code"] == code]
