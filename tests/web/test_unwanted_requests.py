"""What participants' routes do not take: dead links, forged tokens, too much, too often, what no table can hold."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from limits import parse
from sqlalchemy import select

from desirepath.store.dataset.writing import export_study
from desirepath.store.models import ProblemReport, RecruitingId, Study
from desirepath.study.refusals import MOST_OF_A_SESSION
from desirepath.web.core.throttle import LARGEST_BODY
from desirepath.web.participant import recruiting, requests, session_pages
from tests.web.participant_services import logged


@contextmanager
def limited_to(monkeypatch, module, name, limit):
    with monkeypatch.context() as patched:
        patched.setattr(module, name, parse(limit))
        yield


def test_links_that_lead_nowhere_fill_no_log_and_shut_nobody_out(client, services, link, token, monkeypatch):
    with limited_to(monkeypatch, requests, "REFUSALS_PER_ADDRESS", "3 per 1 minute"):
        answers = [client.get(f"/api/session/guess-{k}").status_code for k in range(3)]
        answers += [client.get(f"/{where}/guess").status_code for where in ("join", "p", "api/session")]
        assert answers == [404] * 3 + [429] * 3
        assert len(logged(services, "unknown")) == 3
        assert client.get(f"/join/{link}").status_code == 200  # somebody else behind the same address
        assert client.get(f"/p/{token}").status_code == 200


def test_joins_from_one_address_and_events_of_one_page_have_a_limit(client, services, link, token, monkeypatch):
    def noticed():
        return client.post(f"/api/session/{token}/events", json={"kind": "viewed", "data": {}}).status_code

    with limited_to(monkeypatch, recruiting, "JOINS_PER_ADDRESS", "2 per 1 minute"):
        answers = [client.post(f"/join/{link}", data={"language": "en"}).status_code for _ in range(2)]
    with limited_to(monkeypatch, session_pages, "EVENTS_PER_SESSION", "2 per 1 minute"):
        answers += [noticed() for _ in range(3)]
    assert answers == [303, 303, 204, 204, 429]
    with limited_to(monkeypatch, recruiting, "JOINS_PER_ADDRESS", "2 per 1 minute"):
        assert client.post(f"/join/{link}", data={"language": "en"}).status_code == 429
    assert not logged(services, "too_many")


@pytest.mark.parametrize("declared", [True, False])
def test_a_body_that_is_too_large_is_not_read(client, token, declared):
    content = b"x" * (LARGEST_BODY + 1)
    path = f"/api/session/{token}/problem"
    answered = client.post(path, content=content if declared else iter([content[:1000], content[1000:]]))
    assert (answered.status_code, answered.json()["error"]["code"]) == (413, "too_large")


def test_half_characters_and_numbers_that_are_none_never_stop_an_export(client, services, link, token, tmp_path):
    """JSON lets them in: JavaScript cuts an emoji in two, Python reads NaN."""
    odd = {"content-type": "application/json"}
    broken = b'"caf\\u00e9 \\ud83d \\u0000"'
    told = b'{"kind": "script_error", "data": {"message": %b, "\\ud83d": NaN}}' % broken
    assert client.post(f"/api/session/{token}/events", content=told, headers=odd).status_code == 204
    problem = client.post(f"/api/session/{token}/problem", content=b'{"text": %b}' % broken, headers=odd)
    assert problem.status_code == 204
    bot = b'{"simulated": true, "oracle": {"name": %b}, "device": {"scheme": %b}}' % (broken, broken)
    assert client.post(f"/join/{link}", content=bot, headers=odd).status_code == 201
    form = {"language": "en", "device": '{"scheme": "\\ud83d", "pixel_ratio": NaN}', "PROLIFIC_PID": "id\0"}
    assert client.post(f"/join/{link}", data=form).status_code == 303
    with services.database.session() as s:
        study = s.scalars(select(Study.id).where(Study.recruiting_token == link)).one()
        assert s.scalars(select(ProblemReport)).one().text == "café ?"
        assert s.scalars(select(RecruitingId)).one().external_id == "id"
    export_study(services.database, services.files, study, tmp_path / "out")
    events = (tmp_path / "out" / "events.csv").read_text(encoding="utf-8")
    assert "café ? " in events
    assert "NaN" not in events


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("get", ""),
        ("get", "/stream"),
        ("get", "/trial-data"),
        ("post", "/steps/information"),
        ("post", "/trials/block.01/start"),
        ("post", "/pause"),
        ("post", "/withdraw"),
        ("post", "/problem"),
    ],
)
def test_a_forged_token_opens_nothing_and_is_logged(client, services, method, path):
    body = {"json": {"request_id": "12345678"}} if method == "post" else {}
    answered = getattr(client, method)(f"/api/session/forged-token{path}", **body)
    assert answered.status_code == 404
    assert answered.json()["error"]["code"] == "unknown"
    assert logged(services, "unknown")


def test_a_forged_page_is_a_kind_refusal(client):
    answered = client.get("/p/forged-token", headers={"Accept-Language": "de"})
    assert answered.status_code == 404
    assert answered.headers["content-type"].startswith("text/html")


def test_one_link_does_not_write_without_limit(client, services, token, monkeypatch):
    """400 refused answers were logged, 200 problem reports of 3.9 kB kept."""
    long_body = {"request_id": "12345678", "value": {}}
    answers = {client.post(f"/api/session/{token}/steps/debriefing", json=long_body).status_code for _ in range(130)}
    assert answers == {409}
    assert len(logged(services, "not_current_step")) == MOST_OF_A_SESSION
    told = [client.post(f"/api/session/{token}/problem", json={"text": "x" * 3900}) for _ in range(12)]
    assert [one.status_code for one in told] == [204] * 10 + [409] * 2
    assert told[-1].json()["error"]["code"] == "too_many_problems"
    with services.database.session() as s:
        assert len(s.scalars(select(ProblemReport)).all()) == 10
    with limited_to(monkeypatch, requests, "CHANGES_PER_SESSION", "5 per 1 minute"):
        paused = [client.post(f"/api/session/{token}/pause").status_code for _ in range(6)]
    assert paused[-1] == 429
