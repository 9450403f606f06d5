"""Participants over HTTP: the link, the pages, the API, what is refused, and bots that walk whole sessions."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from uuid import uuid4

import pytest
from fastapi.testclient import TestClient
from limits import parse
from sqlalchemy import select

from backend.api import participant, participant_requests, recruiting
from backend.api.application import create_application
from backend.api.dependencies import House
from backend.api.throttle import LARGEST_BODY
from backend.learning.errors import LearningError
from backend.learning.oracles import path_length_m
from backend.store.artefacts import load_trajectory
from backend.store.export import export_study
from backend.store.models import Event, Job, Participant, ProblemReport, RecruitingId, Response, Session, Study, Trial
from backend.study.bots import BotError, Character, simulate_study
from backend.study.protocol import freeze_text
from backend.study.studies import create_study
from tests.study import walking


@pytest.fixture
def client(house: House) -> Iterator[TestClient]:
    here = ("127.0.0.1", 50_000)
    with TestClient(create_application(house), follow_redirects=False, client=here) as client:
        yield client


@pytest.fixture
def link(house: House) -> str:
    with house.database.session() as s:
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


def logged(house, code):
    with house.database.session() as s:
        return [e for e in s.scalars(select(Event).where(Event.kind == "refused")) if e.data["code"] == code]


@contextmanager
def limited_to(monkeypatch, module, name, limit):
    with monkeypatch.context() as patched:
        patched.setattr(module, name, parse(limit))
        yield


def test_links_that_lead_nowhere_fill_no_log_and_shut_nobody_out(client, house, link, token, monkeypatch):
    with limited_to(monkeypatch, participant_requests, "REFUSALS_PER_ADDRESS", "3 per 1 minute"):
        answers = [client.get(f"/api/session/guess-{k}").status_code for k in range(3)]
        answers += [client.get(f"/{where}/guess").status_code for where in ("join", "p", "api/session")]
        assert answers == [404] * 3 + [429] * 3
        assert len(logged(house, "unknown")) == 3
        assert client.get(f"/join/{link}").status_code == 200  # somebody else behind the same address
        assert client.get(f"/p/{token}").status_code == 200


def test_joins_from_one_address_and_events_of_one_page_have_a_limit(client, house, link, token, monkeypatch):
    def noticed():
        return client.post(f"/api/session/{token}/events", json={"kind": "viewed", "data": {}}).status_code

    with limited_to(monkeypatch, recruiting, "JOINS_PER_ADDRESS", "2 per 1 minute"):
        answers = [client.post(f"/join/{link}", data={"language": "en"}).status_code for _ in range(2)]
    with limited_to(monkeypatch, participant, "EVENTS_PER_SESSION", "2 per 1 minute"):
        answers += [noticed() for _ in range(3)]
    assert answers == [303, 303, 204, 204, 429]
    with limited_to(monkeypatch, recruiting, "JOINS_PER_ADDRESS", "2 per 1 minute"):
        assert client.post(f"/join/{link}", data={"language": "en"}).status_code == 429
    assert not logged(house, "too_many")


@pytest.mark.parametrize("declared", [True, False])
def test_a_body_that_is_too_large_is_not_read(client, token, declared):
    content = b"x" * (LARGEST_BODY + 1)
    path = f"/api/session/{token}/problem"
    answered = client.post(path, content=content if declared else iter([content[:1000], content[1000:]]))
    assert (answered.status_code, answered.json()["error"]["code"]) == (413, "too_large")


# ---- the link --------------------------------------------------------------------------------------------------------


def test_the_welcome_page_stores_nothing_and_speaks_the_browsers_language(client, house, link):
    for language, words in (("de", "Wie soll der Roboter"), ("en", "How should the robot")):
        answered = client.get(f"/join/{link}", headers={"Accept-Language": language})
        assert answered.status_code == 200
        assert words in answered.text
    with house.database.session() as s:
        assert s.scalars(select(Participant)).first() is None


def test_joining_keeps_the_device_and_leads_to_the_session(client, house, token):
    with house.database.session() as s:
        session = s.scalars(select(Session)).one()
    assert session.device == {"width": 1024, "webgl": True}
    assert not session.simulated
    answered = client.get(f"/p/{token}")
    assert answered.headers["x-step-key"] == "information"
    assert "How should the robot pass you?" in answered.text


def test_who_goes_on_in_another_browser_has_the_device_looked_at_first(client, house, link):
    with house.database.transaction() as s:
        short = s.scalars(select(Study).where(Study.recruiting_token == link)).one()
        frozen = freeze_text(short.protocol_yaml + "\ndevice: {min_width: 1000, light_below: 20}\n")
        gated = create_study(s, house.files, frozen, name="Gated", created_by=None).recruiting_token
    desk = '{"width": 1024, "webgl": true}'
    token = client.post(f"/join/{gated}", data={"language": "en", "device": desk}).headers["location"][3:]
    to_first_trial(client, token)
    elsewhere = TestClient(client.app, follow_redirects=False)
    page = elsewhere.get(f"/p/{token}").text
    assert "Before you go on" in page
    assert f'action="/p/{token}/device"' in page
    refused = elsewhere.post(f"/p/{token}/device", data={"device": '{"width": 390, "webgl": false}'})
    assert (refused.status_code, "What you have answered is kept" in refused.text) == (403, True)
    assert [event.data["reasons"] for event in logged(house, "other_device")] == [["webgl", "width"]]
    assert "Before you go on" in elsewhere.get(f"/p/{token}").text
    slow = '{"width": 1200, "webgl": true, "frame_rate": 12.5}'
    assert elsewhere.post(f"/p/{token}/device", data={"device": slow}).headers["location"] == f"/p/{token}"
    assert elsewhere.get(f"/p/{token}").headers["x-step-key"] == "block.01"
    with house.database.session() as s:
        assert s.scalars(select(Session)).one().device["scene_detail"] == "light"
        (event,) = s.scalars(select(Event).where(Event.kind == "device_checked"))
    assert (event.data["before"]["width"], event.data["after"]["width"]) == (1024, 1200)
    assert client.get(f"/p/{token}").headers["x-step-key"] == "block.01"  # the first one goes on as well


def test_a_platforms_id_is_kept_apart_and_lets_nobody_in_twice(client, house, link):
    ids = {"PROLIFIC_PID": "5f3c0ffee0ddba11", "STUDY_ID": "s1", "SESSION_ID": "x1"}
    welcome = client.get(f"/join/{link}", params=ids)
    assert ids["PROLIFIC_PID"] in welcome.text  # travels on in the form
    assert client.post(f"/join/{link}", data={"language": "en", **ids}).status_code == 303
    again = client.post(f"/join/{link}", data={"language": "en", **ids})
    assert again.status_code == 409
    assert len(logged(house, "already_joined")) == 1
    with house.database.session() as s:
        assert s.scalars(select(RecruitingId)).one().external_id == ids["PROLIFIC_PID"]


@pytest.mark.parametrize("method", ["get", "post"])
def test_an_unknown_and_a_closed_link_say_so(client, house, link, method):
    assert getattr(client, method)("/join/nowhere").status_code == 404
    with house.database.transaction() as s:
        s.scalars(select(Study).where(Study.recruiting_token == link)).one().state = "closed"
    assert getattr(client, method)(f"/join/{link}").status_code == 403


# ---- the session -----------------------------------------------------------------------------------------------------


def test_every_step_has_a_page_in_both_languages(client, link):
    for language in ("en", "de"):
        joined = client.post(f"/join/{link}", data={"language": language}).headers["location"].removeprefix("/p/")
        for key in ("information", "consent", "demographics", "instruction"):
            fragment = client.get(f"/p/{joined}/step")
            assert fragment.status_code == 200
            assert fragment.headers["x-step-key"] == key
            assert client.get(f"/p/{joined}").status_code == 200
            submit(client, joined, key, walking.VALUES[key])
        assert "data-phase" in client.get(f"/p/{joined}/step").text
        for page in ("consent", "help"):
            assert client.get(f"/p/{joined}/{page}").status_code == 200


def test_the_state_of_a_trial_holds_what_the_page_needs_and_no_more(client, token):
    state = to_first_trial(client, token)
    trial = state["step"]["trial"]
    assert trial["phase"] == "ready"
    assert trial["label_s"] == 2.0
    assert trial["duration_a_s"] > 1
    assert "/stage/" in state["stage_url"]
    assert token not in state["stage_url"]
    assert not {"trajectory_a", "trajectory_b", "query", "arms"} & (set(trial) | set(state["step"]))


def test_answering_too_early_is_refused_and_logged(client, house, token):
    to_first_trial(client, token)
    early = submit(client, token, "block.01", {"choice": "a"})
    assert early.status_code == 409
    assert early.json()["error"]["code"] == "too_early"
    started = client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-01"}).json()
    shown = started["step"]["trial"]["playback_id"]
    seen = client.post(f"/api/session/{token}/trials/block.01/seen", json={"drive": "a", "playback_id": shown})
    assert seen.json()["error"]["code"] == "too_early"
    assert len(logged(house, "too_early")) == 2


def test_a_replayed_request_is_acknowledged_and_counts_once(client, token):
    first = submit(client, token, "information", {}, "one-request-id")
    again = submit(client, token, "information", {}, "one-request-id")
    assert (first.json()["duplicate"], again.json()["duplicate"]) == (False, True)
    assert again.json()["step"]["key"] == "consent"


def test_another_participants_trial_cannot_be_answered_or_played(client, house, link, token):
    other = client.post(f"/join/{link}", data={"language": "en"}).headers["location"].removeprefix("/p/")
    to_first_trial(client, token)
    to_first_trial(client, other)
    theirs = client.post(f"/api/session/{other}/trials/block.01/start", json={"request_id": "start-01"}).json()
    client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-02"})
    shown = theirs["step"]["trial"]["playback_id"]
    foreign = client.post(f"/api/session/{token}/trials/block.01/seen", json={"drive": "a", "playback_id": shown})
    assert foreign.json()["error"]["code"] == "other_playback"
    assert len(logged(house, "other_playback")) == 1


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
def test_a_forged_token_opens_nothing_and_is_logged(client, house, method, path):
    body = {"json": {"request_id": "12345678"}} if method == "post" else {}
    answered = getattr(client, method)(f"/api/session/forged-token{path}", **body)
    assert answered.status_code == 404
    assert answered.json()["error"]["code"] == "unknown"
    assert logged(house, "unknown")


def test_a_forged_page_is_a_kind_refusal(client):
    answered = client.get("/p/forged-token", headers={"Accept-Language": "de"})
    assert answered.status_code == 404
    assert answered.headers["content-type"].startswith("text/html")


def test_a_reload_in_the_middle_starts_the_trial_over(client, house, token):
    to_first_trial(client, token)
    client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-01"})
    client.get(f"/p/{token}")
    trial = client.get(f"/api/session/{token}").json()["step"]["trial"]
    assert (trial["phase"], trial["restarts"]) == ("ready", 1)
    with house.database.session() as s:
        assert s.scalars(select(Event).where(Event.kind == "trial_interrupted")).one().data["reason"] == "page_loaded"


def test_a_hidden_tab_reported_by_the_page(client, token):
    to_first_trial(client, token)
    client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-01"})
    hidden = client.post(f"/api/session/{token}/trials/block.01/interrupted", json={"reason": "hidden"})
    assert hidden.json()["step"]["trial"]["phase"] == "ready"
    wrong = client.post(f"/api/session/{token}/trials/block.01/interrupted", json={"reason": "bored"})
    assert wrong.status_code == 422
    assert wrong.json()["error"]["field"] == "reason"


def test_pause_go_on_and_withdraw(client, token):
    assert client.post(f"/api/session/{token}/pause").json()["state"] == "paused"
    assert submit(client, token, "information", {}).json()["error"]["code"] == "paused"
    assert client.get(f"/p/{token}/step").status_code == 200
    assert client.post(f"/api/session/{token}/resume").json()["state"] == "active"
    assert client.post(f"/api/session/{token}/withdraw").json()["state"] == "withdrawn"
    assert submit(client, token, "information", {}).status_code == 410
    assert client.get(f"/p/{token}").status_code == 200


@pytest.mark.parametrize("body", [{}, {"request_id": "short"}, {"request_id": 5}, {"request_id": "x" * 65}])
def test_an_answer_needs_a_request_id(client, token, body):
    answered = client.post(f"/api/session/{token}/steps/information", json={"value": {}, **body})
    assert answered.status_code == 422
    assert answered.json()["error"]["field"] == "request_id"


def test_what_the_page_noticed_is_logged_with_its_own_time(client, house, token):
    told = {"kind": "visibility", "data": {"hidden": True}, "client_time": "2026-11-21T10:00:00+01:00"}
    assert client.post(f"/api/session/{token}/events", json=told).status_code == 204
    assert client.post(f"/api/session/{token}/events", json={"kind": "sql"}).status_code == 422
    with house.database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "page_visibility")).one()
    assert event.client_time.hour == 9
    assert event.data["page"] == {"hidden": True}


def test_only_simulated_sessions_may_read_the_drives(client, house, token):
    to_first_trial(client, token)
    assert client.get(f"/api/session/{token}/trial-data").json()["error"]["code"] == "simulated_only"
    assert len(logged(house, "simulated_only")) == 1


def test_a_form_cannot_make_a_simulated_session(client, house, link):
    client.post(f"/join/{link}", data={"language": "en", "simulated": "true"})
    with house.database.session() as s:
        assert not s.scalars(select(Session)).one().simulated


# ---- bots ------------------------------------------------------------------------------------------------------------


@contextmanager
def failing_worker(house: House) -> Iterator[None]:
    """Ends every training as failed: a real one takes half a minute, and what it makes is tested with the jobs."""
    over = threading.Event()

    def work() -> None:
        while not over.wait(0.05):
            with house.database.transaction() as s:
                for job in s.scalars(select(Job).where(Job.state == "queued")):
                    job.state, job.error = "failed", "no worker in this test"

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_bots_walk_to_the_end_and_are_marked(client, house, link):
    with failing_worker(house):
        done = simulate_study("", link, 2, Character("shortest"), client=client)
    assert (done["participants"], done["completed"]) == (2, 2)
    assert done["responses"] == 2 * (4 + 4 + 1)
    with house.database.session() as s:
        people = list(s.scalars(select(Participant)))
        trials = list(s.scalars(select(Trial)))
        sessions = list(s.scalars(select(Session)))
        jobs = list(s.scalars(select(Job)))
    assert all(person.simulated for person in people)
    assert [person.oracle["name"] for person in people] == ["shortest", "shortest"]
    assert {session.personalisation for session in sessions} == {"job_failed"}
    assert all(trial.phase == "answered" for trial in trials)
    assert [job.priority for job in jobs] == [5, 5]  # behind people


def test_the_oracle_decides_from_the_drives(client, house, link):
    with failing_worker(house):
        simulate_study("", link, 1, Character("shortest"), client=client)
    with house.database.session() as s:
        pairs = s.execute(select(Trial, Response.value).join(Response, Response.trial_id == Trial.id)).all()
    assert len(pairs) == 4
    for trial, value in pairs:
        a, b = (path_length_m(load_trajectory(house.files, t)) for t in (trial.trajectory_a, trial.trajectory_b))
        assert value["choice"] == ("b" if b < a else "a")


def test_an_unknown_oracle_is_refused_before_anybody_joins(client, house, link):
    with pytest.raises(LearningError, match="min-human-distance"):
        simulate_study("", link, 1, Character("nearest"), client=client)
    with house.database.session() as s:
        assert s.scalars(select(Participant)).first() is None


def test_a_bot_that_is_refused_says_why(client):
    with pytest.raises(BotError, match="404"):
        simulate_study("", "nowhere", 1, client=client)


# ---- what must not get in or out -------------------------------------------------------------------------------------


def test_half_characters_and_numbers_that_are_none_never_stop_an_export(client, house, link, token, tmp_path):
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
    with house.database.session() as s:
        study = s.scalars(select(Study.id).where(Study.recruiting_token == link)).one()
        assert s.scalars(select(ProblemReport)).one().text == "café ?"
        assert s.scalars(select(RecruitingId)).one().external_id == "id"
    export_study(house.database, house.files, study, tmp_path / "out")
    events = (tmp_path / "out" / "events.csv").read_text(encoding="utf-8")
    assert "café ? " in events
    assert "NaN" not in events


@pytest.mark.parametrize("address", ["203.0.113.7", "2001:db8::7", "no address"])
def test_nobody_elsewhere_can_join_as_a_bot_and_skip_watching(client, house, link, address):
    elsewhere = TestClient(client.app, client=(address, 50_000))
    refused = elsewhere.post(f"/join/{link}", json={"simulated": True, "language": "en"})
    assert (refused.status_code, refused.json()["error"]["code"]) == (403, "bots_from_elsewhere")
    assert len(logged(house, "bots_from_elsewhere")) == 1
    with house.database.session() as s:
        assert s.scalars(select(Participant)).first() is None
    assert elsewhere.post(f"/join/{link}", json={"language": "en"}).json()["simulated"] is False


def test_a_bot_gets_no_code_that_pays_and_takes_no_persons_place(client, house, link):
    with house.database.transaction() as s:
        text = s.scalars(select(Study.protocol_yaml).where(Study.recruiting_token == link)).one()
        kept = [line for line in text.splitlines() if "- train:" not in line and "- comparison:" not in line]
        frozen = freeze_text("\n".join(kept).replace("completion_code: random", "completion_code: PAID-2026"))
        paid = create_study(s, house.files, frozen, name="Paid", created_by=None).recruiting_token
    assert simulate_study("", paid, 1, client=client)["completed"] == 1
    with house.database.session() as s:
        assert s.scalars(select(Session.completion_code)).one() not in (None, "PAID-2026")
    someone = {"PROLIFIC_PID": "5f3c0ffee0ddba11"}
    assert client.post(f"/join/{paid}", json={"simulated": True, **someone}).status_code == 201
    assert client.post(f"/join/{paid}", data={"language": "en", **someone}).status_code == 303


def test_the_language_can_be_changed_between_pairs_and_answers_stay(client, house, token):
    submit(client, token, "information", walking.VALUES["information"])
    submit(client, token, "consent", walking.VALUES["consent"])
    assert 'value="de"' in client.get(f"/p/{token}").text
    changed = client.post(f"/p/{token}/language", data={"language": "de"})
    assert (changed.status_code, changed.headers["location"]) == (303, f"/p/{token}")
    assert client.get(f"/api/session/{token}").json()["language"] == "de"
    assert '<html lang="de"' in client.get(f"/p/{token}").text
    # The copy of the consent keeps the words that were agreed to.
    assert '<html lang="en"' in client.get(f"/p/{token}/consent").text
    with house.database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "language_changed")).one()
        assert (event.data["before"], event.data["after"], event.data["step"]) == ("en", "de", "demographics")
        assert s.scalars(select(Response).where(Response.step_key == "consent")).one()


def test_the_language_stays_while_a_pair_is_on_the_stage_and_when_it_is_none_of_the_protocols(client, house, token):
    refused = client.post(f"/p/{token}/language", data={"language": "fr"})
    assert refused.status_code == 422
    to_first_trial(client, token)
    refused = client.post(f"/p/{token}/language", data={"language": "de"})
    assert refused.status_code == 409
    assert "Not during a pair" in refused.text
    assert client.get(f"/api/session/{token}").json()["language"] == "en"
    assert len(logged(house, "in_trial")) == 1
