"""What people may prefer among pedestrians: whose way is cut, following, waiting, in the places of the nine."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.mirroring import ACTION_SIGNS, mirror_of
from desirepath.learning.preferences.measures import measures, table_of
from desirepath.learning.preferences.objectives import (
    CROWD_NAMES,
    CROWD_OBJECTIVES,
    OBJECTIVES,
    OPPOSITES,
    best_possible,
    names_of,
    preference_weights,
    step_terms_of,
)
from desirepath.learning.preferences.oracles import CROWD_PREFERENCES, preference_of
from desirepath.simulation.fast import replay
from desirepath.simulation.pedestrians import Crowd, Pedestrian
from desirepath.simulation.scene import Person, Pose, Room, Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

CROWD_HALL = get_setup("crowd_hall")

PLACE = {measure.name: k for k, measure in enumerate(table_of("crowd_hall"))}


def hall(*walkers: tuple[tuple[float, float], tuple[float, float]], speed: float = 0.6) -> Scene:
    """A robot at the origin that looks along x to its goal 4 m away, these walkers, and one who stands in a corner."""
    routes = tuple(Pedestrian(route, speed) for route in walkers)
    person, room = Person(Pose(-4.0, 2.5)), Room(9.0, 6.0)
    start, goal = Pose(0.0, 0.0, 0.0), Pose(4.0, 0.0)
    return Scene("crowd_hall", 0, start, goal, 0.36, person, room=room, crowd=Crowd("path", routes))


def rolled(scene: Scene, speeds: list[float]) -> Trajectory:
    """Straight on at these shares of full speed."""
    actions = np.array([(2 * share - 1, 0.0) for share in speeds], dtype=np.float32)
    return replay(CROWD_HALL, [scene], [actions])[0]


def of(trajectory: Trajectory) -> dict[str, float]:
    return {name: float(measures([trajectory])[0, place]) for name, place in PLACE.items()}


def test_who_crosses_ahead_of_a_walker_cuts_in_front_and_who_lets_them_pass_crosses_behind() -> None:
    crossing = hall(((1.0, -2.2), (1.0, 2.6)))
    first, after = rolled(crossing, [1.0] * 15), rolled(crossing, [0.0] * 22 + [1.0] * 12)
    assert of(first)["ahead_of_people"] > 0.3
    assert of(after)["ahead_of_people"] < of(first)["ahead_of_people"] - 0.3
    assert of(after)["moving_beside_people"] < 0.5 < of(first)["moving_beside_people"]
    assert preference_of("cut-in-front").value([first])[0] > preference_of("cut-in-front").value([after])[0]
    assert preference_of("wait").value([first])[0] < preference_of("wait").value([after])[0]


def test_walking_after_somebody_is_following_and_meeting_them_is_not() -> None:
    ahead, towards = hall(((1.3, 0.0), (4.2, 0.0))), hall(((4.2, 0.6), (-2.0, 0.6)))
    after, meeting = rolled(ahead, [0.6] * 18), rolled(towards, [0.6] * 15)
    assert of(after)["following"] > 0.9
    assert of(after)["ahead_of_people"] < -0.9
    assert of(meeting)["following"] < 0.1
    assert preference_of("follow").value([after])[0] > preference_of("follow").value([meeting])[0]


def test_a_step_term_complains_of_what_its_objective_minds_and_of_nothing_else() -> None:
    first = rolled(hall(((1.0, -2.2), (1.0, 2.6))), [1.0] * 12)
    terms = dict(zip(CROWD_NAMES, step_terms_of(first.actions, first.next_observations, CROWD_HALL).T, strict=True))
    away, beside = -0.05, first.next_observations[:, 2] * CROWD_HALL.distance_scale_m < 1.5
    assert terms["passes_behind"][beside].max() < away < terms["cuts_in_front"][beside].min()
    assert terms["waits"].min() < -0.5
    assert terms["follows"].max() < -0.5
    assert all((term <= 0).all() and (term >= -1).all() for term in terms.values())


def test_keeping_away_from_everybody_is_neither_cutting_in_front_nor_passing_behind() -> None:
    alone = rolled(hall(((-3.0, -2.8), (-4.2, -2.8))), [1.0] * 10)
    after = rolled(hall(((1.3, 0.0), (4.2, 0.0))), [0.6] * 10)
    for name, place in (("cuts_in_front", 2), ("passes_behind", 3)):
        assert CROWD_NAMES[place] == name
        assert step_terms_of(alone.actions, alone.next_observations, CROWD_HALL)[:, place] == pytest.approx(-0.05)
    followed = step_terms_of(after.actions, after.next_observations, CROWD_HALL)
    assert followed[:, 3].min() > -0.04
    assert followed[:, 2].max() < -0.5


def test_distance_is_to_whoever_is_nearest_and_nobody_betters_the_bound() -> None:
    scene = hall(((1.5, 1.2), (-3.0, 1.2)), ((3.5, -2.0), (-3.0, -2.0)))
    trajectory = rolled(scene, [0.8] * 18)
    people = scene.people_at(trajectory.times)
    apart = np.linalg.norm(people - trajectory.poses[:, :2], axis=2).min()
    assert of(trajectory)["min_human_distance_m"] == pytest.approx(apart, abs=1e-3)
    assert best_possible([scene])[0, CROWD_NAMES.index("farther")] >= of(trajectory)["min_human_distance_m"] - 1e-6
    assert best_possible([scene])[0, 0] == pytest.approx(math.hypot(1.5, 1.2))


def test_each_stands_in_the_place_of_one_of_the_nine_so_that_everything_ordered_by_them_holds() -> None:
    assert [(one.measure, one.sign) for one in CROWD_OBJECTIVES] == [(one.measure, one.sign) for one in OBJECTIVES]
    assert {(CROWD_NAMES[a], CROWD_NAMES[b]) for a, b in OPPOSITES} == {
        ("farther", "closer"),
        ("cuts_in_front", "passes_behind"),
    }
    assert names_of("study_room")[2] == "person_on_left"
    assert preference_weights({"waits": 0.5})[CROWD_NAMES.index("waits")] == 0.5
    with pytest.raises(LearningError, match="cuts_in_front and passes_behind are opposites"):
        preference_weights({"cuts_in_front": 1.0, "passes_behind": 1.0})
    with pytest.raises(LearningError, match=r"'person_on_left' is unknown.*passes_behind"):
        preference_weights({"person_on_left": 1.0, "waits": 1.0})
    away = rolled(hall(((1.0, 2.0), (1.0, -2.0))), [1.0] * 3)
    elsewhere = replace(away, scene=replace(away.scene, setup="study_room", crowd=None))
    with pytest.raises(LearningError, match="'passes_behind'; in study_room there are farther"):
        preference_of("pass-behind").value([elsewhere])
    assert all(one.weights is not None for one in CROWD_PREFERENCES.values())


def test_a_mirrored_world_is_observed_as_the_mirror_says() -> None:
    scene = hall(((1.5, 1.2), (-3.0, 1.0)), ((3.5, -2.0), (-3.0, 0.5)))
    flipped = Crowd(
        "path", tuple(replace(p, route=tuple((x, -y) for x, y in p.route)) for p in scene.crowd.pedestrians)
    )
    other = replace(scene, crowd=flipped, person=Person(Pose(-4.0, -2.5)))
    actions = np.array([(0.2, 0.3), (0.5, -0.1), (0.4, 0.2)], dtype=np.float32)
    one = replay(CROWD_HALL, [scene], [actions])[0]
    two = replay(CROWD_HALL, [other], [actions * ACTION_SIGNS])[0]
    order, signs = mirror_of(CROWD_HALL)
    polar = CROWD_HALL.polar_size
    mirrored = one.next_observations[:, order] * signs
    assert mirrored[:, :polar] == pytest.approx(two.next_observations[:, :polar], abs=1e-5)
    assert np.abs(mirrored[:, polar:] - two.next_observations[:, polar:]).mean() < 0.02  # noise, one beam beside
