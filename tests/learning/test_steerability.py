"""How far wants move a policy: shares of what is possible, with known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from desirepath.learning.policies.conditioned import settings
from desirepath.learning.policies.evaluate import evaluate_policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import (
    Course,
    MeasuredRollouts,
    Steerability,
    measure_rollouts,
    steerability_of,
)
from desirepath.learning.preferences.measures import MEASURES
from desirepath.learning.preferences.objectives import NAMES, OBJECTIVES, best_possible
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Person, Pose, Scene
from desirepath.simulation.setups import SETUPS, SetupError, preference_setups
from desirepath.simulation.trajectory import Outcome

PREFERENCE_SETUPS = preference_setups()


def trajectories(human_m: list[float], outcome: Outcome = Outcome.SUCCESS, crossings: int = 0) -> MeasuredRollouts:
    measured = np.zeros((len(human_m), len(MEASURES)))
    measured[:, 0] = human_m
    n = len(human_m)
    return MeasuredRollouts(np.full(n, outcome, dtype=np.int8), measured, np.full(n, crossings, dtype=np.int32))


def test_share_of_the_way_is_a_ratio_of_means() -> None:
    possible = np.ones((2, len(NAMES)))
    possible[:, 0] = [3.0, 3.0]
    movement = Steerability(
        trajectories([1.0, 1.0]), {"neutral": trajectories([1.2, 1.2]), "farther": trajectories([2.0, 3.0])}, possible
    )
    assert movement.shares["farther"] == pytest.approx(0.75)
    moved = movement.report()["moved"]["farther"]
    assert (moved["base"], moved["told"], moved["best_possible"]) == (1.0, 2.5, 3.0)
    assert moved["better_than_base"]["value"] == pytest.approx(1.5)
    assert moved["better_than_neutral"]["value"] == pytest.approx(1.3)
    assert moved["share_of_the_way"]["low"] == pytest.approx(0.5)
    assert moved["share_of_the_way"]["high"] == pytest.approx(1.0)


def test_failures_and_self_intersections_cost_score() -> None:
    possible = np.full((4, len(NAMES)), 3.0)
    base, good = trajectories([1.0] * 4), trajectories([2.0] * 4)
    best = Steerability(base, {"farther": good}, possible).score
    assert best == pytest.approx(0.5)
    assert Steerability(base, {"farther": trajectories([2.0] * 4, crossings=1)}, possible).score < best
    half = MeasuredRollouts(np.array([1, 1, 1, 3], dtype=np.int8), good.measured, good.self_intersections)
    assert Steerability(base, {"farther": half}, possible).score < best
    assert math.isfinite(Steerability(base, {"farther": trajectories([2.0] * 4, Outcome.TIMEOUT)}, possible).score)


def test_what_is_possible_in_a_plain_scene() -> None:
    scene = Scene("open_field", 0, Pose(0, 0, 0), Pose(4, 0, 0), 0.4, Person(Pose(1, 1, 0)))
    limit = dict(zip(NAMES, best_possible([scene])[0], strict=True))
    assert limit["farther"] == pytest.approx(math.sqrt(2))
    assert limit["closer"] == pytest.approx(0.48)
    assert (limit["person_on_left"], limit["person_on_right"]) == (1, -1)
    assert limit["clearance"] == 0.8
    assert limit["shorter"] == pytest.approx(3.6)
    assert limit["smoother"] == 0
    assert limit["slower_near_person"] == 0
    assert limit["faster"] == pytest.approx(7.2)
    turned = Scene("open_field", 0, Pose(0, 0, math.pi / 2), Pose(4, 0, 0), 0.4, Person(Pose(1, 1, 0)))
    assert best_possible([turned])[0, NAMES.index("smoother")] == pytest.approx(math.pi / 2 - math.asin(0.1))


@pytest.mark.parametrize("setup", PREFERENCE_SETUPS)
def test_no_drive_betters_what_is_possible(setup: str) -> None:
    scenes = scene_set(setup, 80, purpose=Purpose.SELECT, seed=77)
    rolled_out = measure_rollouts(load_policy(f"{setup}/base"), scenes)
    limits = best_possible(scenes)
    for k, objective in enumerate(OBJECTIVES):
        room = objective.sign * (limits[:, k] - rolled_out.measured[:, objective.measure])
        spare = SETUPS[setup].goal_radius_m if objective.name == "farther" else 1e-3  # the ceiling is the goal's centre
        assert room[rolled_out.success].min() > -spare, objective.name


@pytest.mark.parametrize("setup", PREFERENCE_SETUPS)
def test_a_course_measures_what_the_trajectories_would(setup: str) -> None:
    scenes = scene_set(setup, 60, purpose=Purpose.SELECT, seed=78)
    policies = [load_conditioned(f"{setup}/conditioned").at(settings()[told]) for told in ("farther", "neutral")]
    course = Course(scenes)
    for policy in (*policies, policies[0]):  # a course is the same however often it was driven
        rolled_out, expected = (
            course.rollout(policy),
            MeasuredRollouts.of(rollout(SETUPS[setup], policy.rollout_policy, scenes)),
        )
        assert np.array_equal(rolled_out.outcome, expected.outcome)
        assert np.array_equal(rolled_out.self_intersections, expected.self_intersections)
        np.testing.assert_allclose(rolled_out.measured, expected.measured, rtol=2e-4, atol=2e-3)
    with pytest.raises(SetupError, match="policy"):
        course.rollout(load_policy("open_field/base" if setup == "study_room" else "study_room/base"))


def test_drives_are_those_of_evaluation() -> None:
    policy = load_policy("study_room/base")
    rolled_out = measure_rollouts(policy, scene_set("study_room", 60, purpose=Purpose.REPORT, seed=4_243))
    told = evaluate_policy(policy, n=60, seed=4_243)
    assert rolled_out.success.mean() == pytest.approx(told["success_rate"])
    assert rolled_out.measured[:, 0].mean() == pytest.approx(told["min_human_distance_m"], abs=1e-4)
    movement = steerability_of(
        {"neutral": policy}, policy, scene_set("study_room", 10, purpose=Purpose.REPORT, seed=4_243)
    )
    assert movement.report()["moved"] == {}
