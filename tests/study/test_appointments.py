"""Later appointments: their links and windows, what they begin with, and how they end."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.store.models import Response, Session
from desirepath.study.kind import read_plan
from desirepath.study.links import next_token, token_hash
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.appointments import end_of
from desirepath.study.session.finding import acting
from tests.study.small_protocol import ABOUT, BLOCK, COME_BACK, RATING
from tests.study.walking import session_row


def test_a_later_appointment_has_its_own_link_and_window(walk, database, files):
    walker = walk(ABOUT, COME_BACK, BLOCK)
    walker.submit("about", {"age": 30})
    with acting(walker.database, walker.token, request="look", now=walker.now) as (s, session):
        view = machine.current(s, session)
    assert (view.kind, session_row(walker).state) == ("appointment", "completed")
    code = view.payload["return_code"]
    assert view.payload["return_path"] == f"/p/{code}"
    assert token_hash(code.lower().replace("-", " ")) == token_hash(code)
    walker.token, first = code.lower(), walker.token
    assert next_token(first) == code
    walker.later(3600 * 24)
    with acting(walker.database, walker.token, request="look", now=walker.now) as (s, session):
        assert machine.current(s, session, now=walker.now).kind == "too_soon"
        later = session
    walker.session = later
    with pytest.raises(Refused) as no:
        walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    assert no.value.code == "too_soon"
    walker.later(3600 * 24 + 1)
    walker.watch("block.01")
    walker.submit("block.01", {"choice": "a"})
    walker.watch("block.02")
    walker.submit("block.02", {"choice": "a"})
    second = session_row(walker)
    assert (second.state, second.appointment, second.assignment) == ("completed", 2, walker.session.assignment)
    assert walker.view.kind == "debriefing"
    with database.session() as s:
        assert len(set(s.scalars(select(Response.consent_id).where(Response.session_id == second.id)))) == 1


def test_an_appointment_that_was_missed_is_over_and_its_place_free(walk):
    walker = walk(ABOUT, COME_BACK, BLOCK)
    walker.submit("about", {"age": 30})
    walker.token = next_token(walker.token)
    walker.later(3600 * 24 * 9 + 60)
    with pytest.raises(Refused) as no:
        walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    assert no.value.code == "expired"


def test_a_later_appointment_begins_with_what_its_person_is_asked(walk):
    walker = walk(
        ABOUT, COME_BACK, {**RATING, "when": {"questionnaire": "about", "item": "gender", "is": "woman"}}, BLOCK
    )
    walker.submit("about", {"age": 30})
    walker.token = next_token(walker.token)
    walker.later(3600 * 24 * 2)
    with acting(walker.database, walker.token, request="look", now=walker.now) as (s, session):
        view = machine.current(s, session, now=walker.now)
    assert (view.key, view.trial["phase"]) == ("block.01", "ready")


def test_who_withdraws_leaves_the_later_appointment_too(walk, database):
    walker = walk(ABOUT, COME_BACK, BLOCK)
    walker.submit("about", {"age": 30})
    walker.do(machine.withdraw, now=walker.now)
    with database.session() as s:
        mine = s.scalars(select(Session).where(Session.participant_id == walker.session.participant_id)).all()
    assert {session.state for session in mine} == {"withdrawn"}
    assert [
        end_of(read_plan(session.plan), session.appointment)
        for session in sorted(mine, key=lambda one: one.appointment)
    ] == [3, 6]
