"""From the last answer to the comparison: what is shown, what is blind, and what the data say when nothing is shown."""

from __future__ import annotations

from datetime import timedelta

import pytest
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.jobs.alignments.instant import InstantParams
from desirepath.jobs.leases import WorkerName, begin_attempt, say_alive
from desirepath.report.tidy_tables import read_study
from desirepath.store.models import (
    Artefact,
    Event,
    Job,
    Response,
    Session,
    Study,
    TrajectoryRow,
    Trial,
    utc_now,
)
from desirepath.store.outbox import PARTICIPANT_WAITS, Queue, queue_of
from desirepath.study.personalising.alignment_jobs import ready_job
from desirepath.study.personalising.lending import policy_key
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.studies import create_study, queries_of_study
from tests.study.walking import INSTANT, ITEMS, Walker


@pytest.fixture
def waiting(walker):
    """At the waiting step, the alignment still queued."""
    walker.walk_to("train.wait")
    return walker


CHECK = {"verdict": "as_claimed", "answers": 6, "correct": 5, "claimed": 4.2, "p_value": 0.9, "log_score": -0.4}
CHECK |= {"something_else": 0.8, "words": {"jerk": -1.0, "free_range_ahead": 0.6}}
UNSURE = {"passed": False, "probability_better": 0.62, "needed": 0.9, "scenes": 200, "something_else": 0.8}


def end_job(database, files, study, *, passed=True, comparisons=3, state="succeeded", **more):
    """What the worker writes when the alignment has ended, with stored drives standing in for the policies' own."""
    with database.transaction() as s:
        queries = queries_of_study(s, files, study)[:comparisons]
        for query in queries:
            s.get_one(TrajectoryRow, query.trajectory_a).made_by = "base-policy"
        job = s.scalars(select(Job)).one()
        job.state, job.progress = state, 1.0
        job.result = {
            "policy": "own-policy",
            "passed": passed,
            "comparisons": [
                {"base": q.trajectory_a, "own": q.trajectory_b, "look_alike": k == 1} for k, q in enumerate(queries)
            ],
            **more,
        }


def settle(walker):
    return walker.do(lambda s, session: machine.settle(s, walker.files, session, now=walker.now))


def state(database, walker):
    with database.session() as s:
        return s.get_one(Session, walker.session.id)


def test_nobody_goes_on_before_the_job_has_ended(waiting):
    assert not settle(waiting)
    assert waiting.view.key == "train.wait"
    assert waiting.view.payload == {"learns_from": "answers"}  # nothing that unblinds
    with pytest.raises(Refused) as no:
        waiting.submit("train.wait", {})
    assert no.value.code == "still_waiting"


def test_three_blind_pairs_then_a_guess_about_the_last_then_the_code(database, files, study, waiting):
    end_job(database, files, study)
    assert settle(waiting)
    assert not settle(waiting)
    with database.session() as s:
        trials = list(s.scalars(select(Trial).where(Trial.kind == "comparison").order_by(Trial.index)))
    assert [trial.arms["look_alike"] for trial in trials] == [False, True, False]
    for trial in trials:
        own = trial.arms["own"]
        assert trial.arms[own] == "own-policy"
        assert trial.arms["ab".replace(own, "")] == "base-policy"
    for number in (1, 2, 3):
        view = waiting.view
        assert view.key == f"comparison.{number}"
        told = str(view.payload) + str(view.as_dict())
        assert not any(word in told for word in ("own-", "base", "policy", "arms", trials[number - 1].trajectory_a))
        waiting.watch(view.key)
        waiting.submit(view.key, {"choice": "b"})
    own = trials[2].arms["own"]
    waiting.submit("comparison.guess", {"choice": own})
    with database.session() as s:
        guess = s.scalars(select(Response).where(Response.kind == "guess")).one()
    assert guess.value == {"choice": own, "about": "comparison.3", "right": True}
    assert waiting.view.kind == "meet_your_robot"
    waiting.submit("meet_your_robot", {"agreement": 4, "weights": waiting.view.payload["start"]})
    assert waiting.view.kind == "debriefing"
    chosen = sum(trial.arms["own"] == "b" for trial in trials)
    assert waiting.view.payload["about"] == {
        "outcome": "shown",
        "learns_from": "answers",
        "answers": 3,
        "compared": [{"against": "base", "own": chosen, "pairs": 3}],
        "guessed": True,
    }
    ended = state(database, waiting)
    assert (ended.state, ended.personalisation) == ("completed", "shown")
    assert len(ended.completion_code) == 8
    assert waiting.view.payload["completion_code"] == ended.completion_code


def test_fewer_pairs_than_planned_are_shown_and_the_guess_is_about_the_last_of_them(database, files, study, waiting):
    end_job(database, files, study, comparisons=2)
    settle(waiting)
    waiting.walk_to("comparison.guess")
    waiting.submit("comparison.guess", {"choice": "a"})
    with database.session() as s:
        assert s.scalars(select(Response).where(Response.kind == "guess")).one().value["about"] == "comparison.2"


@pytest.mark.parametrize(
    ("job", "outcome"),
    [
        ({"passed": False}, "gate_not_passed"),
        ({"passed": False, "gate": {"passed": False}, "personal": UNSURE}, "gate_not_passed"),
        ({"passed": False, "why": "not_surely_better", "personal": UNSURE}, "not_surely_better"),
        ({"comparisons": 0}, "no_scenes"),
        ({"state": "failed"}, "job_failed"),
        ({"state": "cancelled"}, "job_failed"),
    ],
)
def test_without_a_policy_to_show_the_session_ends_kindly_and_says_why(database, files, study, waiting, job, outcome):
    end_job(database, files, study, **job)
    settle(waiting)
    assert waiting.view.kind == "debriefing"
    ended = state(database, waiting)
    assert (ended.state, ended.personalisation) == ("completed", outcome)
    assert waiting.view.payload["about"]["outcome"] == outcome  # and they are told so
    with database.session() as s:
        event = s.scalars(select(Event).where(Event.kind == "personalisation")).one()
        data, _ = read_study(s, files, s.get_one(Study, study.id))
    assert event.data["outcome"] == outcome
    assert [one.own_policy for one in data.people] == [outcome]  # what the report counts


def test_whether_answers_look_like_what_is_believed_is_kept_with_the_session(database, files, study, waiting):
    end_job(database, files, study, check=CHECK, personal=UNSURE | {"passed": True, "probability_better": 0.95})
    settle(waiting)
    kept = state(database, waiting).predictive_check
    assert (kept["verdict"], kept["something_else"], kept["personal"]["probability_better"]) == (
        "as_claimed", 0.8, 0.95,
    )  # fmt: skip


def test_a_job_that_is_late_is_waited_for_only_so_long(database, walker):
    walker.now = utc_now()
    walker.walk_to("train.interface_items")
    walker.later(600)  # a slow reader: the wait only begins after the questionnaire
    walker.submit("train.interface_items", dict.fromkeys(ITEMS, 4))
    assert walker.view.key == "train.wait"
    walker.later(119)
    assert not settle(walker)
    walker.later(2)
    assert settle(walker)
    assert state(database, walker).personalisation == "late"


def test_bots_are_more_patient_than_people(database, files, study):
    bot = Walker(database, files, study, simulated=True)
    bot.walk_to("train.wait")
    bot.later(500)
    assert not settle(bot)


def test_a_job_that_has_ended_during_the_questionnaire_leaves_nothing_to_wait_for(database, files, study, walker):
    walker.walk_to("train.interface_items")
    end_job(database, files, study)
    walker.submit("train.interface_items", dict.fromkeys(ITEMS, 4))
    assert walker.view.key == "comparison.1"


def test_too_few_usable_answers_train_nothing(database, files, twenty_queries):
    text = INSTANT.replace("count: 15", "count: 1").replace("study_room/queries_varied_200", str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text), name="Small", created_by=None)
    walker = Walker(database, files, study)
    walker.walk_to("train.interface_items")
    walker.submit("train.interface_items", dict.fromkeys(ITEMS, 4))
    ended = state(database, walker)
    assert (ended.state, ended.personalisation) == ("completed", "too_few_answers")
    with database.session() as s:
        assert s.scalars(select(Job)).first() is None


def test_expected_outcomes_never_come_before_the_clock(waiting):
    waiting.now -= timedelta(seconds=30)  # a clock that was set back
    assert not settle(waiting)


# ---- how long somebody waits ---


def alive(database, trainings=1):
    with database.transaction() as s:
        say_alive(s, WorkerName("here-0", "here"), trainings)


def told(walker):
    return walker.do(lambda s, session: machine.waiting(s, session, now=walker.now)).as_news()


def test_who_waits_is_told_their_place_and_how_long_and_it_moves(database, files, study, waiting):
    waiting.now = utc_now()
    assert told(waiting) | {"at_most": 0} == {
        "progress": 0.0, "before": 0, "running": False, "seconds": None, "at_most": 0, "done": False,
    }, "no worker lives, so nobody knows how long"  # fmt: skip
    alive(database)
    second = Walker(database, files, study)
    second.walk_to("train.wait")
    assert (told(waiting)["before"], told(waiting)["seconds"]) == (0, 90)
    assert (told(second)["before"], told(second)["seconds"]) == (1, 180)
    with database.transaction() as s:
        first = s.scalars(select(Job).where(Job.session_id == waiting.session.id)).one()
        begin_attempt(s, first, WorkerName("here-0", "here"))
        first.state, first.progress = "running", 0.5
    assert told(waiting)["running"]
    assert told(waiting)["seconds"] < 90, "half of it is done"
    before = told(second)
    second.later(30)
    assert told(second)["progress"] > before["progress"]
    assert told(second)["at_most"] < before["at_most"] <= 120
    with database.transaction() as s:
        s.get_one(Job, first.id).state = "succeeded"
    assert told(second)["before"] == 0


# ---- an instant policy with a refinement behind it -------------------------------------------------------------------


@pytest.fixture
def instant(database, files):
    """At the waiting step of a study whose recipe is instant, both alignments queued."""
    with database.session() as s:
        study = s.scalars(select(Study).where(Study.name == "Instant")).one()
    walker = Walker(database, files, study)
    walker.walk_to("train.wait")
    return walker


def end(walker, recipe, *, state="succeeded", passed=True, comparisons=3, **more):
    """What the worker writes when the alignment of that recipe has ended."""
    with walker.database.transaction() as s:
        study = s.get_one(Study, walker.session.study_id)
        pairs = [
            {"base": q.trajectory_a, "own": q.trajectory_b, "look_alike": False}
            for q in queries_of_study(s, walker.files, study)[:comparisons]
        ]
        job = next(job for job in s.scalars(select(Job)) if job.params["recipe"] == recipe)
        job.state, job.progress = state, 1.0
        job.result = {"policy": f"{recipe}-policy", "passed": passed, "comparisons": pairs if passed else []} | more
        if "personal" in more and not passed:
            job.result["why"] = "not_surely_better"


def own_policies(walker):
    with walker.database.session() as s:
        trials = s.scalars(select(Trial).where(Trial.kind == "comparison", Trial.session_id == walker.session.id))
        return {trial.arms[trial.arms["own"]] for trial in trials}


def test_the_last_answer_starts_an_instant_policy_and_a_refinement(database, instant):
    with database.session() as s:
        jobs = {job.params["recipe"]: job for job in s.scalars(select(Job))}
    assert set(jobs) == {"instant", "conditioning_search"}
    assert jobs["instant"].params["snapshot"] == jobs["conditioning_search"].params["snapshot"]


def test_nobody_waits_for_the_refinement(instant):
    assert not settle(instant)
    end(instant, "instant")
    assert settle(instant)
    assert own_policies(instant) == {"instant-policy"}


def states_of_jobs(walker):
    with walker.database.session() as s:
        return {job.params["recipe"]: (job.state, job.message) for job in s.scalars(select(Job))}


@pytest.mark.parametrize("verdict", ["shown", "refused"])
def test_a_refinement_ends_with_what_it_was_for(instant, verdict):
    """Else it holds the one training process while others wait, for somebody who may have left."""
    end(instant, "instant", **({} if verdict == "shown" else {"passed": False, "personal": UNSURE}))
    assert settle(instant)
    said = "cancelled by study: nobody waits for it any more"
    assert states_of_jobs(instant)["conditioning_search"] == ("cancelled", said)


def test_a_training_that_came_too_late_for_everybody_goes_on_for_nobody(database, walker):
    walker.walk_to("train.wait")
    walker.later(600)
    assert settle(walker)
    assert state(database, walker).personalisation == "late"
    with database.session() as s:
        assert {job.state for job in s.scalars(select(Job))} == {"cancelled"}


def test_what_nobody_waits_for_stands_behind_what_somebody_does(database, files, study, instant):
    bot = Walker(database, files, study, simulated=True)
    bot.walk_to("train.wait")
    with database.session() as s:
        jobs = list(s.scalars(select(Job)))
    queues = {(job.session_id == bot.session.id, job.params["recipe"]): queue_of(job) for job in jobs}
    assert queues == {
        (False, "instant"): Queue.INSTANT,
        (False, "conditioning_search"): Queue.BEHIND,
        (True, "fine_tuning"): Queue.BEHIND,
    }


def test_no_bot_waits_behind_the_refinement_of_another(database, files, instant):
    with database.session() as s:
        study = s.get_one(Study, instant.session.study_id)
    bot = Walker(database, files, study, simulated=True)
    bot.walk_to("train.wait")
    with database.session() as s:
        jobs = s.scalars(select(Job).where(Job.session_id == bot.session.id))
        priorities = {job.params["recipe"]: job.priority for job in jobs}
    assert PARTICIPANT_WAITS < priorities["instant"] < priorities["conditioning_search"]


def test_a_refinement_that_is_there_and_better_is_shown(instant):
    end(instant, "instant")
    end(instant, "conditioning_search")
    assert settle(instant)
    assert own_policies(instant) == {"conditioning_search-policy"}


def test_what_was_compared_stays_theirs_whatever_ends_behind_it(database, instant):
    end(instant, "instant")
    assert settle(instant)
    end(instant, "conditioning_search")
    with database.session() as s:
        theirs = ready_job(s, s.get_one(Session, instant.session.id))
        assert theirs.params["recipe"] == "instant"


def test_a_refinement_that_is_no_better_is_not_shown(instant):
    end(instant, "instant")
    end(instant, "conditioning_search", passed=False)
    assert settle(instant)
    assert own_policies(instant) == {"instant-policy"}


def test_a_refinement_stands_in_for_an_instant_policy_that_failed(database, instant):
    end(instant, "instant", state="failed")
    assert not settle(instant), "the refinement may still come"
    end(instant, "conditioning_search")
    assert settle(instant)
    assert own_policies(instant) == {"conditioning_search-policy"}
    assert state(database, instant).personalisation == "shown"


def test_who_is_not_surely_served_better_waits_no_longer(database, instant):
    """The search goes on from the same answers: nobody waits for it behind a bar that stands full."""
    end(instant, "instant", passed=False, personal=UNSURE)
    assert settle(instant)
    assert state(database, instant).personalisation == "not_surely_better"
    assert (instant.view.key, instant.view.payload["about"]["outcome"]) == ("debriefing", "not_surely_better")


def test_the_verdict_that_is_kept_is_of_the_policy_that_is_shown(database, instant):
    sure = UNSURE | {"passed": True, "probability_better": 0.97}
    end(instant, "conditioning_search", passed=False, personal=UNSURE, check=CHECK)
    end(instant, "instant", personal=sure, check=CHECK)
    assert settle(instant)
    assert state(database, instant).predictive_check["personal"] == sure


def test_when_both_fail_the_data_say_so(database, instant):
    end(instant, "conditioning_search", state="failed")
    end(instant, "instant", passed=False)
    assert settle(instant)
    assert state(database, instant).personalisation == "gate_not_passed"


def test_leaving_cancels_both(database, instant):
    instant.do(machine.withdraw, now=instant.now)
    with database.session() as s:
        assert {job.state for job in s.scalars(select(Job))} == {"cancelled"}


def yoked_study(database, files, twenty_queries):
    text = INSTANT.replace("study_room/queries_varied_200", str(twenty_queries))
    text = text.replace("choose: information", "choose: random").replace("count: 15", "count: 3")
    text = text.replace("arms: [base, own], scenes: 3", "arms: [base, own, other], scenes: 2")
    with database.transaction() as s:
        return create_study(s, files, freeze_text(text), name="Yoked", created_by=None)


def end_alignments(database, files, study, walker, policy, *, yoked):
    """End the walker's jobs; stored drives stand in for the policies' own. Returns the first job's parameters."""
    with database.transaction() as s:
        if s.get(Artefact, policy) is None:
            s.add(Artefact(id=policy, kind="policy", name=policy, setup="study_room", card={}))
        queries = queries_of_study(s, files, study)[:4]
        pairs = [{"own": q.trajectory_b, "look_alike": False} for q in queries]
        for query in queries[2:]:
            s.get_one(TrajectoryRow, query.trajectory_a).made_by = "first-policy"
        jobs = list(s.scalars(select(Job).where(Job.session_id == walker.session.id)))
        for job in jobs:
            job.state, job.progress, job.finished_at = "succeeded", 1.0, utc_now()
            job.result = {
                "policy": policy,
                "passed": True,
                "comparisons": [p | {"base": q.trajectory_a} for p, q in zip(pairs[:2], queries[:2], strict=True)],
                "yoked": [p | {"other": q.trajectory_a} for p, q in zip(pairs[2:], queries[2:], strict=True)],
            }
            if not yoked:
                job.result = job.result | {"yoked": []}
        return jobs[0].params


def test_a_third_arm_is_the_policy_of_whoever_was_ready_before(database, files, twenty_queries):
    study = yoked_study(database, files, twenty_queries)
    first, second = Walker(database, files, study), Walker(database, files, study)
    first.walk_to("train.wait")
    assert end_alignments(database, files, study, first, "first-policy", yoked=False)["other"] is None
    assert settle(first)
    with database.session() as s:
        kinds = list(
            s.scalars(select(Trial.arms).where(Trial.session_id == first.session.id, Trial.kind == "comparison"))
        )
    assert len(kinds) == 2  # nobody was there before, so there is nothing to compare with but the base policy
    assert not any("other" in arms for arms in kinds)
    second.walk_to("train.wait")
    assert end_alignments(database, files, study, second, "second-policy", yoked=True)["other"] == "first-policy"
    assert settle(second)
    with database.session() as s:
        trials = list(s.scalars(select(Trial).where(Trial.session_id == second.session.id, Trial.kind == "comparison")))
        plan = s.get_one(Session, second.session.id).plan
    yoked = [trial for trial in trials if "other" in trial.arms]
    assert (len(trials), len(yoked)) == (4, 2)
    for trial in yoked:
        assert trial.arms[trial.arms["other"]] == "first-policy"
        assert trial.arms[trial.arms["own"]] == "second-policy"
        assert next(step for step in plan if step["key"] == trial.step_key)["against"] == "other"
    assert {step["of"] for step in plan if step["kind"] == "comparison"} == {4}


def test_who_withdrew_lends_no_policy(database, files, twenty_queries):
    study = yoked_study(database, files, twenty_queries)
    first, second = Walker(database, files, study), Walker(database, files, study)
    first.walk_to("train.wait")
    end_alignments(database, files, study, first, "first-policy", yoked=False)
    first.do(machine.withdraw, now=first.now)
    second.walk_to("train.wait")
    assert end_alignments(database, files, study, second, "second-policy", yoked=False)["other"] is None


def test_a_pilots_policy_is_lent_to_nobody_after_it(database, files, twenty_queries):
    study = yoked_study(database, files, twenty_queries)
    lent = {}
    for pilot in (True, False):
        with database.transaction() as s:
            s.get_one(Study, study.id).pilot = True
        first = Walker(database, files, study)
        first.walk_to("train.wait")
        end_alignments(database, files, study, first, f"policy-{pilot}", yoked=False)
        with database.transaction() as s:
            s.get_one(Study, study.id).pilot = pilot
        second = Walker(database, files, study)
        second.walk_to("train.wait")
        lent[pilot] = end_alignments(database, files, study, second, f"own-{pilot}", yoked=False)["other"]
    assert lent == {True: "policy-True", False: None}


# ---- who is lent whose policy ----


def lending_study(database, files, twenty_queries, arms="[base, neutral, own, other], stand_ins: true, scenes: 1"):
    text = INSTANT.replace("study_room/queries_varied_200", str(twenty_queries))
    text = text.replace("choose: information", "choose: random").replace("count: 15", "count: 3")
    text = text.replace("arms: [base, own], scenes: 3", f"arms: {arms}")
    with database.transaction() as s:
        return create_study(s, files, freeze_text(text), name="Lending", created_by=None)


def asked_of(walker):
    """What the walker's alignment was asked to compare with."""
    with walker.database.session() as s:
        jobs = s.scalars(select(Job).where(Job.session_id == walker.session.id, Job.kind == "align"))
        (told,) = {(job.params["other"], job.params.get("stand_in")) for job in jobs}
    return told


def has_ready(walker, policy, weights=None):
    """The walker's policy is ready: an instant one conditioned on these weights."""
    with walker.database.transaction() as s:
        config = {"recipe": "instant", "preference_weights": weights} if weights else {}
        s.add(Artefact(id=policy, kind="policy", name=policy, setup="study_room", card={"config": config}))
        for job in s.scalars(select(Job).where(Job.session_id == walker.session.id)):
            job.state, job.finished_at = "succeeded", utc_now()
            job.result = {"policy": policy, "passed": True, "comparisons": [{}], "yoked": []}


def waiting_walkers(database, files, study, count):
    walkers = [Walker(database, files, study) for _ in range(count)]
    for walker in walkers:
        walker.walk_to("train.wait")
    return walkers


def test_people_who_finish_together_are_lent_different_policies(database, files, twenty_queries):
    study = lending_study(database, files, twenty_queries, "[base, own, other], scenes: 1")
    first = waiting_walkers(database, files, study, 2)
    assert {asked_of(one) for one in first} == {(None, None)}  # nobody's is ready, and there are no stand-ins
    for number, walker in enumerate(first):
        has_ready(walker, f"policy-{number}", {"farther": 1.0 - number / 2})
    second = waiting_walkers(database, files, study, 2)
    assert sorted(asked_of(one) for one in second) == [("policy-0", None), ("policy-1", None)]
    third = waiting_walkers(database, files, study, 3)
    counted = [other for other, _ in map(asked_of, [*second, *third])]
    assert {counted.count(policy) for policy in ("policy-0", "policy-1")} == {2, 3}  # again whose was lent least


def test_the_first_group_is_lent_stand_ins_each_another_one(database, files, twenty_queries):
    study = lending_study(database, files, twenty_queries)
    first = waiting_walkers(database, files, study, 3)
    assert [asked_of(one) for one in first] == [(None, 0), (None, 1), (None, 2)]
    has_ready(first[0], "policy-0", {"farther": 1.0})
    later = waiting_walkers(database, files, study, 2)
    assert [asked_of(one) for one in later] == [("policy-0", None), (None, 3)]


def test_policies_that_drive_alike_count_as_one(database, files, twenty_queries):
    study = lending_study(database, files, twenty_queries)
    first = waiting_walkers(database, files, study, 2)
    for number, walker in enumerate(first):
        has_ready(walker, f"policy-{number}", {"farther": 1.0})
    later = waiting_walkers(database, files, study, 2)
    assert asked_of(later[0])[0] in ("policy-0", "policy-1")
    assert asked_of(later[1]) == (None, 2)  # the other one would be the same policy again
    with database.session() as s:
        assert policy_key(s, "policy-0") == policy_key(s, "policy-1") != policy_key(s, "unknown")


def test_neutral_and_stand_in_are_arms_that_the_report_tells_apart(database, files, twenty_queries):
    study = lending_study(database, files, twenty_queries)
    (walker,) = waiting_walkers(database, files, study, 1)
    with database.transaction() as s:
        queries = queries_of_study(s, files, study)[:3]
        s.get_one(TrajectoryRow, queries[1].trajectory_a).made_by = "conditioned"
        s.get_one(TrajectoryRow, queries[2].trajectory_a).made_by = "study_room/stand_ins/0"
        pairs = [{"own": q.trajectory_b, "look_alike": False} for q in queries]
        rivals = [q.trajectory_a for q in queries]
        for job in s.scalars(select(Job).where(Job.session_id == walker.session.id)):
            assert job.params["neutral"] == 1
            assert InstantParams.model_validate({**job.params, "recipe": "instant"}).stand_in == 0
            job.state = "succeeded"
            job.result = {
                "policy": "own-policy",
                "passed": True,
                "comparisons": [pairs[0] | {"base": rivals[0]}],
                "neutral": [pairs[1] | {"neutral": rivals[1]}],
                "yoked": [pairs[2] | {"other": rivals[2]}],
            }
    settle(walker)
    walker.walk_to("comparison.guess")
    with database.session() as s:
        data, _ = read_study(s, files, study)
    compared = {next(arm for arm in (one.chosen, one.rejected) if arm != "own"): one for one in data.comparisons}
    assert set(compared) == {"base", "neutral", "other"}
    assert {against: (one.opponent, one.stand_in) for against, one in compared.items()} == {
        "base": (None, False),
        "neutral": ("conditioned", False),
        "other": ("study_room/stand_ins/0", True),
    }


@pytest.mark.parametrize(
    ("comparison", "recipe", "field", "told"),
    [
        ("arms: [base, neutral, own], scenes: 3", "fine_tuning", "arms", "needs recipe instant"),
        ("arms: [base, own, other], stand_ins: true, scenes: 3", "thesis", "stand_ins", "needs recipe instant"),
        ("arms: [base, own], stand_ins: true, scenes: 3", "instant", "stand_ins", "add other to the arms"),
        ("arms: [own, base], scenes: 3", "instant", "arms", "some of the others of"),
        ("arms: [dwa, own], scenes: 3", "instant", "arms", "own with some of base, neutral, population and other"),
    ],
)
def test_arms_that_there_cannot_be_are_refused(comparison, recipe, field, told):
    text = INSTANT.replace("arms: [base, own], scenes: 3", comparison)
    text = text.replace("recipe: instant", f"recipe: {recipe}")
    with pytest.raises(ProtocolError) as refused:
        freeze_text(text)
    assert any(field in problem.field and told in problem.message for problem in refused.value.problems)
