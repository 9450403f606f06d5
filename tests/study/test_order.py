"""Several trajectories of a scene put in order, the best picked, piles: stored, believed, learned from, exported."""

from __future__ import annotations

import contextlib
import csv
import json

import pytest
from sqlalchemy import select

from desirepath.jobs.answers import preferences_of
from desirepath.jobs.context import JobContext
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.queries.queries import QuerySet
from desirepath.report.choice_findings import describe_several
from desirepath.report.tidy_tables import read_study
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Response, Session, TrajectoryRow, Trial
from desirepath.store.sides import is_answer_to_several
from desirepath.store.snapshots import Snapshot, TooFewAnswers, implied_choices, load_snapshot, take_snapshot
from desirepath.study.personalising import next_query
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import small_protocol
from tests.study.walking import GIVEN, Walker

ORDER = {"order": {"view": "top_down", "count": 2, "of": 4}}
BEST = {"order": {"view": "top_down", "count": 2, "of": 3, "ask": "best"}}
GROUPS = {"order": {"view": "top_down", "count": 2, "of": 4, "ask": "groups", "piles": 2}}


@pytest.mark.parametrize(
    ("stage", "said"),
    [(ORDER, {"order": [3, 1, 4, 2]}), (BEST, {"order": [2]}), (GROUPS, {"groups": [[], [4, 1, 2, 3]]})],
    ids=["order", "best", "groups"],
)
def test_what_is_said_of_four_in_one_scene_is_stored(walk, stage, said):
    walker = walk(stage)
    walker.later(60)
    walker.submit("order.order_01", said)
    with walker.database.session() as s:
        response = s.scalars(select(Response).where(Response.step_key == "order.order_01")).one()
        trial = s.get_one(Trial, response.trial_id)
        scenes = set(s.scalars(select(TrajectoryRow.scene_hash).where(TrajectoryRow.id.in_(trial.shown))))
    assert response.value == said | {"ask": stage["order"].get("ask", "order")}
    assert len(set(trial.shown)) == stage["order"]["of"]
    assert len(scenes) == 1
    assert response.decision_s is not None


@pytest.mark.parametrize(
    ("stage", "said", "field"),
    [
        (ORDER, {"order": [1, 2, 3]}, "value.order"),
        (ORDER, {"order": [1, 2, 3, 3]}, "value.order"),
        (ORDER, {"order": [1, 2, 3, 5]}, "value.order"),
        (ORDER, {"groups": [[1], [2, 3, 4]]}, "value.order"),
        (BEST, {"order": [1, 2, 3]}, "value.order"),
        (GROUPS, {"groups": [[1], [2], [3, 4]]}, "value.groups"),
        (GROUPS, {"groups": [[1, 2], [2, 3, 4]]}, "value.groups"),
    ],
)
def test_nothing_else_is_an_answer(walk, stage, said, field):
    walker = walk(stage)
    walker.later(60)
    with pytest.raises(Refused) as refused:
        walker.submit("order.order_01", said)
    assert refused.value.field == field


def test_who_cannot_have_watched_all_is_asked_to(walk):
    walker = walk(ORDER)
    with pytest.raises(Refused, match="Watching all takes") as refused:
        walker.submit("order.order_01", {"order": [3, 1, 4, 2]})
    assert refused.value.code == "too_early"


@pytest.mark.parametrize("said", [{"choice": "a"}, {"rating": 3}, {"order": [[1], [2], [3], [4]], "ask": "order"}])
def test_nothing_is_learned_from_what_was_imported_as_an_order_and_is_none(walk, said):
    walker = walk(ORDER)
    with walker.database.transaction() as s:
        trial = s.scalars(select(Trial)).one()
        asked = {"session_id": trial.session_id, "trial_id": trial.id, "step_key": trial.step_key}
        s.add(Response(**asked, kind="order", value=said, request_id="imported"))
        with pytest.raises(TooFewAnswers) as refused:
            take_snapshot(s, walker.files, study_id=walker.session.study_id)
    assert refused.value.left_out == {"no_choice": 1}


def test_what_was_rolled_back_or_erased_is_there_again_for_whoever_comes_next(database, files, tmp_path):
    shipped = load_queries("study_room/queries_500")
    one_for_all = tmp_path / "one.npz"
    QuerySet(shipped.setup, shipped.queries[:1], {}).save(one_for_all)
    stage = {"order": {"view": "top_down", "count": 1, "of": 5}}
    frozen = small_protocol(tmp_path, [stage], query_set=str(one_for_all))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Orders", created_by=None)

    first = Walker(database, files, study)
    with (
        contextlib.suppress(ConnectionError),
        acting(database, first.token, request="submit", now=first.now) as (s, session),
    ):
        machine.submit(s, files, session, "consent", GIVEN, request_id="lost", client_time=first.now, now=first.now)
        raise ConnectionError
    first.submit("consent", GIVEN)
    with database.session() as s:
        shown = set(s.scalars(select(Trial)).one().shown)
        whose = s.scalars(select(Participant.id)).one()
    erase_participant(database, files, whose, "experimenter")
    with database.session() as s:
        assert not shown <= set(s.scalars(select(TrajectoryRow.id))), "some were rolled out for nobody else"

    second = Walker(database, files, study)
    second.submit("consent", GIVEN)
    second.later(60)
    second.submit("order.order_01", {"order": [5, 4, 3, 2, 1]})
    with database.session() as s:
        assert set(s.scalars(select(Trial)).one().shown) == shown
        assert shown <= set(s.scalars(select(TrajectoryRow.id)))
    assert all(files.exists(one) for one in shown)


def test_one_block_mixes_them_and_one_posterior_data_set_and_models_have_all(database, files, tmp_path, twenty_queries):
    orders = [{"count": 2, "of": 4}, {"count": 2, "of": 5, "ask": "best"}, {"count": 2, "of": 4, "ask": "groups"}]
    block = {"view": "top_down", "trials": [{"queries": {"count": 3, "choose": "information"}}], "orders": orders}
    frozen = small_protocol(tmp_path, [{"block": block}], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Orders", created_by=None)
    said = walk_in_process(database, files, study, 2, Character(oracle="shortest"))
    assert (said["completed"], said["participants"]) == (2, 2)
    with database.session() as s:
        values = [r.value for r in s.scalars(select(Response).where(Response.kind == "order"))]
        assert sorted(value["ask"] for value in values) == sorted([*["best", "groups", "order"] * 4])
        for session in s.scalars(select(Session).where(Session.study_id == study.id)):
            assert {step["kind"] for step in session.plan} >= {"trial", "order"}
            posterior = next_query.posterior_of(s, files, session)
            assert len(posterior.evidence) == 2 + 2 + 2 * 4
            assert len(posterior.chosen) == 3
            assert posterior.importance()["shorter"] + posterior.importance()["faster"] > 0.5
        shown = {one for trial in s.scalars(select(Trial).where(Trial.kind == "order")) for one in trial.shown}
        data, _ = read_study(s, files, study)
    assert len(data.choices) == 6
    told = describe_several(data.several)
    assert [(of.ask, of.of, of.answers) for of in told] == [("best", 5, 4), ("groups", 4, 4), ("order", 4, 4)]
    assert all(0 <= of.first_best.mean <= 1 for of in told if of.ask != "groups")
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "responses.csv").open() as file:
        assert [json.loads(row["value"]) for row in csv.DictReader(file) if row["kind"] == "order"] == values
    with (tmp_path / "out" / "trajectories.csv").open() as file:
        assert shown <= {row["trajectory"] for row in csv.DictReader(file)}

    with database.transaction() as s:
        taken = take_snapshot(s, files, study_id=study.id, whose="simulated")
        snapshot = load_snapshot(s, files, taken.id)
    assert {name: taken.card.get(name) for name in ("answers", "orders", "ratings")} == {
        "answers": 6,
        "orders": 12,
        "ratings": None,
    }
    assert "18 answers of 2" in taken.name
    assert Snapshot.from_bytes(snapshot.to_bytes()) == snapshot
    implied = implied_choices(snapshot.ratings)
    assert {better.block for better, _ in implied} == {worse.block for _, worse in implied}, "one scene at a time"
    preferences = [
        one for own in preferences_of(JobContext(None, database, files, None, None), snapshot).values() for one in own
    ]
    assert len(preferences) == 6 + len(implied)
    assert all(one.chosen.scene.digest() == one.rejected.scene.digest() for one in preferences)


@pytest.mark.parametrize(
    ("value", "fits"),
    [
        ({"order": [2, 1, 3], "ask": "order"}, True),
        ({"order": [2], "ask": "best"}, True),
        ({"order": [2], "ask": "order"}, False),
        ({"groups": [[1], [3, 2]], "ask": "groups"}, True),
        ({"groups": [[1], [3, 4]], "ask": "groups"}, False),
        ({"choice": "a"}, False),
        ({"order": [[1], [2], [3]], "ask": "order"}, False),
        ({"order": [True, 2, 3], "ask": "order"}, False),
        ({"order": [1.0, 2, 3], "ask": "order"}, False),
        ({"order": [2, 1, 3]}, False),
        ({"groups": 5, "ask": "groups"}, False),
        ({"groups": [1, 2, 3], "ask": "groups"}, False),
        ({"groups": None, "order": [2, 1, 3], "ask": "order"}, False),
        ({"groups": [[1], [3, 2]], "ask": "order"}, False),
    ],
)
def test_what_was_imported_is_an_answer_only_where_it_can_be(value, fits):
    assert is_answer_to_several(value, 3) is fits
