"""The link over HTTP: who may join by it, and what of them and of their device is kept."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.store.models import Event, Participant, RecruitingId, Session, Study
from desirepath.study.protocol.freezing import freeze, freeze_text
from desirepath.study.session.joining import UNFILLED
from desirepath.study.studies import create_study
from tests.web.participant_services import logged, to_first_trial


def test_the_welcome_page_stores_nothing_and_speaks_the_browsers_language(client, services, link):
    for language, words in (("de", "Wie soll der Roboter"), ("en", "How should the robot")):
        answered = client.get(f"/join/{link}", headers={"Accept-Language": language})
        assert answered.status_code == 200
        assert words in answered.text
    with services.database.session() as s:
        assert s.scalars(select(Participant)).first() is None


def test_joining_keeps_the_device_and_leads_to_the_session(client, services, token):
    with services.database.session() as s:
        session = s.scalars(select(Session)).one()
    assert session.device == {"width": 1024, "webgl": True}
    assert not session.simulated
    answered = client.get(f"/p/{token}")
    assert answered.headers["x-step-key"] == "information"
    assert "How should the robot pass you?" in answered.text


def test_who_goes_on_in_another_browser_has_the_device_looked_at_first(client, services, link):
    with services.database.transaction() as s:
        short = s.scalars(select(Study).where(Study.recruiting_token == link)).one()
        frozen = freeze_text(short.protocol_yaml + "\ndevice: {min_width: 1000, light_below: 20}\n")
        gated = create_study(s, services.files, frozen, name="Gated", created_by=None).recruiting_token
    desk = '{"width": 1024, "webgl": true}'
    token = client.post(f"/join/{gated}", data={"language": "en", "device": desk}).headers["location"][3:]
    to_first_trial(client, token)
    elsewhere = TestClient(client.app, follow_redirects=False)
    page = elsewhere.get(f"/p/{token}").text
    assert "Before you go on" in page
    assert f'action="/p/{token}/device"' in page
    refused = elsewhere.post(f"/p/{token}/device", data={"device": '{"width": 390, "webgl": false}'})
    assert (refused.status_code, "Your answers so far are kept" in refused.text) == (403, True)
    assert [event.data["reasons"] for event in logged(services, "other_device")] == [["webgl", "width"]]
    assert "Before you go on" in elsewhere.get(f"/p/{token}").text
    slow = '{"width": 1200, "webgl": true, "frame_rate": 12.5}'
    assert elsewhere.post(f"/p/{token}/device", data={"device": slow}).headers["location"] == f"/p/{token}"
    assert elsewhere.get(f"/p/{token}").headers["x-step-key"] == "block.01"
    with services.database.session() as s:
        assert s.scalars(select(Session)).one().device["scene_detail"] == "light"
        (event,) = s.scalars(select(Event).where(Event.kind == "device_checked"))
    assert (event.data["before"]["width"], event.data["after"]["width"]) == (1024, 1200)
    assert client.get(f"/p/{token}").headers["x-step-key"] == "block.01"  # the first one goes on as well


def test_a_platforms_id_is_kept_apart_and_lets_nobody_in_twice(client, services, link):
    ids = {"PROLIFIC_PID": "5f3c0ffee0ddba11", "STUDY_ID": "s1", "SESSION_ID": "x1"}
    welcome = client.get(f"/join/{link}", params=ids)
    assert ids["PROLIFIC_PID"] in welcome.text  # travels on in the form
    assert client.post(f"/join/{link}", data={"language": "en", **ids}).status_code == 303
    elsewhere = TestClient(client.app, follow_redirects=False)
    again = elsewhere.post(f"/join/{link}", data={"language": "en", **ids})
    assert again.status_code == 409
    assert len(logged(services, "already_joined")) == 1
    with services.database.session() as s:
        assert s.scalars(select(RecruitingId)).one().external_id == ids["PROLIFIC_PID"]


def joined_as(services) -> list[tuple[str, str]]:
    with services.database.session() as s:
        return [(one.platform, one.external_id) for one in s.scalars(select(RecruitingId))]


def join_elsewhere(client, link, **ids):
    return TestClient(client.app, follow_redirects=False).post(f"/join/{link}", data={"language": "en", **ids})


@pytest.mark.parametrize("again", [" 5f3C0FFEE ", "5F3C0ffee", "\u00a05f3c0ffee\t"])
def test_spaces_and_capitals_make_no_second_person(client, services, link, again):
    own = client.post(f"/join/{link}", data={"language": "en", "PROLIFIC_PID": "5f3c0ffee"}).headers["location"]
    assert join_elsewhere(client, link, PROLIFIC_PID=again).status_code == 409
    assert client.get(f"/join/{link}", params={"prolific_pid": again}).headers["location"] == own
    assert joined_as(services) == [("prolific", "5f3c0ffee")]


@pytest.mark.parametrize(
    ("ids", "kept"),
    [
        ({"prolific_pid": "abc", "Study_Id": "s"}, ("prolific", "abc")),
        ({"survey_code": "12345"}, ("sona", "12345")),
        ({"ID": "12345"}, ("sona", "12345")),
        ({"workerid": "A1B2C3", "AssignmentId": "3X", "hitId": "3Y"}, ("mturk", "A1B2C3")),
        ({"PROLIFIC_PID": "{{%PROLIFIC_PID%}}", "workerId": "A1B2C3"}, ("mturk", "A1B2C3")),
    ],
)
def test_every_platforms_parameters_are_read_in_any_case(client, services, link, ids, kept):
    page = client.get(f"/join/{link}", params=ids)
    assert (page.status_code, f'value="{kept[1]}"' in page.text, "separately from your answers" in page.text) == (
        200,
        True,
        True,
    )
    assert client.post(f"/join/{link}", json={"language": "en", **ids}).status_code == 201
    assert joined_as(services) == [kept]


@pytest.mark.parametrize(
    "odd",
    [
        *(
            "X,500.00\nY",
            "a b",
            "=cmd()",
            "-a;b",
            "a'b",
            'a"b',
            "X\u202eY",
            "\uff11\uff12",
            "\u0430bc",
            "a\u200b",
        ),
        *("x" * 65, "id@platform.org", "../x", "<script>alert(1)</script>x", "{{7*7}}x", "a{b}"),
    ],
)
def test_what_no_platform_writes_is_no_id_at_the_door(client, services, link, odd):
    """It reached the lists of who is to be paid unquoted: `X,500.00` and a new line paid somebody five hundred."""
    for name in ("PROLIFIC_PID", "SESSION_ID", "workerid"):
        answered = client.post(f"/join/{link}", data={"language": "en", "PROLIFIC_PID": "fine", name: odd})
        assert (answered.status_code, "Something is wrong with this link" in answered.text) == (422, True)
        refused = client.post(f"/join/{link}", json={"language": "en", name: odd})
        assert (refused.status_code, refused.json()["error"]["field"].lower()) == (422, name.lower())
        shown = client.get(f"/join/{link}", params={name: odd}, headers={"accept-language": "de"})
        assert (shown.status_code, "Mit diesem Link stimmt etwas nicht" in shown.text) == (422, True)
    assert joined_as(services) == []
    assert odd not in str([event.data for event in logged(services, "bad_id")])


@pytest.mark.parametrize(
    "ids",
    [
        {"PROLIFIC_PID": "{{%PROLIFIC_PID%}}", "STUDY_ID": "{{%STUDY_ID%}}", "SESSION_ID": "{{%SESSION_ID%}}"},
        *({"prolific_pid": one} for one in ("{{PROLIFIC_PID}}", "${e://Field/PROLIFIC_PID}", "[%a%]", "prolific_pid")),
        *({"id": one} for one in ("%SURVEY_CODE%", "<survey_code>", "survey_code")),
        {"workerId": "${workerId}", "assignmentId": "${assignmentId}"},
    ],
)  # fmt: skip
def test_a_placeholder_that_was_never_filled_in_is_no_id_and_is_noted(client, services, link, ids):
    page = client.get(f"/join/{link}", params=ids)
    assert (page.status_code, "separately from your answers" in page.text) == (200, False)
    for _ in range(2):
        assert join_elsewhere(client, link, **ids).status_code == 303
    assert joined_as(services) == []
    with services.database.session() as s:
        noted = s.scalars(select(Event).where(Event.kind == UNFILLED)).all()
        assert len(noted) == len(s.scalars(select(Session)).all()) == 2
    assert {name.lower() for name in noted[0].data["parameters"]} == {name.lower() for name in ids}


def test_a_preview_is_no_worker(client, services, link):
    ids = {"assignmentId": "ASSIGNMENT_ID_NOT_AVAILABLE", "hitId": "3Y", "workerId": "A1B2C3"}
    assert "accept the task first" in client.get(f"/join/{link}", params=ids).text
    assert join_elsewhere(client, link, **ids).status_code == 303
    assert joined_as(services) == []


@pytest.mark.parametrize("method", ["get", "post"])
def test_an_unknown_and_a_closed_link_say_so(client, services, link, method):
    assert getattr(client, method)("/join/nowhere").status_code == 404
    with services.database.transaction() as s:
        s.scalars(select(Study).where(Study.recruiting_token == link)).one().state = "closed"
    assert getattr(client, method)(f"/join/{link}").status_code == 403


def test_opening_the_recruiting_link_again_in_the_same_browser_goes_on(client, services, link):
    ids = {"PROLIFIC_PID": "5f3c0ffee0ddba11", "STUDY_ID": "s1", "SESSION_ID": "x1"}
    own = client.post(f"/join/{link}", data={"language": "en", **ids}).headers["location"]
    for again in (
        client.get(f"/join/{link}", params=ids),
        client.post(f"/join/{link}", data={"language": "en", **ids}),
    ):
        assert (again.status_code, again.headers["location"]) == (303, own)
    for offered in (client.get(f"/join/{link}").text, client.get(f"/join/{link}?lang=en").text):
        assert f'href="{own}">Continue where you were</a>' in offered
        assert 'id="begin"' not in offered, "no second session is offered"
    kept = client.post(f"/join/{link}", data={"language": "en"})  # from a page of before, to which Back led
    assert (kept.status_code, kept.headers["location"]) == (303, own)
    somebody_else = client.get(f"/join/{link}", params=ids | {"PROLIFIC_PID": "another"})
    assert (somebody_else.status_code, own in somebody_else.text) == (200, False)
    elsewhere = TestClient(client.app, follow_redirects=False)
    assert own not in elsewhere.get(f"/join/{link}", params=ids).text
    with services.database.transaction() as s:
        s.scalars(select(Study).where(Study.recruiting_token == link)).one().state = "closed"
    assert f'href="{own}">Continue' in client.get(f"/join/{link}").text, "closed is for those who have not begun"
    assert elsewhere.get(f"/join/{link}").status_code == 403


def test_the_link_of_a_finished_session_says_so_and_begins_no_other(client, services, link):
    own = client.post(f"/join/{link}", data={"language": "en"}).headers["location"]
    with services.database.transaction() as s:
        session = s.scalars(select(Session)).one()
        session.state, session.position = "completed", len(session.plan) - 1
    page = client.get(f"/join/{link}").text
    assert "You have finished this study." in page
    assert f'href="{own}">Show the last page again</a>' in page
    assert "Questions? Please ask" in page
    assert 'id="begin"' not in page
    assert "Sie haben diese Studie abgeschlossen." in client.get(f"/join/{link}?lang=de").text
    assert client.post(f"/join/{link}", data={"language": "en"}).headers["location"] == own
    with services.database.session() as s:
        assert len(s.scalars(select(Session)).all()) == 1


@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("quick_preference_study", (320, 480)),
        ("crowd_study", (320, 480)),
        ("meet_your_robot_study", (320, 480)),
        ("words_study", (320, 480)),
        ("quick_demonstration_study", (740, 500)),
        ("moving_person_study", (740, 500)),
        ("adaptable_study", (740, 500)),
        ("interface_study", (1000, 600)),
    ],
)
def test_what_a_device_must_have_goes_by_what_is_shown(name, least):
    """A room from above fits a phone; drawing, walking and views from inside do not."""
    gate = freeze(PROTOCOLS / f"{name}.yaml").protocol.asked_of_devices
    assert (gate.min_width, gate.min_height) == least


@pytest.mark.parametrize("views", ["each: [top_down, immersive]", "one_of: {view: [top_down, first_person]}"])
def test_one_view_from_inside_is_enough_to_need_a_larger_screen(views):
    text = (PROTOCOLS / "quick_preference_study.yaml").read_text().replace("view: top_down", views)
    text = text.replace(", choose: information", "").partition("  - train:")[0]
    text += "  - debriefing: {text: texts/debriefing.md}\n"
    gate = freeze_text(text).protocol.asked_of_devices
    assert (gate.min_width, gate.min_height) == (740, 500)


def test_the_first_words_are_the_protocols(client, services, tmp_path):
    """Whoever is to draw, or to rate, does not read that they will say which drives they prefer."""
    told = {}
    for name in ("quick_preference_study", "quick_demonstration_study"):
        with services.database.transaction() as s:
            study = create_study(s, services.files, freeze(PROTOCOLS / f"{name}.yaml"), name=name, created_by=None)
            link = study.recruiting_token
        told[name] = client.get(f"/join/{link}").text
    assert "say which ones you prefer" in told["quick_preference_study"]
    assert "draw on the floor of a room" in told["quick_demonstration_study"]
    assert "prefer" not in told["quick_demonstration_study"]
    own = (PROTOCOLS / "quick_preference_study.yaml").read_text()
    own = own.replace(
        "languages: [en, de]", "languages: [en, de]\nwelcome: {en: Help a robot learn., de: Bringen Sie es ihm bei.}"
    )
    with services.database.transaction() as s:
        study = create_study(s, services.files, freeze_text(own), name="own", created_by=None)
        link = study.recruiting_token
    assert "Help a robot learn." in client.get(f"/join/{link}?lang=en").text
