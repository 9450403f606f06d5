"""What stands before every route: bodies are read only of who may send them, and dead links fill no log."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from backend.api.application import build_services, create_application
from backend.api.core.dependencies import Services
from backend.api.core.throttle import LARGEST_BODY, LARGEST_OPEN_BODY
from backend.settings import Settings
from backend.store.models import Event
from backend.study import refusals


@pytest.fixture
def services(tmp_path: Path) -> Services:
    return build_services(Settings(data=tmp_path, _env_file=None))


@pytest.fixture
def client(services: Services) -> Iterator[TestClient]:
    with TestClient(create_application(services), follow_redirects=False) as client:
        yield client


@pytest.mark.parametrize("path", ["/lab/new", "/lab/jobs/new/align", "/lab/settings/accounts", "/lab/sign-out"])
def test_who_is_not_signed_in_is_sent_to_sign_in_before_a_form_is_looked_at(client: TestClient, path: str) -> None:
    answered = client.post(path, content=b"not a form at all", headers={"Content-Type": "multipart/form-data"})
    assert (answered.status_code, answered.headers["location"].partition("?")[0]) == (303, "/lab/sign-in")


@pytest.mark.parametrize("path", ["/lab/sign-in", "/join/nowhere", "/api/session/nowhere/problem"])
def test_everybody_may_send_a_little_and_signed_in_pages_take_more(client: TestClient, path: str) -> None:
    assert LARGEST_OPEN_BODY < LARGEST_BODY
    too_much = client.post(path, content=b"x" * (LARGEST_OPEN_BODY + 1))
    assert too_much.status_code == 413
    enough = client.post(path, content=b"x" * (LARGEST_OPEN_BODY - 1), headers={"Content-Type": "application/json"})
    assert enough.status_code not in (413, 500)


def told(services: Services, code: str) -> int:
    with services.database.session() as s:
        return sum(event.data["code"] == code for event in s.scalars(select(Event).where(Event.kind == "refused")))


def test_a_dead_link_is_written_down_once_an_hour(
    client: TestClient, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(5):
        assert client.get("/api/session/dead-link").status_code == 404
        asyncio.run(services.admission.admit("dead.stage", {}, None))
    assert (told(services, "unknown"), told(services, "unknown_stage")) == (1, 1)
    monkeypatch.setattr(refusals, "LOGGED_AGAIN_AFTER_S", 0.0)  # the hour is over
    assert client.get("/api/session/dead-link").status_code == 404
    assert told(services, "unknown") == 2


def test_more_dead_links_than_the_log_takes_are_refused_all_the_same(
    client: TestClient, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "MOST_LOGGED", 3)
    assert [client.get(f"/api/session/guess-{number}").status_code for number in range(6)] == [404] * 6
    assert told(services, "unknown") == 3
