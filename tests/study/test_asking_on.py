"""Where the gate says no, the study asks further pairs as far as its protocol allows, says so, and judges again."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.report.tidy_tables import read_study
from desirepath.store.models import Event, Job, Response, Session, Study, TrajectoryRow, Trial
from desirepath.store.snapshots import load_snapshot
from desirepath.study.personalising import next_query
from desirepath.study.protocol.outline import estimate_minutes
from desirepath.study.session import machine
from desirepath.study.studies import queries_of_study
from tests.study.small_protocol import small_protocol

ASKED = {"block": {"view": "top_down", "trials": [{"queries": {"count": 3}}]}}
COMPARISON = {"comparison": {"scenes": 2, "guess": False}}
NOT_SURE = {"passed": False, "probability_better": 0.7, "needed": 0.9, "scenes": 200, "something_else": 0.5}


def training(**more: object) -> dict:
    return {"train": {"recipe": "fine_tuning", "ask_on": {"at_most": 5, "each": 3}, **more}}


@pytest.fixture
def walker(walk):
    found = walk(ASKED, training(), COMPARISON)
    answer_until(found, "train.wait")
    return found


def answer_until(walker, key: str) -> None:
    while (view := walker.view).key != key:
        if view.kind in ("trial", "comparison"):
            walker.watch(view.key)
            walker.later(1.0)  # to think
        walker.submit(view.key, {"choice": "ab"[view.index % 2]} if view.kind in ("trial", "comparison") else {})


def end_job(walker, *, sure: bool) -> Job:
    """What the worker writes for the newest job."""
    with walker.database.transaction() as s:
        study = s.get_one(Study, s.get_one(Session, walker.session.id).study_id)
        queries = queries_of_study(s, walker.files, study)[:2]
        job = s.scalars(select(Job).where(Job.state == "queued").order_by(Job.created_at.desc())).first()
        assert job is not None
        compared = [{"base": q.trajectory_a, "own": q.trajectory_b, "look_alike": False} for q in queries]
        job.state, job.progress = "succeeded", 1.0
        job.result = {"policy": f"own-{job.id}", "passed": sure, "why": "passed" if sure else "not_surely_better"}
        job.result |= {"personal": NOT_SURE | {"passed": sure}, "comparisons": compared if sure else []}
        for query in queries:
            s.get_one(TrajectoryRow, query.trajectory_a).made_by = "base-policy"
    return job


def settle(walker) -> object:
    return walker.do(lambda s, session: machine.settle(s, walker.files, session, now=walker.now))


def rows(walker, table, *conditions):
    with walker.database.session() as s:
        return list(s.scalars(select(table).where(table.session_id == walker.session.id, *conditions)))


def test_what_is_not_surely_better_is_asked_on_and_judged_again(walker):
    assert walker.view.payload == {"learns_from": "answers", "may_ask_on": True}
    total = walker.view.total
    end_job(walker, sure=False)
    assert settle(walker)
    view = walker.view
    assert (view.key, view.payload) == ("train.more_1", {"pairs": 3, "at_most": 5, "first": True})
    assert view.total == total + 4, "the page and its three pairs are ahead, and nothing that may not come"
    answer_until(walker, "train.wait_2")
    first, second = rows(walker, Job)
    assert first.params["snapshot"] != second.params["snapshot"]
    with walker.database.session() as s:
        assert len(load_snapshot(s, walker.files, second.params["snapshot"]).training_answers()) == 6
    assert not settle(walker), "what three answers taught does not end the wait for what six will"
    end_job(walker, sure=True)
    settle(walker)
    assert walker.view.key == "comparison.1"
    assert rows(walker, Trial, Trial.kind == "comparison")[0].arms["own"] in "ab"
    answer_until(walker, "debriefing")
    with walker.database.session() as s:
        session = s.get_one(Session, walker.session.id)
    assert (session.state, session.personalisation) == ("completed", "shown")
    assert len(rows(walker, Job)) == 2, "passing over the pairs that were not needed begins nothing"
    assert [event.data["round"] for event in rows(walker, Event, Event.kind == "asked_on")] == [1]


def test_never_more_than_the_protocol_says_and_then_nothing_is_compared(walker):
    assert not walker.view.further
    left = []
    for wait in ("train.wait_2", "train.wait_3"):
        end_job(walker, sure=False)
        settle(walker)
        assert walker.view.further, "what is left is told as a maximum"
        left.append(walker.view.minutes_left)
        last = walker.view.payload
        answer_until(walker, wait)
        left.append(walker.view.minutes_left)
    assert (left, len(set(left))) == (sorted(left, reverse=True), 3), "it falls, and rises in no round after the first"
    assert last == {"pairs": 2, "at_most": 2, "first": False}
    assert walker.view.payload == {"learns_from": "answers"}, "nothing more may be asked"
    end_job(walker, sure=False)
    settle(walker)
    assert walker.view.kind == "debriefing"
    assert walker.view.payload["about"]["outcome"] == "not_surely_better"
    further = rows(walker, Trial, Trial.role == "further")
    assert len(further) == 5
    assert len({trial.query_id for trial in rows(walker, Trial)}) == 8, "no pair is asked twice"


def test_who_is_surely_better_served_is_asked_nothing_more(walker):
    end_job(walker, sure=True)
    settle(walker)
    assert walker.view.key == "comparison.1"
    answer_until(walker, "debriefing")
    assert rows(walker, Trial, Trial.role == "further") == []
    assert len(rows(walker, Job)) == 1


def test_other_reasons_are_no_reason_to_ask_on(walker):
    with walker.database.transaction() as s:
        s.scalars(select(Job)).one().state = "failed"
    settle(walker)
    assert walker.view.kind == "debriefing"


def test_further_answers_teach_are_marked_and_are_not_analysed(walker):
    end_job(walker, sure=False)
    settle(walker)
    answer_until(walker, "train.wait_2")
    with walker.database.session() as s:
        session = s.get_one(Session, walker.session.id)
        assert len(next_query.answers_of(s, session)) == 6
        data, _ = read_study(s, walker.files, s.get_one(Study, session.study_id))
    assert [one.role for one in data.choices] == ["regular"] * 3
    assert [one.further for one in data.people] == [3]
    assert {one.condition for one in data.choices} == {"block"}
    chosen = rows(walker, Event, Event.kind == "query_chosen")
    assert [(event.data["by"], event.data["answers"]) for event in chosen] == [
        ("information_beyond", 3), ("information_beyond", 4), ("information_beyond", 5),
    ]  # fmt: skip
    assert len(rows(walker, Response, Response.kind == "asking_on")) == 1


def test_a_search_for_fewer_answers_is_given_up_when_more_were_asked(walk):
    walker = walk(ASKED, training(recipe="instant"), COMPARISON)
    answer_until(walker, "train.wait")
    with walker.database.transaction() as s:
        instant, _search = s.scalars(select(Job).order_by(Job.created_at)).all()
        instant.state = "succeeded"
        instant.result = {"policy": "own", "passed": False, "why": "not_surely_better", "personal": NOT_SURE}
    settle(walker)
    answer_until(walker, "train.wait_2")
    states = {(job.params["recipe"], job.state) for job in rows(walker, Job)}
    assert states == {
        ("instant", "succeeded"), ("conditioning_search", "cancelled"),
        ("instant", "queued"), ("conditioning_search", "queued"),
    }  # fmt: skip


def test_the_plan_its_queries_and_its_minutes_are_of_all_that_may_be_asked(tmp_path, twenty_queries):
    stages = [ASKED, {"train": {}}, COMPARISON]
    without = small_protocol(tmp_path, stages, query_set=str(twenty_queries)).protocol
    with_more = small_protocol(tmp_path, [ASKED, training(), COMPARISON], query_set=str(twenty_queries)).protocol
    assert with_more.needs.queries == without.needs.queries + 5
    usual, most = estimate_minutes(with_more)
    assert (usual, usual) == estimate_minutes(without)
    assert most > usual + 2
    assert with_more.told_minutes == f"15–{15 + round(most - usual)}"


@pytest.mark.parametrize(
    ("stages", "why"),
    [
        ([ASKED, training()], "needs a comparison stage"),
        ([ASKED, training(ask_on={"at_most": 0}), COMPARISON], "must be at least 1"),
    ],
)
def test_a_protocol_that_asks_on_for_nothing_is_refused(tmp_path, twenty_queries, stages, why):
    with pytest.raises(ProtocolError, match=why):
        small_protocol(tmp_path, stages, query_set=str(twenty_queries))
