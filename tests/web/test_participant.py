"""A participant's session over HTTP: its pages, its steps and trials, pausing, leaving, another language."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.store.models import Event, Response
from tests.study import walking
from tests.web.participant_services import logged, submit, to_first_trial


def test_every_step_has_a_page_in_both_languages(client, link):
    for language in ("en", "de"):
        client = TestClient(client.app, follow_redirects=False)  # a browser of their own
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


def test_answering_too_early_is_refused_and_logged(client, services, token):
    to_first_trial(client, token)
    early = submit(client, token, "block.01", {"choice": "a"})
    assert early.status_code == 409
    assert early.json()["error"]["code"] == "too_early"
    started = client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-01"}).json()
    shown = started["step"]["trial"]["playback_id"]
    seen = client.post(f"/api/session/{token}/trials/block.01/seen", json={"side": "a", "playback_id": shown})
    assert seen.json()["error"]["code"] == "too_early"
    assert len(logged(services, "too_early")) == 2


def test_a_replayed_request_is_acknowledged_and_counts_once(client, token):
    first = submit(client, token, "information", {}, "one-request-id")
    again = submit(client, token, "information", {}, "one-request-id")
    assert (first.json()["duplicate"], again.json()["duplicate"]) == (False, True)
    assert again.json()["step"]["key"] == "consent"


def test_another_participants_trial_cannot_be_answered_or_played(client, services, link, token):
    elsewhere = TestClient(client.app, follow_redirects=False)
    other = elsewhere.post(f"/join/{link}", data={"language": "en"}).headers["location"].removeprefix("/p/")
    to_first_trial(client, token)
    to_first_trial(client, other)
    theirs = client.post(f"/api/session/{other}/trials/block.01/start", json={"request_id": "start-01"}).json()
    client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-02"})
    shown = theirs["step"]["trial"]["playback_id"]
    foreign = client.post(f"/api/session/{token}/trials/block.01/seen", json={"side": "a", "playback_id": shown})
    assert foreign.json()["error"]["code"] == "other_playback"
    assert len(logged(services, "other_playback")) == 1


def test_a_reload_in_the_middle_starts_the_trial_over(client, services, token):
    to_first_trial(client, token)
    client.post(f"/api/session/{token}/trials/block.01/start", json={"request_id": "start-01"})
    client.get(f"/p/{token}")
    trial = client.get(f"/api/session/{token}").json()["step"]["trial"]
    assert (trial["phase"], trial["restarts"]) == ("ready", 1)
    with services.database.session() as s:
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


def test_what_the_page_noticed_is_logged_with_its_own_time(client, services, token):
    told = {"kind": "visibility", "data": {"hidden": True}, "client_time": "2026-11-21T10:00:00+01:00"}
    assert client.post(f"/api/session/{token}/events", json=told).status_code == 204
    assert client.post(f"/api/session/{token}/events", json={"kind": "sql"}).status_code == 422
    with services.database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "page_visibility")).one()
    assert event.client_time.hour == 9
    assert event.data["page"] == {"hidden": True}


def test_the_language_can_be_changed_between_pairs_and_answers_stay(client, services, token):
    submit(client, token, "information", walking.VALUES["information"])
    submit(client, token, "consent", walking.VALUES["consent"])
    assert 'value="de"' in client.get(f"/p/{token}").text
    changed = client.post(f"/p/{token}/language", data={"language": "de"})
    assert (changed.status_code, changed.headers["location"]) == (303, f"/p/{token}")
    assert client.get(f"/api/session/{token}").json()["language"] == "de"
    assert '<html lang="de"' in client.get(f"/p/{token}").text
    # The copy of the consent keeps the words that were agreed to.
    assert '<html lang="en"' in client.get(f"/p/{token}/consent").text
    with services.database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "language_changed")).one()
        assert (event.data["before"], event.data["after"], event.data["step"]) == ("en", "de", "demographics")
        assert s.scalars(select(Response).where(Response.step_key == "consent")).one()


def test_the_language_stays_while_a_pair_is_on_the_stage_and_when_it_is_none_of_the_protocols(client, services, token):
    refused = client.post(f"/p/{token}/language", data={"language": "fr"})
    assert refused.status_code == 422
    to_first_trial(client, token)
    refused = client.post(f"/p/{token}/language", data={"language": "de"})
    assert refused.status_code == 409
    assert "Not during a pair" in refused.text
    assert client.get(f"/api/session/{token}").json()["language"] == "en"
    assert len(logged(services, "in_trial")) == 1
