"""The server's clock is set forward or back while somebody takes part: they go on, and no number is made up."""

from __future__ import annotations

from datetime import timedelta

import pytest
from sqlalchemy import select

from desirepath.store.models import Event
from desirepath.study.clock import elapsed_s
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from tests.study.small_protocol import BLOCK
from tests.study.walking import answer, session_row

HOUR = timedelta(hours=1)


def test_a_session_that_expired_by_a_wrong_clock_goes_on_when_it_is_right(walk, database):
    walker = walk(BLOCK)
    right = walker.now
    walker.now = right + timedelta(days=30)
    with pytest.raises(Refused) as no:
        walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    assert (no.value.code, session_row(walker).state) == ("expired", "expired")
    walker.now = right + timedelta(minutes=1)
    walker.watch("block.01")
    walker.submit("block.01", {"choice": "a"})
    assert session_row(walker).state == "active"
    with database.session() as s:
        kinds = s.scalars(select(Event.kind).where(Event.session_id == walker.session.id)).all()
    assert [kind for kind in kinds if kind.startswith("session_")] == ["session_expired", "session_reopened"]
    walker.now = right + timedelta(days=30)  # and one whose time is over stays so
    with pytest.raises(Refused, match="could be continued is over"):
        walker.watch("block.02")


def test_nobody_waits_for_a_clock_that_was_set_back(walk):
    walker = walk(BLOCK)
    play = walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    walker.now -= HOUR
    play = walker.do(machine.trajectory_seen, "block.01", "a", play.playback_id, now=walker.now)
    walker.do(machine.trajectory_seen, "block.01", "b", play.playback_id, now=walker.later(60))
    walker.now -= HOUR
    walker.submit("block.01", {"choice": "b"})
    assert answer(walker, "block.01").decision_s is None  # nobody can tell
    walker.watch("block.02")
    with pytest.raises(Refused) as no:  # a clock that runs on is still asked
        walker.do(machine.start_trial, "block.02", request_id=None, now=walker.now)
    assert no.value.code == "not_ready"


def test_what_a_clock_can_say(walk):
    at = walk(BLOCK).now
    assert elapsed_s(at, at + HOUR) == 3600
    assert elapsed_s(at, at - timedelta(seconds=0.5)) == 0  # it is slewed all the time
    assert elapsed_s(at, at - timedelta(seconds=2)) is None
