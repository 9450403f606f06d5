"""How long, how often and how early: limits of time, breaks, watching again, choosing before the end."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.store.models import Trial
from desirepath.study.protocol.freezing import freeze
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.web.lab.preview import preview_steps
from tests.study.small_protocol import BLOCK
from tests.study.walking import answer


def test_time_for_a_choice_ends_by_the_servers_clock(walk):
    walker = walk({"block": {**BLOCK["block"], "viewing": {"choice_limit_s": 10}}})
    walker.watch("block.01")
    assert walker.view.payload["choice_limit_s"] == 10
    walker.later(4)
    with pytest.raises(Refused, match="still time"):
        walker.submit("block.01", {"timed_out": True})
    walker.later(7)
    with pytest.raises(Refused) as no:
        walker.submit("block.01", {"choice": "a"})
    assert no.value.code == "too_late"
    walker.submit("block.01", {"timed_out": True})
    assert answer(walker, "block.01").value == {"timed_out": True}
    assert walker.view.key == "block.02"


def test_a_questionnaires_time_hands_in_what_is_there_but_not_before_it_is_over(walk):
    walker = walk({"questionnaire": {"use": "rating", "time_limit_s": 60}}, BLOCK)
    with pytest.raises(Refused) as no:
        walker.submit("rating", {"ease": 3, "timed_out": True})
    assert no.value.code == "too_early"
    walker.later(61)
    walker.submit("rating", {"ease": 3, "timed_out": True})
    assert answer(walker, "rating").value == {"ease": 3, "timed_out": True}


def test_a_questionnaires_time_goes_on_through_reloads_and_pauses(walk):
    walker = walk({"questionnaire": {"use": "rating", "time_limit_s": 60}}, BLOCK)
    walker.later(20)
    assert walker.view.payload["time_left_s"] == 40  # what a page that is loaded again is given
    walker.do(machine.pause, now=walker.now)
    walker.later(15)
    walker.do(machine.resume, now=walker.now)
    assert walker.view.payload["time_left_s"] == 25
    walker.later(40)
    assert walker.view.payload["time_left_s"] == 0
    walker.submit("rating", {"ease": 3})  # from a page whose own clock stood still
    assert answer(walker, "rating").value == {"ease": 3, "timed_out": True}


def test_a_break_that_is_loaded_again_does_not_begin_anew(walk):
    walker = walk({"break": {"text": "pause.md", "at_least_s": 30}}, BLOCK)
    walker.later(12)
    assert walker.view.payload["at_least_s"] == 18
    walker.later(100)
    assert walker.view.payload["at_least_s"] == 0


def test_time_spent_on_the_page_before_counts_for_none_after_it(walk):
    walker = walk(
        {"questionnaire": {"use": "rating"}}, {"break": {"text": "pause.md", "at_least_s": 30}}, BLOCK,
    )  # fmt: skip
    walker.later(300)
    walker.submit("rating", {"ease": 3, "dull": 2})
    assert walker.view.payload["at_least_s"] == 30


def test_a_break_takes_as_long_as_the_protocol_says(walk):
    walker = walk({"break": {"text": "pause.md", "at_least_s": 30}}, BLOCK)
    assert walker.view.payload == {"title": "pause", "text": "Words about pause.", "at_least_s": 30}
    walker.later(10)
    with pytest.raises(Refused) as no:
        walker.submit("break", {})
    assert no.value.code == "too_early"
    walker.later(20)
    walker.submit("break", {})
    assert walker.view.kind == "trial"


def test_a_pair_is_watched_again_as_often_as_allowed_and_never_by_default(walk):
    walker = walk({"block": {**BLOCK["block"], "viewing": {"replays": 1}}})
    walker.watch("block.01")
    play = walker.do(machine.watch_again, "block.01", now=walker.now)
    assert play.label == "A"
    with pytest.raises(Refused):
        walker.submit("block.01", {"choice": "a"})
    for drive in ("a", "b"):
        walker.later(30)
        play = walker.do(machine.trajectory_seen, "block.01", drive, play.playback_id, now=walker.now)
    with pytest.raises(Refused) as no:
        walker.do(machine.watch_again, "block.01", now=walker.now)
    assert no.value.code == "no_replay"
    walker.submit("block.01", {"choice": "a"})
    with walker.database.session() as s:
        assert s.scalars(select(Trial.replays).where(Trial.step_key == "block.01")).one() == 1


def test_an_early_choice_is_possible_once_b_has_begun_where_the_protocol_says_so(walk):
    walker = walk({"block": {**BLOCK["block"], "viewing": {"early_choice": True}}})
    play = walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    with pytest.raises(Refused):
        walker.submit("block.01", {"choice": "a"})
    walker.later(30)
    walker.do(machine.trajectory_seen, "block.01", "a", play.playback_id, now=walker.now)
    walker.later(1.5)
    walker.submit("block.01", {"choice": "a"})
    assert answer(walker, "block.01").decision_s == 1.5


def test_goal_and_trail_are_shown_unless_the_protocol_says_otherwise_as_chapter_7_does(walk):
    assert walk(BLOCK).view.payload["goal_and_trail"] is True
    hidden = walk({"block": {**BLOCK["block"], "viewing": {"goal_and_trail": False}}})
    assert hidden.view.payload["goal_and_trail"] is False
    interface = freeze(PROTOCOLS / "interface_study.yaml")
    shown = {step.viewing.goal_and_trail for step in preview_steps(interface) if step.kind == "trial"}
    assert shown == {False}
