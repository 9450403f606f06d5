"""What a monitoring system reads: Prometheus' own parser takes it, nobody's token is in it, nobody else gets it."""

from __future__ import annotations

import os
import threading
import time
from datetime import timedelta

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy.exc import OperationalError

from desirepath.jobs import heartbeat
from desirepath.jobs.leases import WorkerName, say_alive
from desirepath.store.models import Job, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath.web.core import health


def numbers(text: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


@pytest.fixture
def here(client) -> TestClient:
    return TestClient(client.app, client=("127.0.0.1", 50_000))


@pytest.fixture
def elsewhere(client) -> TestClient:
    return TestClient(client.app, client=("203.0.113.7", 50_000))


def test_requests_sessions_and_the_worker_are_counted(client, here, services, token):
    client.get(f"/p/{token}")
    client.get(f"/p/{token}")
    client.request("BREW", "/nowhere")
    heartbeat.beat(services.settings.data)
    answer = here.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain")
    found = numbers(answer.text)
    seen = frozenset({("method", "GET"), ("route", "/p/{token}"), ("status", "200")})
    assert found["desirepath_request_seconds_count", seen] == 2
    other = frozenset({("method", "other"), ("route", "(no route)"), ("status", "404")})
    assert found["desirepath_request_seconds_count", other] == 1
    assert found["desirepath_sessions", frozenset({("state", "active"), ("simulated", "false")})] == 1
    assert found["desirepath_present", frozenset()] == 1
    assert found["desirepath_free_bytes", frozenset()] > 0
    assert 0 <= found["desirepath_worker_silent_seconds", frozenset()] < 60
    assert token not in answer.text


def test_from_elsewhere_only_with_the_token(elsewhere, here, services):
    assert elsewhere.get("/metrics").status_code == 403
    services.settings.metrics_token = "s3cret"
    assert elsewhere.get("/metrics", headers={"Authorization": "Bearer guess"}).status_code == 403
    assert elsewhere.get("/metrics", headers={"Authorization": "Bearer s3cret"}).status_code == 200
    assert here.get("/metrics").status_code == 200
    tried = [elsewhere.get("/metrics", headers={"Authorization": f"Bearer {k}"}).status_code for k in range(130)]
    assert (tried[0], tried[-1]) == (403, 429)
    assert elsewhere.get("/metrics", headers={"Authorization": "Bearer s3cret"}).status_code == 429
    assert here.get("/metrics").status_code == 200


def test_health_names_a_database_that_does_not_answer(client, services, monkeypatch):
    assert client.get("/health").json()["status"] == "ok"

    def gone(*_):
        raise OperationalError("SELECT 1", {}, Exception("connection refused"))

    monkeypatch.setattr(type(services.database), "session", gone)
    answer = client.get("/health")
    assert (answer.status_code, answer.json()["status"]) == (503, "no_database")
    assert answer.json()["problems"] == ["database_away"]
    page = client.get("/health", headers={"Accept": "text/html"})
    assert (page.status_code, "The database does not answer" in page.text) == (503, True)


def test_health_names_everything_that_is_wrong_for_programs_and_for_people(client, services, monkeypatch, tmp_path):
    assert client.get("/health").json()["problems"] == []
    page = client.get("/health", headers={"Accept": "text/html", "Accept-Language": "de"})
    assert (page.status_code, "Alles funktioniert" in page.text) == (200, True)
    heartbeat.beat(services.settings.data)
    long_ago = time.time() - 1000
    os.utime(services.settings.data / heartbeat.FILE, (long_ago, long_ago))
    monkeypatch.setattr(services.files, "url", (tmp_path / "gone" / "artefacts").as_uri())
    found = client.get("/health")
    assert (found.status_code, found.json()["problems"]) == (200, ["store_away", "no_worker"])
    page = client.get("/health", headers={"Accept": "text/html"}).text
    assert "The artefact store does not answer" in page
    assert "No worker is running" in page


def test_who_replaces_a_server_waits_until_its_first_visitors_need_not(client, services):
    assert client.get("/health").status_code == 200
    found = client.get("/health?prepared=1")
    assert (found.status_code, found.json()["status"], found.json()["problems"]) == (503, "loading", ["loading"])
    page = client.get("/health?prepared=1", headers={"Accept": "text/html", "Accept-Language": "de"})
    assert (page.status_code, "Der Server lädt noch" in page.text) == (503, True)
    services.prepared.set()
    assert (client.get("/health?prepared=1").status_code, client.get("/health").json()["problems"]) == (200, [])


def test_a_worker_on_another_machine_counts_though_the_one_of_this_folder_is_gone(client, here, services):
    heartbeat.beat(services.settings.data)
    long_ago = time.time() - 1000
    os.utime(services.settings.data / heartbeat.FILE, (long_ago, long_ago))
    assert client.get("/health").json()["problems"] == ["no_worker"]
    with services.database.transaction() as s:
        say_alive(s, WorkerName("there-0-bbbbbbbb", "there"), trainings=1)
    found = client.get("/health").json()
    assert (found["problems"], found["worker_silent_s"] < 60) == ([], True)
    metrics = numbers(here.get("/metrics").text)
    assert metrics["desirepath_workers", frozenset()] == 1
    assert metrics["desirepath_worker_silent_seconds", frozenset()] < 60


def test_a_store_that_hangs_is_named_and_holds_no_balancer(client, services, monkeypatch):
    asked, going_on = [], threading.Event()

    def hangs(sha):
        asked.append(sha)
        going_on.wait(30)
        return False

    monkeypatch.setattr(health, "WAITS_FOR_STORE_S", 0.01)
    monkeypatch.setattr(services.files, "url", "s3://bucket/artefacts")
    monkeypatch.setattr(services.files, "exists", hangs)
    for _ in range(3):
        found = client.get("/health")
        assert (found.status_code, found.json()["problems"]) == (200, ["store_away"])
    assert len(asked) == 1  # whoever asks next waits for no thread of its own
    going_on.set()
    monkeypatch.setattr(health, "WAITS_FOR_STORE_S", 5.0)
    client.get("/health")  # the look that was under way has come back
    assert client.get("/health").json()["problems"] == []


def test_a_job_that_nobody_takes_is_named_where_no_worker_ever_was(client, services):
    with services.database.transaction() as s:
        job = enqueue_job(s, "evaluate", {})
    assert client.get("/health").json()["problems"] == []
    with services.database.transaction() as s:
        s.get_one(Job, job.id).created_at = utc_now() - timedelta(minutes=5)
    assert client.get("/health").json()["problems"] == ["no_worker"]
