"""A real robot's drive as a step: waited for, asked about afterwards, and walked by programs in the simulation."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.store.models import Response, RobotRun, StudyRobot
from desirepath.study import robots
from desirepath.study.refusals import Refused
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, small_protocol
from tests.study.walking import answer

LEARNED = {"robot_drive": {"start": "learned", "goal": [2.0, 1.0], "question": {"en": "Here it comes"}}}


def run_of(walker):
    with walker.database.session() as s:
        return s.scalars(select(RobotRun).where(RobotRun.session_id == walker.session.id)).one()


def test_somebody_waits_for_the_robot_and_is_asked_when_it_has_driven(walk):
    walker = walk(BLOCK, LEARNED)
    walker.walk_to("robot_drive")
    run, start = run_of(walker), walker.view.payload["start"]
    assert (run.state, run.goal, run.weights, run.answers, run.robot_id) == ("waiting", [2.0, 1.0], start, 2, None)
    assert start, "as learned"
    assert walker.view.payload["question"] == "Here it comes"
    assert walker.view.trial["phase"] == "waiting"
    with pytest.raises(Refused, match="not over yet"):
        walker.submit("robot_drive", {"weights": start, "liked": 4})
    with walker.database.transaction() as s:
        robot, _ = robots.admit_robot(s, run.study_id, "Turtle", "experimenter")
        mine = s.get_one(RobotRun, run.id)
        with pytest.raises(Refused, match="Choose the robot"):
            robots.start_run(s, mine, "experimenter", walker.now)
        robots.give_to(s, mine, robot)
        robots.start_run(s, mine, "experimenter", walker.now)
        robots.note_moved(mine, walker.later(2.5))
        robots.end_run(s, mine, walker.later(9.0), {"driven_s": 9.0, "way_m": 2.2, "reached": True, "stops": []})
    with pytest.raises(Refused, match="from 1 to 7"):
        walker.submit("robot_drive", {"weights": start})
    with pytest.raises(Refused) as wrong:
        walker.submit("robot_drive", {"weights": start, "liked": 8})
    assert wrong.value.field == "value.liked"
    walker.submit("robot_drive", {"weights": start, "liked": 6})
    value = answer(walker, "robot_drive").value
    assert (value["liked"], value["reached"], value["way_m"], value["simulated"]) == (6, True, 2.2, False)
    assert (value["learned_from"], value["wheels_after_s"]) == (2, 2.5)


def test_who_was_let_go_on_without_a_drive_is_not_asked_how_it_was(walk):
    walker = walk(BLOCK, LEARNED)
    walker.walk_to("robot_drive")
    with walker.database.transaction() as s:
        robots.end_run(s, s.get_one(RobotRun, run_of(walker).id), walker.now, None)
    assert walker.view.trial["drove"] is False
    walker.submit("robot_drive", {"weights": walker.view.payload["start"]})
    value = answer(walker, "robot_drive").value
    assert (value["liked"], value["driven_s"], value["recording"]) == (None, None, None)


def test_one_robot_that_is_free_stands_ready_and_a_busy_one_does_not(walk, files):
    first = walk(BLOCK, LEARNED)
    with first.database.transaction() as s:
        robot, _ = robots.admit_robot(s, first.session.study_id, "Turtle", "experimenter")
    first.walk_to("robot_drive")
    assert run_of(first).robot_id == robot.id
    with first.database.session() as s:
        orders = robots.orders_of(s, s.get_one(StudyRobot, robot.id))
    assert (orders["run"], orders["drive"], orders["goal"]) == (run_of(first).id, False, [2.0, 1.0])
    second = walk(BLOCK, LEARNED)
    second.walk_to("robot_drive")
    run = run_of(second)
    with second.database.transaction() as s, pytest.raises(Refused, match="no such robot"):
        robots.give_to(s, s.get_one(RobotRun, run.id), s.get_one(StudyRobot, robot.id))


def test_programs_walk_it_in_the_simulation_and_it_says_so(tmp_path, database, files, twenty_queries):
    frozen = small_protocol(tmp_path, [BLOCK, LEARNED], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Bots", created_by=None)
    assert walk_in_process(database, files, study, 1, Character("min-human-distance"))["completed"] == 1
    with database.session() as s:
        value = s.scalars(select(Response).where(Response.kind == "robot_drive")).one().value
        run = s.scalars(select(RobotRun)).one()
    assert (value["simulated"], run.simulated, run.robot_id) == (True, True, None)
    assert value["driven_s"] > 3
    assert value["recording"] is None


def test_what_no_robot_can_be_sent_to_is_refused_in_the_protocol(tmp_path):
    with pytest.raises(ProtocolError, match="goal"):
        small_protocol(tmp_path, [BLOCK, {"robot_drive": {"goal": [200.0, 0.0]}}])
    with pytest.raises(ProtocolError, match="needs a block or rating before it"):
        small_protocol(tmp_path, [{"robot_drive": {"start": "learned"}}, BLOCK])
