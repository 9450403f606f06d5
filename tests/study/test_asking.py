"""Queries that follow the answers: what is asked, what is repeated, and when it ends."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Event, Job, Response, Session, Study, TrajectoryRow, Trial
from desirepath.study.personalising import next_query
from desirepath.study.protocol.freezing import ProtocolError, freeze_text
from desirepath.study.studies import create_study
from tests.study.walking import QUICK, VALUES, Walker

PLAIN = "queries: {count: 15, choose: information}"
NEVER = "stop: {below_bits: 0.000001}"
AT_ONCE = "stop: {below_bits: 1.0, in_a_row: 1, at_least: 3}"


@pytest.fixture
def make_walker(database, files, twenty_queries):
    def make(queries: str, symmetry: str = "none") -> Walker:
        text = QUICK.read_text().replace("study_room/queries_varied_200", str(twenty_queries)).replace(PLAIN, queries)
        text = text.replace("\nquery_set:", f"\nsymmetry: {symmetry}\nquery_set:")
        with database.transaction() as s:
            study = create_study(s, files, freeze_text(text), name=queries[:40], created_by=None)
        return Walker(database, files, study)

    return make


def answer_all(walker, taste):
    """Answer every query with the side that `taste` likes more; stops at the questionnaire."""
    while (view := walker.view).key != "train.interface_items":
        if view.kind == "trial":
            walker.watch(view.key)
            with walker.database.session() as s:
                trial = s.scalars(
                    select(Trial).where(Trial.session_id == walker.session.id, Trial.step_key == view.key)
                ).one()
                worth = [taste(s.get_one(TrajectoryRow, t)) for t in (trial.trajectory_a, trial.trajectory_b)]
            walker.submit(view.key, {"choice": "a" if worth[0] > worth[1] else "b"})
        else:
            walker.submit(view.key, VALUES[view.key])


def shortest_time(row):
    return -row.duration_s


def trials_of(walker):
    with walker.database.session() as s:
        return list(s.scalars(select(Trial).where(Trial.session_id == walker.session.id).order_by(Trial.index)))


def events_of(walker, kind):
    with walker.database.session() as s:
        return list(s.scalars(select(Event).where(Event.session_id == walker.session.id, Event.kind == kind)))


def test_chosen_queries_are_all_different_and_the_log_says_why(make_walker):
    walker = make_walker("queries: {count: 6, choose: information}")
    answer_all(walker, shortest_time)
    trials = trials_of(walker)
    assert [trial.role for trial in trials] == ["practice"] + ["regular"] * 6
    assert len({trial.query_id for trial in trials}) == 7
    chosen = events_of(walker, "query_chosen")
    assert [event.data["answers"] for event in chosen] == [0, 1, 2, 3, 4, 5]
    assert [event.data["of"] for event in chosen] == [19, 18, 17, 16, 15, 14]
    assert all(event.data["by"] == "information" and event.data["bits"] > 0 for event in chosen)
    assert {event.trial_id for event in chosen} == {trial.id for trial in trials[1:]}


def test_queries_may_be_chosen_for_what_the_nine_objectives_do_not_say(database, files, make_walker):
    walker = make_walker("queries: {count: 4, choose: information_beyond, stop: {below_bits: 0.000001, at_least: 3}}")
    answer_all(walker, shortest_time)
    chosen = events_of(walker, "query_chosen")
    assert [(event.data["by"], event.data["answers"]) for event in chosen] == [
        ("information_beyond", n) for n in range(4)
    ]
    assert all(0 < event.data["bits"] <= 1 for event in chosen)
    with database.session() as s:
        session = s.get_one(Session, walker.session.id)
        study = s.get_one(Study, session.study_id)
        memory = next_query.recall(files)
        measured, pairs = memory.measure_queries(s, files, study), memory.pairs(s, files, study)
        posterior = memory.beyond(measured, pairs, next_query.answers_of(s, session))
    assert len(posterior.chosen) == 4
    assert posterior.something_else() > 0


def test_what_is_asked_follows_the_answers(make_walker):
    walkers = [make_walker("queries: {count: 6, choose: information}") for _ in range(2)]
    tastes = (shortest_time, lambda row: row.duration_s)
    for walker, taste in zip(walkers, tastes, strict=True):
        with walker.database.transaction() as s:  # the same lots for both, so that only the answers differ
            session = s.get_one(Session, walker.session.id)
            session.plan = walkers[0].session.plan
            session.seed = walkers[0].session.seed
        answer_all(walker, taste)
    asked = [[trial.query_id for trial in trials_of(walker)] for walker in walkers]
    assert asked[0][:2] == asked[1][:2], "before any answer counts, both are asked the same"
    assert asked[0] != asked[1]


def test_the_posterior_after_the_answers_is_of_these_answers(database, files, make_walker):
    walker = make_walker("queries: {count: 10, choose: information}")
    answer_all(walker, shortest_time)
    with database.session() as s:
        session = s.get_one(Session, walker.session.id)
        posterior = next_query.posterior_of(s, files, session)
        given = next_query.answers_of(s, session)
    assert len(posterior.chosen) == len(given) == 10
    assert posterior.importance()["faster"] + posterior.importance()["shorter"] > 0.4
    assert posterior.importance()["faster"] > 1 / 9


def test_where_left_and_right_are_alike_nobody_wants_a_side(database, files, make_walker):
    walker = make_walker("queries: {count: 4, choose: information}", symmetry="left_right")
    answer_all(walker, shortest_time)
    with database.session() as s:
        importance = next_query.posterior_of(s, files, s.get_one(Session, walker.session.id)).importance()
        jobs = s.scalars(select(Job).where(Job.session_id == walker.session.id)).all()
    assert importance["person_on_left"] == importance["person_on_right"] == 0
    assert {job.params["symmetry"] for job in jobs} == {"left_right"}


def test_probes_repeat_what_was_asked(make_walker):
    walker = make_walker("queries: {count: 5, choose: disagreement, probes: {repeat: 1, swap: 1}}")
    answer_all(walker, shortest_time)
    trials = trials_of(walker)
    probes = {trial.role: trial for trial in trials[-2:]}
    assert set(probes) == {"repeat", "swap"}
    first = {trial.query_id: trial for trial in trials if trial.role == "regular"}
    for role, probe in probes.items():
        sides = (first[probe.query_id].trajectory_a, first[probe.query_id].trajectory_b)
        assert (probe.trajectory_a, probe.trajectory_b) == (sides if role == "repeat" else sides[::-1])


def test_the_stopping_rule_ends_the_queries_and_the_training_starts(make_walker):
    walker = make_walker(f"queries: {{count: 15, choose: information, {AT_ONCE}, probes: {{repeat: 15}}}}")
    answer_all(walker, shortest_time)
    trials = trials_of(walker)
    assert [trial.role for trial in trials] == ["practice"] + ["regular"] * 3 + ["repeat"] * 3
    assert len(events_of(walker, "queries_ended")) == 1
    recipes = [event.data["recipe"] for event in events_of(walker, "training_started")]
    assert recipes == ["each_scene", "each_scene_trained"], "there at once, and what may be better behind it"
    with walker.database.session() as s:
        stored = s.scalars(select(Response).where(Response.session_id == walker.session.id)).all()
    assert sum(response.trial_id is not None for response in stored) == 7


def test_a_rule_that_is_not_met_ends_nothing(make_walker):
    walker = make_walker(f"queries: {{count: 12, choose: information, {NEVER}}}")
    answer_all(walker, shortest_time)
    assert len(trials_of(walker)) == 13
    assert not events_of(walker, "queries_ended")


def test_studies_measure_their_queries_once(database, files, make_walker):
    walker = make_walker("queries: {count: 3, choose: information}")
    with database.session() as s:
        study = s.get_one(Study, walker.session.study_id)
        memory = next_query.recall(files)
        measured = memory.measure_queries(s, files, study)
        assert memory.measure_queries(s, files, study) is measured
        assert next_query.recall(ArtefactStore(files.url)) is not memory
    assert measured.differences.shape == (20, 3, 7)
    assert len(measured.queries) == 20


@pytest.mark.parametrize(
    ("queries", "field", "message"),
    [
        ("queries: {count: 15, stop: {in_a_row: 2}}", "stop", "needs queries that are chosen"),
        ("queries: {count: 15, role: practice, choose: information}", "choose", "must be random for practice"),
        ("queries: {count: 5, choose: information, stop: {at_least: 9}}", "at_least", "more than the 5 queries"),
        (
            "queries: {count: 5, choose: wisely}",
            "choose",
            "must be one of disagreement, information, ",
        ),
    ],
)
def test_what_cannot_be_chosen_is_refused(queries, field, message):
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(QUICK.read_text().replace(PLAIN, queries))
    told = next(error for error in wrong.value.errors if error["field"].endswith(field))
    assert message in told["message"]


def test_blocks_that_must_ask_the_same_cannot_choose():
    block = "  - block:\n      view: immersive\n      trials: [{queries: {count: 15}}]\n"
    text = QUICK.read_text().replace(PLAIN, "queries: {count: 15, choose: information}")
    with pytest.raises(ProtocolError, match="blocks show the same queries"):
        freeze_text(text.replace("  # In each scene", block + "  # In each scene"))
