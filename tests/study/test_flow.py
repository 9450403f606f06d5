"""The rest of what a protocol may ask for, through the real state machine: checks, skips, limits, appointments."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from backend.store.models import Event, Participant, Response, Session, Study, Trial
from backend.study import machine
from backend.study.appointments import end_of
from backend.study.links import next_token, token_hash
from backend.study.protocol import ProtocolError
from backend.study.refusals import Refused
from backend.study.sessions import acting
from backend.study.studies import create_study
from tests.study.small_protocol import BLOCK, CROSSED, VIEWS, small_protocol
from tests.study.walking import Walker

CONSENT = {"given": True, "version": "1"}
QUIZ = {"comprehension": {"use": "quiz", "attempts": 2, "text": "instruction.md"}}
ABOUT = {"questionnaire": {"use": "about"}}
RATING = {"questionnaire": {"use": "rating"}}


@pytest.fixture
def walk(tmp_path, database, files, twenty_queries):
    """Opens a study with these stages and joins it; the walker stands after the consent."""

    def opened(*stages, consent=CONSENT, **keys) -> Walker:
        frozen = small_protocol(tmp_path, list(stages), query_set=str(twenty_queries), **keys)
        with database.transaction() as s:
            study = create_study(s, files, frozen, name="Small", created_by=None)
        walker = Walker(database, files, study)
        walker.submit("consent", consent)
        return walker

    return opened


def row(walker, model=Session):
    with walker.database.session() as s:
        return s.scalars(select(model).where(model.id == walker.session.id)).one()


def kinds(walker):
    return [step["kind"] for step in row(walker).plan]


def answer(walker, key):
    with walker.database.session() as s:
        return s.scalars(select(Response).where(Response.step_key == key)).one()


# ---- comprehension and attention -------------------------------------------------------------------------------------


def test_who_errs_reads_again_and_may_try_once_more(walk):
    walker = walk(QUIZ, BLOCK)
    assert walker.view.payload["again"] is None
    walker.submit("comprehension.1", {"replay": "yes"})
    view = walker.view
    assert (view.kind, view.key) == ("comprehension", "comprehension.2")
    assert (view.payload["attempt"], view.payload["attempts"]) == (2, 2)
    assert "Words about instruction" in view.payload["again"]
    walker.submit("comprehension.2", {"replay": "no"})
    assert walker.view.kind == "trial"
    assert [answer(walker, f"comprehension.{n}").value["passed"] for n in (1, 2)] == [False, True]


def test_who_never_understands_leaves_kindly_with_a_code(walk):
    walker = walk(QUIZ, BLOCK, screen_out={"text": "sorry.md", "completion_code": "SORRY-1"})
    walker.submit("comprehension.1", {"replay": "yes"})
    walker.submit("comprehension.2", {"replay": "yes"})
    session = row(walker)
    assert (session.state, session.ended_because, session.completion_code) == (
        "screened_out",
        "comprehension",
        "SORRY-1",
    )
    assert (walker.view.kind, walker.view.payload["title"]) == ("screened_out", "sorry")
    with pytest.raises(Refused) as no:
        walker.submit("comprehension.2", {"replay": "no"})
    assert no.value.code == "screened_out"


def test_or_goes_on_where_the_protocol_only_marks_it(walk):
    walker = walk({"comprehension": {**QUIZ["comprehension"], "attempts": 1, "on_failure": "go_on"}}, BLOCK)
    walker.submit("comprehension.1", {"replay": "yes"})
    assert walker.view.kind == "trial"


def test_an_attention_check_is_instructed_and_its_failure_only_marked(walk):
    walker = walk({"block": {**BLOCK["block"], "attention_checks": 1}})
    while walker.view.kind == "trial":
        walker.watch(walker.view.key)
        walker.submit(walker.view.key, {"choice": "a"})
    told = walker.view.payload["instructed"]
    other = "b" if told == "a" else "a"
    walker.submit("block.attention_1", {"choice": other})
    assert answer(walker, "block.attention_1").value == {"choice": other, "instructed": told, "passed": False}
    assert answer(walker, "block.attention_1").kind == "attention"
    assert kinds(walker).count("trial") == 2


def test_an_instructed_item_of_a_questionnaire_is_marked_and_never_refused(walk):
    walker = walk({"questionnaire": {"use": "attentive"}}, BLOCK)
    walker.submit("attentive", {"told": 2})
    assert answer(walker, "attentive").value == {"told": 2, "passed": False}
    assert walker.view.key == "block.01"


# ---- skip logic, quotas, progress ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("when", "about", "met"),
    [
        ({"item": "gender", "is": "woman"}, {"age": 30, "gender": "woman"}, True),
        ({"item": "gender", "is": "woman"}, {"age": 30}, False),
        ({"item": "gender", "is_not": "woman"}, {"age": 30}, True),
        ({"item": "gender", "one_of": ["man", "other"]}, {"age": 30, "gender": "other"}, True),
        ({"item": "age", "at_least": 40}, {"age": 39}, False),
        ({"item": "age", "at_least": 30, "at_most": 39}, {"age": 39}, True),
    ],
)
def test_a_stage_is_shown_to_whom_its_condition_fits(walk, when, about, met):
    walker = walk(ABOUT, {**RATING, "when": {"questionnaire": "about", **when}}, BLOCK)
    before = walker.view
    walker.submit("about", about)
    after = walker.view
    assert after.key == ("rating" if met else "block.01")
    assert after.total - before.total == (0 if met else -1)
    assert after.index == 2


def test_items_and_screens_are_asked_after_the_answers_that_they_need(walk):
    walker = walk(ABOUT, {"questionnaire": {"use": "more"}}, {"questionnaire": {"use": "elders"}}, BLOCK)
    before = walker.view.total
    walker.submit("about", {"age": 30})
    assert walker.view.total == before - 1  # `elders` has nothing to ask of somebody of 30, and the progress knows
    blocks = walker.view.payload["blocks"]
    assert [[item["key"] for item in block["items"]] for block in blocks] == [["plays", "hours"]]
    assert blocks[0]["items"][1]["when"] == [{"item": "plays", "is": "yes"}]
    for wrong, field in (({"plays": "yes"}, "value.hours"), ({"plays": "no", "hours": 3}, "value.hours")):
        with pytest.raises(Refused) as refused:
            walker.submit("more", wrong)
        assert refused.value.field == field
    walker.submit("more", {"plays": "no"})
    assert answer(walker, "more").value == {"plays": "no"}
    assert walker.view.key == "block.01"


def test_a_later_screen_may_need_several_answers(walk):
    walker = walk(ABOUT, {"questionnaire": {"use": "more"}}, BLOCK)
    walker.submit("about", {"age": 50})
    assert [len(block["items"]) for block in walker.view.payload["blocks"]] == [2, 1]
    with pytest.raises(Refused, match="is not asked"):
        walker.submit("more", {"plays": "yes", "hours": 4, "since": 2001})
    walker.submit("more", {"plays": "yes", "hours": 5, "since": 2001})
    assert answer(walker, "more").value == {"plays": "yes", "hours": 5, "since": 2001}


def test_a_check_for_some_is_passed_over_whole_by_the_others(walk):
    walker = walk(ABOUT, {**QUIZ, "when": {"questionnaire": "about", "item": "gender", "is": "woman"}}, BLOCK)
    walker.submit("about", {"age": 30, "gender": "man"})
    assert walker.view.key == "block.01"


def test_progress_counts_only_what_this_person_meets_to_the_last_page(walk):
    walker = walk(QUIZ, {**RATING, "when": {"questionnaire": "quiz", "item": "replay", "is": "yes"}}, BLOCK)
    seen = [(walker.view.index, walker.view.total)]
    walker.submit("comprehension.1", {"replay": "no"})
    while walker.view.kind != "debriefing":
        seen.append((walker.view.index, walker.view.total))
        walker.watch(walker.view.key)
        walker.submit(walker.view.key, {"choice": "a"})
    seen.append((walker.view.index, walker.view.total))
    assert seen == [(1, 6), (2, 5), (3, 5), (4, 5)]


def test_a_full_quota_ends_the_session_and_drop_outs_give_their_place_back(walk, database, files):
    quota = {"questionnaire": "about", "item": "gender", "is": "woman", "most": 1}
    first = walk(ABOUT, BLOCK, quotas=[quota])
    first.submit("about", {"age": 30, "gender": "woman"})
    with database.session() as s:
        study = s.get_one(Study, first.session.study_id)
    second, third = (Walker(database, files, study) for _ in range(2))
    for walker in (second, third):
        walker.submit("consent", CONSENT)
    second.submit("about", {"age": 30, "gender": "woman"})
    assert row(second).ended_because == "quota"
    first.do(machine.withdraw, now=first.now)
    third.submit("about", {"age": 30, "gender": "woman"})
    assert row(third).state == "active"


# ---- limits and view rules -------------------------------------------------------------------------------------------


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
        play = walker.do(machine.drive_seen, "block.01", drive, play.playback_id, now=walker.now)
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
    walker.do(machine.drive_seen, "block.01", "a", play.playback_id, now=walker.now)
    walker.later(1.5)
    walker.submit("block.01", {"choice": "a"})
    assert answer(walker, "block.01").decision_s == 1.5


# ---- consent ---------------------------------------------------------------------------------------------------------


def test_every_answer_names_its_consent_and_purposes_are_no_unless_ticked(walk):
    words = {"training": {"en": "Learn from it?"}, "open_data": {"en": "Publish it?"}}
    consent = {"consent": {"text": "consent.md", "version": "1", "purposes": words}}
    walker = walk(ABOUT, BLOCK, consent_stage=consent, consent={**CONSENT, "purposes": {"open_data": True}})
    walker.submit("about", {"age": 30})
    agreed = answer(walker, "consent")
    assert agreed.consent_id is None
    assert agreed.value["purposes"] == {"training": False, "open_data": True}
    assert answer(walker, "about").consent_id == agreed.id
    with walker.database.session() as s:
        person = s.get_one(Participant, walker.session.participant_id)
    assert person.consents == {"training": False, "open_data": True}


def test_who_does_not_let_us_learn_is_shown_no_policy(walk):
    consent = {"consent": {"text": "consent.md", "version": "1", "purposes": {"training": {"en": "Learn?"}}}}
    train = {"train": {"job": "align"}}
    walker = walk(BLOCK, train, {"comparison": {"scenes": 1}}, consent_stage=consent)
    for key in ("block.01", "block.02"):
        walker.watch(key)
        walker.submit(key, {"choice": "a"})
    assert row(walker).personalisation == "no_consent"
    assert walker.view.kind == "debriefing"


# ---- rankings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [VIEWS[:2], [*VIEWS[:2], VIEWS[0]], [*VIEWS, "other"], "top_down", []])
def test_a_ranking_has_every_option_once(walk, given):
    walker = walk({"questionnaire": {"use": "order"}}, BLOCK)
    with pytest.raises(Refused) as no:
        walker.submit("order", {"useful": given})
    assert no.value.field == "value.useful"
    walker.submit("order", {"useful": VIEWS[::-1]})
    assert answer(walker, "order").value == {"useful": VIEWS[::-1]}


# ---- appointments ----------------------------------------------------------------------------------------------------

COME_BACK = {"appointment": {"text": "come_back.md", "after_days": 2, "within_days": 9}}


def test_a_later_appointment_has_its_own_link_and_window(walk, database, files):
    walker = walk(ABOUT, COME_BACK, BLOCK)
    walker.submit("about", {"age": 30})
    with acting(walker.database, walker.token, request="look", now=walker.now) as (s, session):
        view = machine.current(s, session)
    assert (view.kind, row(walker).state) == ("appointment", "completed")
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
    second = row(walker)
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
    assert [end_of(session) for session in sorted(mine, key=lambda one: one.appointment)] == [3, 6]


@pytest.mark.parametrize(
    ("stages", "says"),
    [
        ([BLOCK, COME_BACK], "the next appointment needs something to do"),
        (
            [ABOUT, BLOCK, COME_BACK, {**RATING, "when": {"questionnaire": "about", "item": "age", "at_least": 1}}],
            "needs one for everybody",
        ),
        ([BLOCK, COME_BACK, ABOUT, {"train": {}}], "another appointment than train"),
        ([{**RATING, "when": {"questionnaire": "about", "item": "age", "at_least": 1}}, BLOCK], "not asked before"),
        (
            [ABOUT, {**RATING, "when": {"questionnaire": "about", "item": "sex", "is": "x"}}, BLOCK],
            "is no item of about",
        ),
        ([ABOUT, {**RATING, "when": {"questionnaire": "about", "item": "gender", "is": "wman"}}, BLOCK], "mean woman"),
        ([{"questionnaire": {"use": "quiz"}}, BLOCK], "ask it as a comprehension stage"),
        ([{"comprehension": {"use": "about"}}, BLOCK], "has no item with 'correct'"),
        ([{"block": {"trials": [{"queries": {"count": 1}}]}}], "must say the view once"),
        ([{"block": {**CROSSED["block"], "each": ["top_down", "above"]}}], "'above' is no view"),
    ],
)
def test_what_does_not_fit_together_is_told(tmp_path, stages, says):
    with pytest.raises(ProtocolError, match=says):
        small_protocol(tmp_path, stages)


def test_everything_that_ends_a_session_is_in_the_log(walk, database):
    walker = walk({"comprehension": {**QUIZ["comprehension"], "attempts": 1}}, BLOCK)
    walker.submit("comprehension.1", {"replay": "yes"})
    with database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "screened_out")).one()
    assert event.data == {"outcome": "comprehension", "step": "comprehension.1"}
