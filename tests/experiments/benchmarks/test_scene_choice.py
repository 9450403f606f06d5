"""A choice per scene: only what arrives, the base policy where nothing is surely better, the best by the true score."""

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.alignment.each_scene import scales_of
from desirepath.learning.policies.choosing import Answers
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.benchmarks.people import RobotOfLibrary, roll_out
from desirepath_experiments.benchmarks.people_policies import _shown_directly
from desirepath_experiments.benchmarks.scene_choice import BASE, SceneCandidates


@pytest.fixture(scope="module")
def some() -> SceneCandidates:
    robot = RobotOfLibrary.load("open_field")
    rows = np.flatnonzero(robot.library.allowed[: len(robot.library.settings)])[:3]
    library = replace(
        robot.library,
        settings=robot.library.settings[rows],
        mixes=robot.library.mixes[:0],
        measures=robot.library.measures[rows],
    )
    robot = replace(robot, library=library)
    scenes = scene_set("open_field", 8, purpose=Purpose.ALIGN_SELECT, seed=3)
    own = [roll_out(robot.policy(place), scenes) for place in range(len(library))]
    return SceneCandidates.of(robot, roll_out(robot.base, scenes), own, False)


def _expecting_more_distance(some: SceneCandidates, answers: int) -> Answers:
    """Of somebody who chose, again and again, whichever kept further from the person."""
    pairs = some.differences.pairs
    further = pairs.seen[:, 0, 0] > 0
    which = np.resize(np.arange(len(further)), answers)
    return Answers(pairs[which], some.differences.steps[which], further[which])


def _places(some: SceneCandidates, answers: int) -> np.ndarray:
    known = _expecting_more_distance(some, answers)
    return some.places(known, scales_of(some.robot.library, known), 3)


def _nearest_m(trajectory: Trajectory) -> float:
    person = trajectory.scene.person.pose
    return float(np.hypot(trajectory.poses[:, 0] - person.x, trajectory.poses[:, 1] - person.y).min())


def test_base_policy_drives_where_too_little_is_known(some: SceneCandidates) -> None:
    places = _places(some, 0)
    assert (places == BASE).all()
    assert some.driven(places) == some.usual


def test_chosen_and_best_arrive_and_nobody_chooses_better_than_who_knows_the_score(some: SceneCandidates) -> None:
    shapes = [len(some.trajectories), len(some.usual)]
    nearest = np.array([[_nearest_m(one) for one in own] for own in (some.usual, *some.trajectories)])
    best = some.driven(some.true_best(nearest.ravel()))
    places = _places(some, 16)
    chosen = some.driven(places)
    assert list(some.differences.usable.shape) == shapes
    for known, guessed, usual in zip(best, chosen, some.usual, strict=True):
        assert known.outcome == guessed.outcome == usual.outcome or guessed.outcome == Outcome.SUCCESS
        assert _nearest_m(known) >= max(_nearest_m(guessed), _nearest_m(usual))
    gained = [_nearest_m(g) - _nearest_m(u) for g, u in zip(chosen, some.usual, strict=True)]
    assert np.mean(gained) > 0.1
    otherwise = np.flatnonzero(places != BASE)
    of_these = (
        some.differences.pairs[some.rows(places, otherwise)].seen[:, 0, 0] > 0
    )  # what is asked about is what would drive
    assert of_these.tolist() == [gained[scene] > 0 for scene in otherwise]


def test_what_is_shown_directly_was_preferred_in_five_and_harm_is_counted_of_all_and_of_these() -> None:
    asked = {"direct_asked": 6, "gain_direct_before": 0.1}
    persons = [
        asked | {"direct_wins": 6, "gain_direct_after": 0.3},
        asked | {"direct_wins": 5, "gain_direct_after": -0.2},
        asked | {"direct_wins": 4, "gain_direct_after": -0.4},
        asked | {"direct_wins": 0, "direct_asked": 0, "gain_direct_after": 0.0},  # it drives as the base policy
    ]
    found = _shown_directly(persons)
    assert found["shown_directly"] == 0.5
    assert found["harmed_direct_after_of_all"][0] == 0.25
    assert found["harmed_direct_after_of_shown"][0] == 0.5
    assert (found["raised_direct_before_of_shown"], found["raised_direct_after_of_shown"]) == (1.0, 0.5)
