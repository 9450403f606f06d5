"""Several people at once on PostgreSQL, which lets writers in side by side: places, answers and quotas hold by locks.

On SQLite the same is in test_counterbalancing.py and tests/faults. Skipped where no PostgreSQL is installed.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.settings import Settings
from desirepath.store.models import Response, Session, Study, utc_now
from desirepath.study.plan.assignment import assignment_table
from desirepath.study.protocol.freezing import thaw
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests import postgres
from tests.study.small_protocol import CROSSED, small_protocol
from tests.study.walking import twenty_queries

QUOTAS = [{"questionnaire": "about", "item": "gender", "is": "woman", "most": 2}]
AT_ONCE = 6


@pytest.fixture
def served(postgres_server: str, tmp_path: Path) -> Iterator[tuple[Services, TestClient, str]]:
    """Services on PostgreSQL with one study of three conditions and a quota; its recruiting link."""
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        services = build_services(Settings(data=tmp_path / "data", database_url=url, _env_file=None))
        keys = {"query_set": str(twenty_queries(tmp_path)), "assignment": {"scheme": "latin_square"}, "quotas": QUOTAS}
        frozen = small_protocol(tmp_path, [{"questionnaire": {"use": "about"}}, CROSSED], **keys)
        with services.database.transaction() as s:
            link = create_study(s, services.files, frozen, name="At once", created_by=None).recruiting_token
        with TestClient(create_application(services), follow_redirects=False) as client:
            yield services, client, link
        services.database.close()


def together(asked: list[tuple[str, dict[str, Any]]], client: TestClient) -> list[tuple[int, dict[str, Any]]]:
    """Send these at the same moment."""
    ready = Barrier(len(asked))

    def send(one: tuple[str, dict[str, Any]]) -> tuple[int, dict[str, Any]]:
        ready.wait()
        answered = client.post(one[0], json=one[1])
        return answered.status_code, answered.json()

    with ThreadPoolExecutor(len(asked)) as pool:
        return list(pool.map(send, asked))


def test_people_at_the_same_moment_get_their_places_and_count_once(served: tuple[Services, TestClient, str]) -> None:
    services, client, link = served
    joined = together([(f"/join/{link}", {"language": "en"})] * AT_ONCE, client)
    assert [status for status, _ in joined] == [201] * AT_ONCE
    with services.database.session() as s:
        study = s.scalars(select(Study)).one()
        table = assignment_table(s, study, thaw(study).protocol, now=utc_now())
    assert [line.held for line in table] == [2, 2, 2]

    apis = [f"/api/session/{told['token']}/steps" for _, told in joined]
    given = {"given": True, "version": "1"}
    twice = [(f"{api}/consent", {"request_id": f"the-consent-{n}", "value": given}) for n, api in enumerate(apis)] * 2
    answers = together(twice, client)
    assert [status for status, _ in answers] == [200] * len(twice)
    assert sum(told["duplicate"] for _, told in answers) == AT_ONCE

    about = {"age": 30, "gender": "woman"}
    asked = [(f"{api}/about", {"request_id": f"the-about-{n}", "value": about}) for n, api in enumerate(apis)]
    assert {status for status, _ in together(asked, client)} == {200}
    with services.database.session() as s:
        states = sorted(s.scalars(select(Session.state)))
        counted = len(list(s.scalars(select(Response.id))))
    assert states == ["active"] * 2 + ["screened_out"] * (AT_ONCE - 2)  # nobody too many took the last place
    assert counted == 2 * AT_ONCE
