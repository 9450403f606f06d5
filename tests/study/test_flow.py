"""Who meets what of a protocol, through the real state machine: checks, skips, quotas, consent."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.store.models import Event, Participant, Study
from desirepath.study.protocol.freezing import ProtocolError
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from tests.study.small_protocol import ABOUT, BLOCK, COME_BACK, CROSSED, QUIZ, RATING, VIEWS, small_protocol
from tests.study.walking import GIVEN, Walker, answer, session_row


def kinds(walker):
    return [step["kind"] for step in session_row(walker).plan]


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
    session = session_row(walker)
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


def test_the_time_left_falls_to_nothing(walk):
    walker = walk(QUIZ, {**RATING, "when": {"questionnaire": "quiz", "item": "replay", "is": "yes"}}, BLOCK, minutes=9)
    seen = [(walker.view.minutes_left, walker.view.done)]
    assert 5 < seen[0][0] < 9, "of the nine minutes that participants are told, the consent lies behind"
    walker.submit("comprehension.1", {"replay": "no"})
    while walker.view.kind != "debriefing":
        seen.append((walker.view.minutes_left, walker.view.done))
        walker.watch(walker.view.key)
        walker.submit(walker.view.key, {"choice": "a"})
    seen.append((walker.view.minutes_left, walker.view.done))
    assert seen == sorted(seen, key=lambda one: (-one[0], one[1]))
    assert seen[-1] == (0, 1)


def test_a_full_quota_ends_the_session_and_drop_outs_give_their_place_back(walk, database, files):
    quota = {"questionnaire": "about", "item": "gender", "is": "woman", "most": 1}
    first = walk(ABOUT, BLOCK, quotas=[quota])
    first.submit("about", {"age": 30, "gender": "woman"})
    with database.session() as s:
        study = s.get_one(Study, first.session.study_id)
    second, third = (Walker(database, files, study) for _ in range(2))
    for walker in (second, third):
        walker.submit("consent", GIVEN)
    second.submit("about", {"age": 30, "gender": "woman"})
    assert session_row(second).ended_because == "quota"
    first.do(machine.withdraw, now=first.now)
    third.submit("about", {"age": 30, "gender": "woman"})
    assert session_row(third).state == "active"


# ---- consent ---------------------------------------------------------------------------------------------------------


def test_every_answer_names_its_consent_and_purposes_are_no_unless_ticked(walk):
    words = {"training": {"en": "Learn from it?"}, "open_data": {"en": "Publish it?"}}
    consent = {"consent": {"text": "consent.md", "version": "1", "purposes": words}}
    walker = walk(ABOUT, BLOCK, consent_stage=consent, consent={**GIVEN, "purposes": {"open_data": True}})
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
    assert session_row(walker).personalisation == "no_consent"
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


# ---- what ends, and what does not fit --------------------------------------------------------------------------------


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
