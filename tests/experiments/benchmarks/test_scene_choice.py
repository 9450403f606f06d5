"""A choice per scene, as it is measured: what a robot with it would drive, the base policy where nothing is known, the
best by the true score."""

import numpy as np
import pytest

from desirepath.learning.alignment.each_scene import KEPT, choose_each_scene
from desirepath.learning.people.card import member
from desirepath.learning.policies.choosing import Answers
from desirepath.learning.preferences.oracles import ResponseModel
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.people_room import PeopleRoom, QueryPool, RobotOfLibrary
from desirepath_experiments.benchmarks.people_ways import BASE, WaysConfig, choose, driven, go_each_scene, measure_gain


@pytest.fixture(scope="module")
def room() -> PeopleRoom:
    robot = RobotOfLibrary.load("open_field")
    pool = QueryPool.load("open_field/queries_varied_200", robot.basis)
    return PeopleRoom.open(3, robot, pool, test=10, scenes=8)


def _expecting_more_distance(room: PeopleRoom, answers: int) -> Answers:
    """Of somebody who chose, again and again, whichever kept further from the person."""
    further = room.pool.pairs.seen[:, 0, 0] > 0
    return room.pool.answers(range(answers), further[:answers].tolist())


def test_what_is_measured_is_what_a_robot_with_that_choice_drives(room: PeopleRoom) -> None:
    answers = _expecting_more_distance(room, 15)
    chosen = driven(room.rollouts, choose(room, room.rollouts, answers, KEPT))
    policy = choose_each_scene(answers)
    by_robot = rollout(get_setup("open_field"), policy.rollout_policy, room.scenes)
    for measured, drives in zip(chosen, by_robot, strict=True):
        np.testing.assert_allclose(measured.poses[-1], drives.poses[-1], atol=1e-3)
        assert len(measured.poses) == len(drives.poses)
    assert any(one is not usual for one, usual in zip(chosen, room.usual, strict=True))


def test_base_policy_drives_where_nothing_is_known(room: PeopleRoom) -> None:
    nothing = choose(room, room.rollouts, _expecting_more_distance(room, 0), KEPT)
    assert (nothing == BASE).all()
    assert driven(room.rollouts, nothing) == room.usual


def test_who_gains_nothing_gains_nothing_and_nobody_chooses_better_than_who_knows_the_score(room: PeopleRoom) -> None:
    person = member("network:3", "open_field")
    ways = go_each_scene(person, _expecting_more_distance(room, 15), room, ResponseModel(), WaysConfig(compared=4))
    assert ways["best_in_each"]["gain"] >= max(ways["each_scene"]["gain"], 0.0)
    assert ways["each_scene"]["asked"] <= 4
    same = measure_gain(person, room.usual, room.usual)
    assert (same["gain"], same["changed"], same["preferred"]) == (0.0, 0.0, 0.5)
