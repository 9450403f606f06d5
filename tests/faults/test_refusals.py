"""What nobody may do: refused over HTTP and at the stage's door of a running server, and the event log says so."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from uuid import uuid4

import httpx
import pytest
import websockets

from desirepath.store.models import Event, Session, utc_now
from tests.faults.conftest import Served
from tests.faults.installation import Installation, Visitor, hear, stage_token_of


def refused(answer: httpx.Response, status: int, code: str) -> None:
    assert answer.status_code == status, answer.text
    assert answer.json()["error"]["code"] == code
    assert answer.json()["error"]["message"]


def newest_refusal(installation: Installation, code: str) -> Event:
    return installation.refusals(code)[-1]


def test_an_answer_before_both_drives_could_have_been_seen(served: Served) -> None:
    person = served.visitor()
    step = person.walk_to_first_trial()["key"]
    person.open_page()
    refused(person.answer(step, {"choice": "a"}), 409, "too_early")
    with person.stage() as stage:
        hear(stage, '"type": "show"')
        playback = person.post(f"trials/{step}/start").json()["step"]["trial"]["playback_id"]
        hear(stage, playback)
        refused(person.post(f"trials/{step}/seen", side="a", playback_id=playback), 409, "too_early")
        refused(person.answer(step, {"choice": "a"}), 409, "too_early")
    logged = served.installation.refusals("too_early")
    assert {event.session_id for event in logged} >= {served.installation.session(person.token).id}
    assert [event.data["request"] for event in logged][-3:] == ["answer", "seen", "answer"]
    assert step not in {row.step_key for row in served.installation.responses(person.token)}


def test_an_answer_to_another_trial_or_to_anothers(served: Served) -> None:
    bot, other = served.visitor(bot=True), served.visitor(bot=True)
    step = bot.walk_to_first_trial()["key"]
    other.walk_to_first_trial()
    later = served.installation.session(bot.token).plan[-5]["key"]
    refused(bot.answer(later, {"choice": "a"}), 409, "not_current_step")
    refused(bot.post(f"trials/{later}/start"), 409, "not_current_step")
    refused(bot.answer("made-up", {"choice": "a"}), 404, "unknown_step")
    playback = other.post(f"trials/{step}/start").json()["step"]["trial"]["playback_id"]
    bot.post(f"trials/{step}/start")
    refused(bot.post(f"trials/{step}/seen", side="a", playback_id=playback), 409, "other_playback")
    bot.post(f"trials/{step}/interrupted", reason="connection")
    bot.watch(step)
    request_id = uuid4().hex
    assert bot.answer(step, {"choice": "a"}, request_id).status_code == 200
    other.post(f"trials/{step}/interrupted", reason="connection")
    other.watch(step)
    refused(other.answer(step, {"choice": "b"}, request_id), 409, "request_id_used")
    mine, theirs = (served.installation.session(one.token).id for one in (bot, other))
    for code, session in (("not_current_step", mine), ("other_playback", mine), ("request_id_used", theirs)):
        assert newest_refusal(served.installation, code).session_id == session
    assert newest_refusal(served.installation, "unknown_step").data["asked"] == "made-up"


def test_a_double_click_and_a_replayed_request_count_once(served: Served) -> None:
    bot = served.visitor(bot=True)
    step = bot.walk_to_first_trial()["key"]
    bot.watch(step)
    request_id = uuid4().hex
    with ThreadPoolExecutor(4) as clicks:
        answers = list(clicks.map(lambda _: bot.answer(step, {"choice": "b"}, request_id), range(4)))
    assert [answer.status_code for answer in answers] == [200] * 4
    assert sorted(answer.json()["duplicate"] for answer in answers) == [False, True, True, True]
    replayed = bot.answer(step, {"choice": "a"}, request_id).json()
    assert replayed["duplicate"] is True
    refused(bot.answer(step, {"choice": "a"}), 409, "already_answered")
    stored = [row for row in served.installation.responses(bot.token) if row.step_key == step]
    assert [row.value for row in stored] == [{"choice": "b"}], "the first answer stays"
    duplicates = served.installation.events("duplicate_request")
    session = served.installation.session(bot.token).id
    assert [event.session_id for event in duplicates].count(session) == 4


ROUTES = [
    ("GET", "/p/{token}"),
    ("GET", "/p/{token}/step"),
    ("GET", "/api/session/{token}"),
    ("GET", "/api/session/{token}/stream"),
    ("POST", "/api/session/{token}/steps/{step}"),
    ("POST", "/api/session/{token}/trials/{step}/start"),
    ("POST", "/api/session/{token}/pause"),
]


def ask_everywhere(visitor: Visitor, token: str, step: str) -> set[int]:
    """The statuses that all routes of a session answer for a token."""
    body = {"request_id": uuid4().hex, "value": {"choice": "a"}}
    return {
        visitor.browser.request(
            method, route.format(token=token, step=step), json=body if method == "POST" else None
        ).status_code
        for method, route in ROUTES
    }


def test_a_forged_token_opens_nothing_and_is_not_written_down(served: Served) -> None:
    bot = served.visitor(bot=True)
    step = bot.walk_to_first_trial()["key"]
    before = len(served.installation.refusals("unknown"))
    forged = bot.token[:-4] + "AAAA"
    assert ask_everywhere(bot, forged, step) == {404}
    logged = served.installation.refusals("unknown")[before:]
    assert len(logged) == 1, "a robot that goes on trying a dead link does not fill the log"
    assert {event.session_id for event in logged} == {None}
    assert not any(forged in str(event.data) or bot.token in str(event.data) for event in logged)


def test_an_expired_token_opens_nothing_and_the_session_says_so(served: Served) -> None:
    bot = served.visitor(bot=True)
    step = bot.walk_to_first_trial()["key"]
    bot.open_page()
    stage = stage_token_of(bot)
    stage_url = bot.state()["stage_url"]
    session = served.installation.session(bot.token)
    with served.installation.database.transaction() as s:
        s.get_one(Session, session.id).expires_at = utc_now() - timedelta(seconds=1)
    assert bot.browser.get(stage_url).status_code == 403
    assert newest_refusal(served.installation, "stage_of_ended_session").session_id == session.id
    assert ask_everywhere(bot, bot.token, step) == {410}
    assert served.installation.session(bot.token).state == "expired"
    logged = [event for event in served.installation.refusals("expired") if event.session_id == session.id]
    assert len(logged) == 1, "a robot that goes on trying a dead link does not fill the log"
    assert stage.startswith(session.id)


@pytest.mark.parametrize("wrong", ["foreign", "forged", "unknown"])
def test_a_stage_opens_only_to_the_browser_of_its_own_session(served: Served, wrong: str) -> None:
    owner, stranger = served.visitor(bot=True), served.visitor(bot=True)
    for visitor in (owner, stranger):
        visitor.walk_to_first_trial()
        visitor.open_page()
    session, _, proof = stage_token_of(owner).partition(".")
    own, _, own_proof = stage_token_of(stranger).partition(".")
    token, code = {
        "foreign": (f"{session}.{proof}", "stage_without_cookie"),
        "forged": (f"{session}.{own_proof}", "forged_stage"),
        "unknown": (f"{own[::-1]}.{proof}", "unknown_stage"),
    }[wrong]
    with pytest.raises(websockets.exceptions.InvalidStatus) as answer, stranger.stage(token=token):
        pass
    assert answer.value.response.status_code == 403
    page = stranger.state()["stage_url"].replace(stage_token_of(stranger), token)
    assert stranger.browser.get(page).status_code == 403
    assert newest_refusal(served.installation, code).session_id == (None if wrong == "unknown" else session)


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "the page's"])
def test_a_websocket_from_another_origin_is_refused(served: Served, origin: str) -> None:
    bot = served.visitor(bot=True)
    bot.walk_to_first_trial()
    bot.open_page()
    said = served.url if origin == "the page's" else origin
    with pytest.raises(websockets.exceptions.InvalidStatus) as answer, bot.stage(origin=said):
        pass
    assert answer.value.response.status_code == 403
    with bot.stage() as stage:
        hear(stage, '"type": "show"')  # the door itself is fine, and has written the refusal down meanwhile
    reasons = [event.data["reason"] for event in served.installation.refusals("stage_door")]
    assert any(reason == f"websocket: wrong origin {said!r}" for reason in reasons), reasons


def test_only_a_session_that_was_made_as_simulated_may_skip_or_read_drives(served: Served) -> None:
    person = served.visitor()
    step = person.walk_to_first_trial()["key"]
    refused(person.post(f"trials/{step}/start"), 409, "stage_not_ready")
    refused(person.browser.get(f"{person.api}/trial-data"), 403, "simulated_only")
    session = served.installation.session(person.token).id
    assert newest_refusal(served.installation, "simulated_only").session_id == session
    assert newest_refusal(served.installation, "stage_not_ready").session_id == session
