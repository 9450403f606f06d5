"""Moments of a drive that are marked while it plays: stored, believed, learned from, reported, exported, erased."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.jobs.answers import preferences_of
from desirepath.jobs.context import JobContext
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.evidence.evidence import Habits
from desirepath.learning.preferences.evidence.marked_moment import MarkedMoment
from desirepath.learning.preferences.marked_steps import MOMENT_S, REACTION_S
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig
from desirepath.learning.preferences.spans import marked_parts, moments
from desirepath.report.marked_moments import describe_marks, marks_section
from desirepath.report.study_data import MarkedDrive
from desirepath.report.tidy_tables import read_study
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.marks import Mark, marks_in
from desirepath.store.models import Artefact, Participant, Response, Session, Trial
from desirepath.store.snapshots import Snapshot, TooFewAnswers, load_snapshot, take_snapshot
from desirepath.study.personalising import next_query
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import small_protocol

MARK = {"mark": {"view": "top_down", "count": 2, "good": True}}
BAD_ALONE = {"mark": {"view": "top_down", "count": 1}}


def watched(walk, stage):
    """A walker who has seen the first drive to its end."""
    walker = walk(stage)
    walker.watch("mark.01", "a")
    return walker


def test_moments_are_stored_in_the_order_of_time_with_what_was_said_of_them(walk):
    walker = watched(walk, MARK)
    walker.submit(
        "mark.01", {"marks": [{"at_s": 2.456, "why": "good"}, {"at_s": 1, "why": "too_close"}, {"at_s": 1.7}]}
    )
    with walker.database.session() as s:
        response = s.scalars(select(Response).where(Response.step_key == "mark.01")).one()
        assert s.get_one(Trial, response.trial_id).kind == "mark"
    assert response.value == {
        "marks": [{"at_s": 1.0, "why": "too_close"}, {"at_s": 1.7, "why": None}, {"at_s": 2.46, "why": "good"}]
    }


def test_no_mark_is_an_answer_too_of_which_nothing_is_believed(walk):
    walker = watched(walk, BAD_ALONE)
    walker.submit("mark.01", {"marks": []})
    with walker.database.session() as s:
        session = s.scalars(select(Session)).one()
        assert s.scalars(select(Response.value).where(Response.kind == "mark")).one() == {"marks": []}
        assert next_query.answers_of(s, session) == ()


@pytest.mark.parametrize(
    ("said", "field"),
    [
        ({}, "value.marks"),
        ({"marks": 3}, "value.marks"),
        ({"marks": [{"at_s": -0.1}]}, "value.marks.0.at_s"),
        ({"marks": [{"at_s": 1.0}, {"at_s": 599.0}]}, "value.marks.1.at_s"),
        ({"marks": [{"at_s": float("inf")}]}, "value.marks.0.at_s"),
        ({"marks": [{"at_s": True}]}, "value.marks.0.at_s"),
        ({"marks": [{"at_s": 1.0, "why": "ugly"}]}, "value.marks.0.why"),
        ({"marks": [{"at_s": 1.0, "why": "good"}]}, "value.marks.0.why"),
        ({"marks": [{"at_s": 1.0}] * 21}, "value.marks"),
    ],
)
def test_nothing_else_is_an_answer(walk, said, field):
    walker = watched(walk, BAD_ALONE)
    with pytest.raises(Refused) as refused:
        walker.submit("mark.01", said)
    assert refused.value.field == field


def test_a_drive_that_no_page_saw_starts_over_as_only_marks_do(walk):
    walker = watched(walk, BAD_ALONE)
    assert not walker.do(machine.interrupt, reason="page_loaded", now=walker.now)
    assert walker.do(machine.interrupt, reason="unseen", now=walker.now)
    assert (walker.view.trial["phase"], walker.view.trial["restarts"]) == ("ready", 1)
    walker.watch("mark.01", "a")
    walker.submit("mark.01", {"marks": [{"at_s": 1.0}]})


def test_two_taps_about_one_moment_are_too_few_answers(walk):
    walker = watched(walk, BAD_ALONE)
    walker.submit("mark.01", {"marks": [{"at_s": 2.5}, {"at_s": 2.9}]})
    with walker.database.transaction() as s, pytest.raises(TooFewAnswers) as few:
        take_snapshot(s, walker.files, session_id=walker.session.id)
    assert few.value.usable == 1


def test_who_has_not_watched_to_the_end_cannot_answer(walk):
    walker = walk(MARK)
    with pytest.raises(Refused):
        walker.submit("mark.01", {"marks": []})


@pytest.mark.parametrize(
    ("value", "marks"),
    [
        ({"marks": []}, ()),
        ({"marks": [{"at_s": 2}, {"at_s": 1.5, "why": "jerky"}]}, (Mark(1.5, "jerky"), Mark(2.0, None))),
        ({"marks": None}, None),
        ({"marks": [3]}, None),
        ({"marks": [{"at_s": True}]}, None),
        ({"marks": [{"at_s": float("nan")}]}, None),
        ({"marks": [{"at_s": 1, "why": "ugly"}]}, None),
        ({"marks": [{"at_s": 1, "why": ["good"]}]}, None),
        ({"choice": "a"}, None),
    ],
)
def test_what_was_imported_is_an_answer_only_where_it_can_be(value, marks):
    assert marks_in(value) == marks


def test_a_mark_is_about_the_two_seconds_before_it_and_the_delay_and_a_second_tap_about_them_says_no_more():
    drive = next(
        q.trajectory_a for q in load_queries("study_room/queries_500").queries if q.trajectory_a.duration_s > 7
    )
    (marked,), others = marked_parts(drive, [4.5, 4.9])
    assert np.array_equal(marked.poses, drive.poses[10:21])  # 2 to 4 s
    assert sum(len(part.actions) for part in others) + 10 == len(drive.actions)
    assert all(1.0 <= part.duration_s <= 3.0 for part in others)
    early, _ = marked_parts(drive, [0.0])
    assert early[0].duration_s == pytest.approx(1.0)
    late, _ = marked_parts(drive, [1e6])
    assert np.array_equal(late[0].poses[-1], drive.poses[-1])


def test_the_report_says_when_the_robot_was_seen_to_do_it_not_when_it_was_pressed():
    drive = load_queries("study_room/queries_500").queries[0].trajectory_a
    marks = ((0.1, "jerky"), (2.5, "detour"))
    of = describe_marks([MarkedDrive("P001", "mark", "a", marks)], lambda _: drive)
    into = {one.why: one.into.mean for one in of.reasons}
    assert into == pytest.approx({"jerky": 0.0, "detour": 2.0 / drive.duration_s})


@pytest.mark.parametrize(("worst", "objective"), [("detour", "shorter"), ("slowness", "faster")])
def test_who_marks_detours_or_slow_parts_is_believed_to_mind_those(worst, objective):
    believed = []
    for seed in range(4):
        posterior = Posterior.prior("study_room", PosteriorConfig(particles=2_000))
        queries = load_queries("study_room/queries_500").queries
        for query in np.random.default_rng(seed).permutation(len(queries))[:10]:
            drive = queries[query].trajectory_a
            parts = [part for part in moments(drive, MOMENT_S) if part.duration_s >= 1.0]
            way, nearer = np.array([_way_and_progress(part) for part in parts]).T
            lasting = np.array([part.duration_s for part in parts])
            badness = (way - nearer) / lasting if worst == "detour" else -way / lasting
            end = (int(badness.argmax()) + 1) * MOMENT_S + REACTION_S
            marks = [Mark(min(end, drive.duration_s), None)]
            for evidence in next_query.GivenMarks.of("q", "t", marks).evidence(drive):
                posterior = posterior.observed(evidence)
        believed.append(posterior.importance()[objective])
    assert np.median(believed) > 0.4, "a ninth before anything was marked"


def _way_and_progress(part):
    poses, goal = part.poses[:, :2], (part.scene.goal.x, part.scene.goal.y)
    distances = np.linalg.norm(poses - goal, axis=1)
    return np.linalg.norm(np.diff(poses, axis=0), axis=1).sum(), distances[0] - distances[-1]


def test_a_bad_moment_is_believed_of_who_thinks_least_of_it_and_a_good_one_of_who_thinks_most():
    worth = np.array([[-2.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    habits = Habits(np.zeros(2), np.zeros((2, 2)))
    bad, good = (MarkedMoment(np.zeros((3, 1, 7)), better).log_likelihood(worth, habits) for better in (False, True))
    assert bad == pytest.approx(
        np.log([np.exp(2) / (np.exp(2) + 1 + np.exp(-1)), np.exp(-2) / (np.exp(-2) + 1 + np.exp(-1))])
    )
    assert good[1] > good[0]


def test_one_posterior_data_set_and_models_have_them_and_the_report_and_nobody_after_erasure(
    database, files, tmp_path, twenty_queries
):
    stages = [
        {"mark": {"view": "top_down", "count": 8, "good": True}},
        {"block": {"view": "top_down", "trials": [{"queries": {"count": 2, "choose": "information"}}]}},
    ]
    frozen = small_protocol(tmp_path, stages, query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Marks", created_by=None)
    said = walk_in_process(database, files, study, 2, Character(oracle="min-human-distance"))
    assert (said["completed"], said["participants"]) == (2, 2)
    with database.session() as s:
        values = [r.value for r in s.scalars(select(Response).where(Response.kind == "mark"))]
        assert sum(len(value["marks"]) for value in values) >= 16
        for session in s.scalars(select(Session).where(Session.study_id == study.id)):
            posterior = next_query.posterior_of(s, files, session)
            assert {type(one) for one in posterior.evidence} == {MarkedMoment}
            assert posterior.importance()["farther"] > 0.5
        data, load = read_study(s, files, study)
    marked = describe_marks(data.marked, load)
    assert [(of.condition, of.drives) for of in marked.conditions] == [("mark", 16)]
    assert sum(of.marks for of in marked.reasons) == sum(len(value["marks"]) for value in values)
    by_reason = {of.why: of.distance_m.mean for of in marked.reasons}
    assert by_reason["too_close"] < marked.usual_m.mean < by_reason["good"]
    assert [len(table.rows) for table in marks_section(marked).tables] == [1, len(marked.reasons)]

    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "responses.csv").open() as file:
        assert [json.loads(row["value"]) for row in csv.DictReader(file) if row["kind"] == "mark"] == values

    with database.transaction() as s:
        taken = take_snapshot(s, files, study_id=study.id, whose="simulated")
        snapshot = load_snapshot(s, files, taken.id)
        whose = list(s.scalars(select(Participant.id)))
    assert taken.card["marks"] == len(snapshot.marks) == sum(len(value["marks"]) for value in values)
    assert Snapshot.from_bytes(snapshot.to_bytes()) == snapshot
    context = JobContext(None, database, files, None, None)
    every, independent = (preferences_of(context, snapshot, independent=alone) for alone in (False, True))
    assert set(every) == {"S001", "S002"}
    for person, preferences in every.items():
        parts = [one for one in preferences if one.chosen.duration_s <= 3.0]
        assert len(parts) > len([one for one in independent[person] if one.chosen.duration_s <= 3.0]) >= 5
        assert all(np.array_equal(one.chosen.scene.digest(), one.rejected.scene.digest()) for one in parts)

    erase_participant(database, files, whose[0], "experimenter")
    with database.session() as s:
        assert len(list(s.scalars(select(Response).where(Response.kind == "mark")))) == 8
        assert s.get_one(Artefact, taken.id).quarantined_at is not None
