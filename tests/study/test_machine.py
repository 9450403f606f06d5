"""A session from its first page to its last: order, clock, interruptions, and everything that is refused."""

from __future__ import annotations

import hashlib
import threading
from datetime import timedelta

import pytest
from sqlalchemy import func, select
from sqlalchemy.exc import DatabaseError

from desirepath.store.models import Artefact, Event, Job, Participant, ProblemReport, Response, Session, Trial, utc_now
from desirepath.store.snapshots import load_snapshot
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from tests.study.walking import Walker

CONSENT = {"given": True, "version": "2026-11"}


def events(database, session_id, kind):
    with database.session() as s:
        return list(s.scalars(select(Event).where(Event.session_id == session_id, Event.kind == kind)))


def refused(database, session_id):
    return [event.data["code"] for event in events(database, session_id, "refused")]


@pytest.fixture
def at_trial(walker):
    """At the first trial, nothing started."""
    walker.walk_to("block.01")
    return walker


def start(walker):
    return walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)


def become_human(s, session):
    session.simulated = False


def seen(walker, drive, playback):
    return walker.do(machine.trajectory_seen, "block.01", drive, playback, now=walker.now)


# ---- the way through -------------------------------------------------------------------------------------------------


def test_fifteen_answers_start_one_alignment_in_the_same_transaction(database, files, full_study):
    walker = Walker(database, files, full_study)
    walker.walk_to("block.16")
    with database.session() as s:
        assert s.scalar(select(func.count(Job.id))) == 0
    walker.walk_to("train.interface_items")
    with database.session() as s:
        job = s.scalars(select(Job)).one()
        snapshot = load_snapshot(s, files, job.params["snapshot"])
        trials = list(s.scalars(select(Trial).order_by(Trial.index)))
    assert job.kind == "align"
    assert job.session_id == walker.session.id
    assert job.priority == 1
    assert len(snapshot.answers) == 15  # the practice trial never counts
    assert snapshot.left_out["learning"] == 1
    assert [trial.role for trial in trials] == ["practice"] + ["regular"] * 15
    assert all(trial.a_seen_at < trial.b_seen_at for trial in trials)


def test_an_answer_keeps_how_long_the_decision_took(database, at_trial):
    at_trial.watch("block.01")
    at_trial.later(3.5)
    at_trial.submit("block.01", {"choice": "b"})
    with database.session() as s:
        response = s.scalars(select(Response).where(Response.step_key == "block.01")).one()
    assert response.decision_s == pytest.approx(3.5)
    assert response.value == {"choice": "b"}
    assert response.kind == "preference"


def test_the_consent_given_names_the_very_text_that_was_shown(database, study, walker):
    walker.walk_to("demographics")
    with database.session() as s:
        consent = s.scalars(select(Response).where(Response.kind == "consent")).one()
    shown = study.files["texts/consent.en.md"]
    assert consent.value == {**CONSENT, "text_hash": hashlib.sha256(shown.encode()).hexdigest()}


# ---- the server's clock ----------------------------------------------------------------------------------------------


def test_a_choice_before_both_drives_were_seen_is_refused_and_logged(database, at_trial):
    with pytest.raises(Refused) as no:
        at_trial.submit("block.01", {"choice": "a"})
    assert no.value.code == "too_early"
    play = start(at_trial)
    at_trial.later(60)
    seen(at_trial, "a", play.playback_id)
    with pytest.raises(Refused):
        at_trial.submit("block.01", {"choice": "a"})
    assert refused(database, at_trial.session.id) == ["too_early", "too_early"]
    with database.session() as s:
        assert s.scalar(select(func.count(Response.id)).where(Response.step_key == "block.01")) == 0


def test_a_drive_cannot_have_been_seen_before_label_and_drive_have_passed(database, at_trial):
    play = start(at_trial)
    needed = 2.0 + at_trial.view.trial["duration_a_s"]
    at_trial.later(needed - 0.5)
    with pytest.raises(Refused) as no:
        seen(at_trial, "a", play.playback_id)
    assert no.value.code == "too_early"
    assert no.value.details["needed_s"] == pytest.approx(needed, abs=0.01)
    at_trial.later(0.3)  # now within the tolerance of 0.3 s
    assert seen(at_trial, "a", play.playback_id).label == "B"


def test_only_a_simulated_session_may_be_faster(database, files, study):
    bot = Walker(database, files, study, simulated=True)
    bot.walk_to("block.01")
    play = start(bot)
    play = seen(bot, "a", play.playback_id)
    seen(bot, "b", play.playback_id)
    bot.submit("block.01", {"choice": "a"})
    assert bot.view.key == "block.02"
    with pytest.raises(DatabaseError, match="simulated"):
        bot.do(become_human)


def test_another_showings_news_is_refused(database, at_trial):
    old = start(at_trial)
    at_trial.do(machine.interrupt, reason="connection", now=at_trial.now)
    new = start(at_trial)
    assert old.playback_id != new.playback_id
    at_trial.later(60)
    with pytest.raises(Refused) as no:
        seen(at_trial, "a", old.playback_id)
    assert no.value.code == "other_playback"
    with pytest.raises(Refused):
        seen(at_trial, "b", new.playback_id)
    assert refused(database, at_trial.session.id) == ["other_playback", "not_playing"]


# ---- once is once ----------------------------------------------------------------------------------------------------


def test_a_double_click_and_a_replayed_request_count_once(database, at_trial):
    at_trial.watch("block.01")
    first = at_trial.submit("block.01", {"choice": "a"}, request_id="request-1")
    again = at_trial.submit("block.01", {"choice": "a"}, request_id="request-1")
    assert (first.duplicate, again.duplicate) == (False, True)
    assert first.response_id == again.response_id
    with pytest.raises(Refused) as no:
        at_trial.submit("block.01", {"choice": "b"}, request_id="request-2")
    assert no.value.code == "already_answered"
    assert at_trial.view.key == "block.02"
    assert len(events(database, at_trial.session.id, "duplicate_request")) == 1
    with database.session() as s:
        assert s.scalar(select(func.count(Response.id)).where(Response.step_key == "block.01")) == 1


def test_a_double_start_plays_once_and_news_told_twice_changes_nothing(at_trial):
    play = start(at_trial)
    assert start(at_trial) is None
    at_trial.later(60)
    assert seen(at_trial, "a", play.playback_id).label == "B"
    assert seen(at_trial, "a", play.playback_id) is None
    assert at_trial.view.trial["phase"] == "playing_b"


def test_two_clicks_at_the_same_moment_store_one_answer(database, at_trial):
    at_trial.watch("block.01")
    outcomes: list[str] = []

    def click(request_id: str) -> None:
        try:
            at_trial.submit("block.01", {"choice": "a"}, request_id=request_id)
            outcomes.append("accepted")
        except Refused as no:
            outcomes.append(no.code)

    clicks = [threading.Thread(target=click, args=(f"click-number-{n}",)) for n in range(4)]
    for one in clicks:
        one.start()
    for one in clicks:
        one.join()
    assert sorted(outcomes) == ["accepted", "already_answered", "already_answered", "already_answered"]


def test_a_request_id_of_another_session_is_refused(database, files, study, walker):
    other = Walker(database, files, study)
    walker.submit("information", {}, request_id="the-same-id")
    with pytest.raises(Refused) as no:
        other.submit("information", {}, request_id="the-same-id")
    assert no.value.code == "request_id_used"
    assert refused(database, other.session.id) == ["request_id_used"]


# ---- interruptions ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", ["a", "b"])
def test_an_interrupted_trial_starts_over_as_often_as_it_happens(database, at_trial, drive):
    for times in (1, 2):
        play = start(at_trial)
        assert play.label == "A"
        if drive == "b":
            at_trial.later(60)
            seen(at_trial, "a", play.playback_id)
        assert at_trial.do(machine.interrupt, reason="reload", now=at_trial.now)
        assert at_trial.view.trial["phase"] == "ready"
        assert at_trial.view.trial["restarts"] == times
    told = events(database, at_trial.session.id, "trial_interrupted")
    assert [event.data["phase"] for event in told] == [f"playing_{drive}"] * 2
    at_trial.watch("block.01")
    at_trial.submit("block.01", {"choice": "a"})


def test_a_hidden_tab_repeats_only_the_drive_that_was_hidden(at_trial):
    play = start(at_trial)
    at_trial.later(60)
    seen(at_trial, "a", play.playback_id)
    at_trial.do(machine.restart_trajectory, reason="hidden", now=at_trial.now)
    assert at_trial.view.trial["next_side"] == "b"
    play = start(at_trial)
    assert play.label == "B"
    at_trial.later(60)
    seen(at_trial, "b", play.playback_id)
    assert at_trial.view.trial["phase"] == "choosing"


def test_a_reload_while_choosing_is_no_second_look(at_trial):
    at_trial.watch("block.01")
    for reason in ("reload", "unseen"):
        assert not at_trial.do(machine.interrupt, reason=reason, now=at_trial.now)
    assert at_trial.view.trial["phase"] == "choosing"


def test_a_pause_starts_the_trial_over_and_stops_everything_else(database, at_trial):
    start(at_trial)
    at_trial.do(machine.pause, now=at_trial.now)
    assert at_trial.view.kind == "paused"
    with pytest.raises(Refused) as no:
        start(at_trial)
    assert no.value.code == "paused"
    at_trial.later(3600 * 24)
    at_trial.do(machine.resume, now=at_trial.now)
    assert at_trial.view.trial["phase"] == "ready"


# ---- what is no answer -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "value", "field"),
    [
        ("consent", {"given": False, "version": "2026-11"}, "value.given"),
        ("consent", {"given": True, "version": "2020-01"}, "value.version"),
        ("demographics", {}, "value.gender"),
        ("demographics", {"gender": "woman", "vision": "normal", "vr_experience": 8}, "value.vr_experience"),
        ("demographics", {"gender": "woman", "vision": "sharp"}, "value.vision"),
        ("demographics", {"shoe_size": 44}, "value.shoe_size"),
        ("demographics", {"age": "old"}, "value.age"),
    ],
)
def test_a_value_that_is_no_answer_is_refused_by_its_field(database, walker, step, value, field):
    walker.walk_to(step)
    with pytest.raises(Refused) as no:
        walker.submit(step, value)
    assert no.value.status == 422
    assert no.value.field == field
    assert walker.view.key == step
    assert refused(database, walker.session.id) == ["bad_value"]


def test_an_optional_item_may_stay_empty(walker):
    walker.walk_to("demographics")
    walker.submit(
        "demographics", {"gender": "not_said", "vision": "normal", "vr_experience": 1, "robotics_experience": 7}
    )
    assert walker.view.key == "instruction"


def test_steps_cannot_be_skipped_or_made_up(database, walker):
    for key, code in (("demographics", "not_current_step"), ("block.99", "unknown_step")):
        with pytest.raises(Refused) as no:
            walker.submit(key, {})
        assert no.value.code == code
    assert refused(database, walker.session.id) == ["not_current_step", "unknown_step"]


# ---- links -----------------------------------------------------------------------------------------------------------


def test_a_forged_link_is_refused_and_logged_without_the_token(database, walker):
    with pytest.raises(Refused) as no, acting(database, "forged-token", request="answer", now=utc_now()):
        pass
    assert no.value.code == "unknown"
    with database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "refused")).one()
    assert event.data["code"] == "unknown"
    assert "forged-token" not in str(event.data)


def test_an_expired_link_is_refused_and_the_session_marked(database, walker):
    walker.now = walker.session.expires_at + timedelta(seconds=1)
    for _ in range(2):
        with pytest.raises(Refused) as no:
            walker.submit("information", {})
        assert no.value.code == "expired"
    with database.session() as s:
        assert s.get_one(Session, walker.session.id).state == "expired"
    assert len(events(database, walker.session.id, "session_expired")) == 1


# ---- leaving and telling ---------------------------------------------------------------------------------------------


def test_who_withdraws_counts_nowhere_and_their_training_stops(database, walker):
    walker.walk_to("train.interface_items")
    walker.do(machine.withdraw, now=walker.now)
    assert walker.view.kind == "withdrawn"
    with pytest.raises(Refused) as no:
        walker.submit("train.interface_items", {})
    assert no.value.code == "withdrawn"
    with database.session() as s:
        assert s.scalars(select(Participant)).one().withdrawn_at is not None
        assert s.scalars(select(Job)).one().state == "cancelled"
        assert s.scalars(select(Artefact).where(Artefact.kind == "snapshot")).one().quarantined_at is not None


def test_a_problem_report_is_kept_and_an_empty_one_refused(database, walker):
    walker.do(machine.report_problem, "The picture is black.")
    with pytest.raises(Refused):
        walker.do(machine.report_problem, "   ")
    with database.session() as s:
        assert s.scalars(select(ProblemReport)).one().text == "The picture is black."
