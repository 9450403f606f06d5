"""A choice per scene: only what arrives, the base policy where nothing is surely better, the best by the true score."""

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.benchmarks.people import RobotOfLibrary, roll_out
from desirepath_experiments.benchmarks.scene_choice import SceneCandidates


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
    return SceneCandidates.of(robot, roll_out(robot.base, scenes), own, True)


def _expecting_more_distance(some: SceneCandidates, answers: int) -> tuple[FreePosterior, StepPosterior]:
    """Of somebody who chose, again and again, whichever kept further from the person."""
    further = some.pairs.seen[:, 0, 0] > 0
    which = np.resize(np.arange(len(further)), answers)
    return FreePosterior.from_answers(some.pairs[which], further[which]), StepPosterior.from_answers(
        some.steps[which], further[which]
    )


def _nearest_m(trajectory: Trajectory) -> float:
    person = trajectory.scene.person.pose
    return float(np.hypot(trajectory.poses[:, 0] - person.x, trajectory.poses[:, 1] - person.y).min())


def test_base_policy_drives_where_too_little_is_known(some: SceneCandidates) -> None:
    nobody = _expecting_more_distance(some, 1)
    assert some.choose(*nobody, caution=5.0) == some.usual


def test_chosen_and_best_arrive_and_nobody_chooses_better_than_who_knows_the_score(some: SceneCandidates) -> None:
    shapes = [len(some.trajectories), len(some.usual)]
    nearest = np.array([[_nearest_m(one) for one in own] for own in (some.usual, *some.trajectories)])
    best = some.true_best(nearest.ravel())
    chosen = some.choose(*_expecting_more_distance(some, 16), caution=0.0)
    assert list(some.usable.shape) == shapes
    for known, guessed, usual in zip(best, chosen, some.usual, strict=True):
        assert known.outcome == guessed.outcome == usual.outcome or guessed.outcome == Outcome.SUCCESS
        assert _nearest_m(known) >= max(_nearest_m(guessed), _nearest_m(usual))
    gained = [_nearest_m(g) - _nearest_m(u) for g, u in zip(chosen, some.usual, strict=True)]
    assert np.mean(gained) > 0.1
