"""What people are told about what is stored, and their own code: the pages say what the server then does."""

from __future__ import annotations

import re
from uuid import uuid4

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.store.models import Participant, Response, Session, Study
from desirepath.study.kinds.consent import POINT
from desirepath.study.protocol.freezing import freeze
from desirepath.web.participant.sent import DEVICE_FIELDS
from tests.web.lab_services import VALUES


@pytest.fixture
def link(lab_services, walked):
    with lab_services.database.session() as s:
        return f"/join/{s.get_one(Study, walked.id).recruiting_token}"


def joined(visitor: TestClient, link: str) -> str:
    device = '{"width": 1024, "height": 700, "webgl": true, "browser": "Firefox"}'
    answered = visitor.post(link, data={"language": "en", "device": device})
    return answered.headers["location"].removeprefix("/p/")


def newest(s):
    return s.scalars(select(Session).order_by(Session.created_at.desc())).first()


def submit(client, token, key):
    body = {"request_id": uuid4().hex, "value": VALUES[key]}
    return client.post(f"/api/session/{token}/steps/{key}", json=body)


def test_continue_stores_a_code_and_the_window_as_the_first_page_says(visitor, link, lab_services):
    told = visitor.get(link).text
    assert "we note your language and what your screen can show, under a random code" in told
    assert "Nothing is stored" not in told
    assert "Prolific" not in told
    assert "We also store your Prolific ID" in visitor.get(f"{link}?PROLIFIC_PID=p1").text
    joined(visitor, link)
    with lab_services.database.session() as s:
        assert newest(s).device == {"width": 1024, "height": 700, "webgl": True}
        assert set(newest(s).device) <= set(DEVICE_FIELDS)


def test_no_answer_is_stored_before_the_consent_and_declining_marks_the_visit(visitor, link, lab_services):
    token = joined(visitor, link)
    assert submit(visitor, token, "information").status_code == 200
    assert submit(visitor, token, "demographics").status_code == 409
    assert visitor.post(f"/api/session/{token}/withdraw", json={}).json()["state"] == "withdrawn"
    with lab_services.database.session() as s:
        session = newest(s)
        assert (session.state, session.plan[session.position]["kind"]) == ("withdrawn", "consent")
        person = s.get_one(Participant, session.participant_id)
        assert person.withdrawn_at is not None
        stored = s.scalars(select(Response).where(Response.session_id == session.id)).all()
        assert [(one.step_key, one.value) for one in stored] == [("information", {})]
    page = visitor.get(f"/p/{token}").text
    told = page.partition("<main")[2].partition("</main>")[0]
    assert f'Participant ID: <span translate="no">{person.code}</span>.' in told
    assert "You are not taking part" in told
    assert "Thank" not in told, "nobody is thanked for what they did not give"
    again = visitor.get(link).text
    assert "You decided not to take part in this study." in again
    assert "Questions? Please ask" in again
    assert 'id="begin"' not in again


@pytest.mark.parametrize("language", ["en", "de"])
def test_little_is_read_before_the_first_drive_and_the_consent_says_what_it_must(language):
    """570 words stood before anything moved; what is needed for a consent is not among what is folded away."""
    frozen = freeze(PROTOCOLS / "quick_preference_study.yaml")
    shown = {}
    for name in ("information", "consent", "instruction"):
        text = frozen.text(f"texts/{name}.md", language)[1]
        shown[name] = text.partition("<!-- more -->")[0]
    ticked = POINT.findall(frozen.text("texts/consent.md", language)[1])
    assert len(" ".join([*shown.values(), *ticked]).split()) <= 285
    needed = {
        "en": ("What is stored", "What for", "How long", "If you withdraw"),
        "de": ("Was gespeichert wird", "Wofür", "Wie lange", "widerrufen"),
    }
    assert [words for words in needed[language] if words not in shown["consent"]] == []


def test_the_consent_names_whom_to_ask_and_folds_the_rest_away(visitor, link):
    token = joined(visitor, link)
    submit(visitor, token, "information")
    page = visitor.get(f"/p/{token}").text.partition("<main")[2]
    assert "Questions? Please ask" in page.partition("<dialog")[0]
    assert '<details class="more">' in page
    assert "more --" not in page
    copy = visitor.get(f"/p/{token}/consent").text
    assert "<details" not in copy, "a copy that is printed holds all of it"
    assert "cannot be changed afterwards" in copy
    assert "more --" not in copy


def test_the_view_from_inside_is_explained_only_where_it_is_shown(visitor, link, lab_services):
    token = joined(visitor, link)
    inside = "In the view from inside the room"
    for page in (f"/p/{token}", f"/p/{token}/help"):
        assert inside not in visitor.get(page).text
    with lab_services.database.transaction() as s:
        session = newest(s)
        session.plan = [step | {"view": "immersive"} if "view" in step else step for step in session.plan]
    for page in (f"/p/{token}", f"/p/{token}/help"):
        assert inside in visitor.get(page).text


def test_the_debriefing_shows_the_own_code_apart_from_the_completion_code(lab, walked):
    steps = lab.get(f"/lab/studies/{walked.id}/preview/1?language=en").text
    last = int(re.findall(r"Preview 1 of (\d+)", steps)[0])
    page = lab.get(f"/lab/studies/{walked.id}/preview/{last}?language=de").text
    assert re.search(r'id="own-code">Teilnehmer-ID: <span translate="no">P-EXAMPLE</span>\.', page)
    assert '<h2 id="code-title">Abschlusscode</h2>' in page
    assert re.search(r'id="completion-code" translate="no">EXAMPLE<', page)


def test_recruit_reminds_of_a_contact_until_there_is_one(lab, walked):
    page = f"/lab/studies/{walked.id}/recruit"
    assert 'id="no-contact"' in lab.get(page).text
    csrf = re.search(r'name="csrf" value="([^"]+)"', lab.get("/lab/settings").text).group(1)
    form = {"csrf": csrf, "public_url": "", "help_contact": "Ada, ada@example.org"}
    assert lab.post("/lab/settings", data=form).status_code == 303
    assert 'id="no-contact"' not in lab.get(page).text
