"""Ratings: a trajectory is watched and rated on the protocol's own scale; export, report, reward models have them."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.jobs.answers import preferences_of
from desirepath.jobs.context import JobContext
from desirepath.learning.preferences.oracles import ORACLE_PREFERENCES
from desirepath.learning.rewards.held_out import accuracy
from desirepath.learning.rewards.linear import fit_linear
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import analyse
from desirepath.report.tidy_tables import read_folder, read_study
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Event, Response, Session, Trial
from desirepath.store.snapshots import (
    MOST_IMPLIED,
    RatedTrajectory,
    Snapshot,
    TooFewAnswers,
    implied_choices,
    independent_choices,
    load_snapshot,
    take_snapshot,
)
from desirepath.study.personalising import next_query
from desirepath.study.personalising.believed import find_belief
from desirepath.study.protocol.planning import example_queries, make_plan
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import small_protocol
from tests.study.walking import Walker

WORDS = {"en": "How did you like it?"}
SCALE = {"question": WORDS, "points": 5, "low": {"en": "not at all"}, "high": {"en": "very much"}}
RATING = {"rating": {"each": ["top_down", "first_person"], "count": 4, "scale": SCALE}}


def watched(walker: Walker) -> None:
    key = walker.view.key
    play = walker.do(machine.start_trial, key, request_id=None, now=walker.now)
    assert play.label == ""  # one that is shown alone has no letter
    walker.later(60)
    walker.do(machine.trajectory_seen, key, "a", play.playback_id, now=walker.now)


def test_every_trajectory_is_watched_before_it_is_rated_on_the_scale(walk):
    walker = walk(RATING)
    shown = walker.view.payload
    assert (shown["question"], shown["points"], shown["low"]) == ("How did you like it?", 5, "not at all")
    with pytest.raises(Refused) as early:
        walker.submit(walker.view.key, {"rating": 3})
    assert early.value.code == "too_early"
    watched(walker)
    with pytest.raises(Refused, match="whole number from 1 to 5"):
        walker.submit(walker.view.key, {"rating": 6})
    walker.submit(walker.view.key, {"rating": 4})
    assert walker.view.payload["number"] == 2


def test_all_conditions_rate_the_same_trajectories_that_nothing_else_shows(tmp_path):
    protocol = small_protocol(
        tmp_path, [RATING, {"block": {"view": "top_down", "trials": [{"queries": {"count": 3}}]}}]
    )
    plan = make_plan(protocol.protocol, 3, example_queries(protocol.protocol))
    rated = {
        view: {one.trajectory for one in plan if one.kind == "rating" and one.view == view}
        for view in ("top_down", "first_person")
    }
    assert rated["top_down"] == rated["first_person"]
    assert len(rated["top_down"]) == 4
    assert not rated["top_down"] & {one.trajectory_a for one in plan if one.kind == "trial"}


def test_ratings_reach_data_set_and_report_and_a_reward_model_learns_from_them(
    database, files, tmp_path, twenty_queries
):
    frozen = small_protocol(tmp_path, [RATING], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Rated", created_by=None)
    said = walk_in_process(database, files, study, 4, Character(oracle="shortest"))
    assert (said["completed"], said["participants"]) == (4, 4)
    with database.session() as s:
        given = s.execute(select(Response, Trial).join(Trial, Trial.id == Response.trial_id)).all()
        assert {response.kind for response, _ in given} == {"rating"}
        data, load = read_study(s, files, study)
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "questionnaire_items.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["item"] == "rating"]
    assert len(rows) == len(given) == 4 * 2 * 4
    assert {row["condition"] for row in rows} == {"top_down", "first_person"}
    exported, _ = read_folder(tmp_path / "out")
    assert exported.ratings == data.ratings  # one per person and condition: the mean of what they rated there
    assert len([one for one in data.ratings if one.item == "rating"]) == 4 * 2
    found = analyse(data, load, "simulated", AnalysisPlan(sessions="all"))
    assert "rating" in {one.item.key for one in found.items}

    with database.transaction() as s:
        artefact = take_snapshot(s, files, study_id=study.id, whose="simulated")
        snapshot = load_snapshot(s, files, artefact.id)
    assert len(snapshot.ratings) == len(given)
    assert Snapshot.from_bytes(snapshot.to_bytes()) == snapshot
    assert artefact.simulated
    preferences = [
        one for own in preferences_of(JobContext(None, database, files, None, None), snapshot).values() for one in own
    ]
    lengths = [ORACLE_PREFERENCES["shortest"].value([one.chosen, one.rejected]) for one in preferences]
    # rated beside what was seen so far, as people do, so not every pair is in order
    assert np.mean([better > worse for better, worse in lengths]) > 0.75
    assert accuracy(fit_linear(preferences), preferences) > 0.8


def test_ratings_are_compared_beside_a_block_that_has_no_conditions(database, files, tmp_path, twenty_queries):
    """The report of such a study said that it compares no conditions."""
    block = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2}}]}}
    frozen = small_protocol(tmp_path, [RATING, block], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Both", created_by=None)
    walk_in_process(database, files, study, 4)
    with database.session() as s:
        data, load = read_study(s, files, study)
    found = analyse(data, load, "simulated", AnalysisPlan(sessions="all"))
    assert [design.within for design in found.designs] == [{"view": ["top_down", "first_person"]}]
    assert [one.item.key for one in found.items] == ["rating"]


def test_snapshots_of_choices_alone_keep_their_bytes(full_study, database, files):
    walker = Walker(database, files, full_study)
    walker.walk_to("train.interface_items")
    with database.transaction() as s:
        snapshot = load_snapshot(s, files, take_snapshot(s, files, session_id=walker.session.id).id)
    assert "ratings" not in json.loads(snapshot.to_bytes())


def rated(person: str, trajectory: str, rating: float, view: str = "top_down") -> RatedTrajectory:
    return RatedTrajectory("r", "t", person, view, None, trajectory, rating, "human")


def test_ratings_imply_choices_of_one_person_under_one_condition_only():
    mine, other = rated("P-1", "a", 4), rated("P-1", "b", 2)
    beside = [rated("P-2", "c", 1), rated("P-1", "a", 1, "first_person"), rated("P-1", "d", 4)]
    found = implied_choices([mine, other, *beside])
    assert {(better.trajectory, worse.trajectory) for better, worse in found} == {("a", "b"), ("d", "b")}
    assert implied_choices([rated("P-1", "a", 4), rated("P-1", "a", 2)]) == []  # the same one twice
    many = [rated("P-1", f"{k}", k) for k in range(60)]
    assert len(implied_choices(many)) == MOST_IMPLIED
    assert implied_choices(many) == implied_choices(many)


def test_of_the_choices_that_ratings_imply_those_that_share_no_rating_are_independent():
    ratings = [rated("P-1", name, rating) for name, rating in (("a", 5), ("b", 1), ("c", 3), ("d", 2), ("e", 3))]
    found = [(better.trajectory, worse.trajectory) for better, worse in independent_choices(ratings)]
    assert found == [("a", "d"), ("c", "b")]
    assert len(implied_choices(ratings)) == 9
    assert independent_choices([rated("P-1", "a", 4), rated("P-1", "b", 4)]) == []


def test_whoever_rates_all_alike_teaches_nothing_and_is_told_so_at_once(walk, files):
    walker = walk(RATING)
    for _ in range(4):
        watched(walker)
        walker.submit(walker.view.key, {"rating": 4})
    with walker.database.transaction() as s, pytest.raises(TooFewAnswers):
        take_snapshot(s, files, session_id=walker.session.id)


def test_a_robot_can_learn_from_ratings_alone_in_the_same_appointment(tmp_path, twenty_queries):
    train, meet = {"train": {"give_up_after_s": 60}}, {"comparison": {"scenes": 1}}
    assert small_protocol(tmp_path, [RATING, train, meet], query_set=str(twenty_queries)).training
    with pytest.raises(ProtocolError, match="stands before any block or mark or order or rating"):
        small_protocol(tmp_path, [train, RATING, meet], query_set=str(twenty_queries))


@pytest.mark.parametrize("at_once", [True, False])
def test_ratings_count_in_the_posterior_of_the_session_where_the_protocol_says_so(
    database, files, tmp_path, twenty_queries, at_once
):
    stage = {"rating": {"view": "top_down", "count": 12, "scale": SCALE, "at_once": at_once}}
    choosing = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2, "choose": "information"}}]}}
    frozen = small_protocol(tmp_path, [stage, choosing], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name=f"Rated {at_once}", created_by=None)
    walk_in_process(database, files, study, 1, Character(oracle="shortest"))
    with database.session() as s:
        session = s.scalars(select(Session).where(Session.study_id == study.id)).one()
        posterior = next_query.posterior_of(s, files, session)
        assert find_belief(s, files, session).answers == (14 if at_once else 2)
        asked = s.scalars(select(Event.data).where(Event.session_id == session.id, Event.kind == "query_chosen"))
        assert [data["answers"] for data in asked] == ([12, 13] if at_once else [0, 1])
    assert len(posterior.chosen) == 2
    assert [answer.feedback for answer in posterior.evidence] == ["evaluative"] * 12 * at_once
    if at_once:
        assert posterior.importance()["shorter"] + posterior.importance()["faster"] > 0.5
