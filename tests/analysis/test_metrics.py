"""Trajectory metrics against cases whose values follow from geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desirepath.analysis import metrics
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.fast import evaluate, rollout
from desirepath.simulation.scene import Obstacle, Person, Pose, Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import SETUPS, preference_setups
from desirepath.simulation.trajectory import Outcome, Trajectory

PREFERENCE_SETUPS = preference_setups()


def poses_of(xy: list[tuple[float, float]]) -> np.ndarray:
    return np.array([[(x, y, 0.0) for x, y in xy]])


def towards_goal(observations: np.ndarray) -> np.ndarray:
    """Drive at the goal, whatever stands there."""
    actions = np.ones((len(observations), 2), dtype=np.float32)
    actions[:, 1] = np.clip(2 * observations[:, 1], -1, 1)
    return actions


def test_rates_share_out_all_episodes() -> None:
    outcomes = [Outcome.SUCCESS] * 6 + [Outcome.COLLISION] * 3 + [Outcome.TIMEOUT]
    assert metrics.success_rate(outcomes) == pytest.approx(0.6)
    assert metrics.collision_rate(outcomes) == pytest.approx(0.3)
    assert metrics.timeout_rate(outcomes) == pytest.approx(0.1)
    assert math.isnan(metrics.success_rate([]))


def test_a_three_four_five_path_is_seven_metres_long_and_1_4_times_the_straight_line() -> None:
    poses = poses_of([(0, 0), (3, 0), (3, 4)])
    assert metrics.path_length(poses)[0] == pytest.approx(7.0)
    assert metrics.relative_path_length(metrics.path_length(poses), [5.0])[0] == pytest.approx(1.4)
    assert metrics.mean_speed([7.0, 0.0], [3.5, 0.0]).tolist() == [2.0, 0.0]


def test_accumulated_angle_counts_both_directions_and_takes_the_short_way_across_pi() -> None:
    poses = np.zeros((1, 4, 3))
    poses[0, :, 2] = [0.0, 0.5, -0.25, 0.0]
    assert metrics.accumulated_angle(poses)[0] == pytest.approx(0.5 + 0.75 + 0.25)
    poses[0, :, 2] = [3.1, -3.1, 3.1, 3.1]
    assert metrics.accumulated_angle(poses)[0] == pytest.approx(2 * (2 * math.pi - 6.2))


def test_min_human_distance_is_centre_to_centre() -> None:
    poses = poses_of([(-2, 1), (0, 1), (2, 1)])
    assert metrics.min_human_distance(poses, [(0.0, 0.0)])[0] == pytest.approx(1.0)


def test_min_obstacle_distance_is_from_the_robots_surface() -> None:
    scene = Scene(
        setup="open_field",
        seed=0,
        start=Pose(-2, 1),
        goal=Pose(2, 1),
        goal_radius=0.4,
        person=Person(Pose(0, 3)),
        obstacles=(Obstacle("cube", Pose(0, 0, math.pi / 4), 0.6, 0.6, 0.6),),
    )
    poses = poses_of([(-2, 1), (0, 1), (2, 1)])
    corner = 0.3 * math.sqrt(2)
    assert metrics.min_obstacle_distance(poses, [scene])[0] == pytest.approx(1 - corner - 0.18)


@pytest.mark.parametrize("turned", [0.0, 0.7, 2.5])
def test_path_area_of_half_circle_and_of_both_lobes_of_a_sine(turned: float) -> None:
    t = np.linspace(0, 1, 4001)
    turn = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    half_circle = np.stack([1 - np.cos(np.pi * t), np.sin(np.pi * t)], axis=1) @ turn.T + [3.0, -1.0]
    sine = np.stack([2 * np.pi * t, np.sin(2 * np.pi * t)], axis=1) @ turn.T + [3.0, -1.0]
    areas = metrics.path_area(np.stack([half_circle, sine]), np.stack([half_circle[-1], sine[-1]]))
    assert areas == pytest.approx([math.pi / 2, 4.0], abs=1e-5)


def test_path_area_counts_lobes_that_meet_exactly_on_the_line() -> None:
    zigzag = [(0, 0), (1, 1), (2, 0), (3, -1), (4, 0)]
    assert metrics.path_area(poses_of(zigzag), [(4.0, 0.0)])[0] == pytest.approx(2.0)
    straight = [(0, 0), (1, 0), (4, 0)]
    assert metrics.path_area(poses_of(straight), [(4.0, 0.0)])[0] == 0.0


@given(
    st.integers(2, 5).flatmap(
        lambda members: st.lists(st.lists(st.floats(-1, 1), min_size=4, max_size=4), min_size=members, max_size=members)
    )
)
def test_action_diversity_equals_its_double_sum(members: list[list[float]]) -> None:
    actions = np.array(members).reshape(len(members), 2, 2)
    by_hand = np.mean(
        [
            [sum(((a[s] - b[s]) ** 2).sum() for j, b in enumerate(actions) if j != i) for s in range(2)]
            for i, a in enumerate(actions)
        ]
    )
    assert metrics.action_diversity(actions) == pytest.approx(by_hand, abs=1e-9)


def test_action_diversity_needs_two_members() -> None:
    with pytest.raises(ValueError, match="members >= 2"):
        metrics.action_diversity(np.zeros((1, 3, 2)))


@pytest.mark.parametrize("name", PREFERENCE_SETUPS)
def test_metrics_of_trajectories_agree_with_the_engines_own_table(name: str) -> None:
    setup, scenes = SETUPS[name], draw_scenes(name, range(40))
    table = evaluate(towards_goal, setup, scenes)
    measured = metrics.measure(rollout(setup, towards_goal, scenes))
    assert (measured.outcome == table.outcome).all()
    assert (measured.steps == table.steps).all()
    for mine, engine in (
        (measured.path_length, table.path_length),
        (measured.accumulated_angle, table.accumulated_angle),
        (measured.min_human_distance, table.min_human_distance),
        (measured.min_obstacle_distance, table.min_clearance),
        (measured.path_area, table.path_area),
        (measured.straight_distance, table.straight_distance),
        (measured.time, table.time),
    ):
        assert mine == pytest.approx(engine, abs=2e-4)
    assert {Outcome.SUCCESS, Outcome.COLLISION} <= set(table.outcome.tolist())


def stood(scene: Scene, poses: np.ndarray) -> Trajectory:
    steps = len(poses) - 1
    blank = np.zeros((steps, 1), np.float32)
    return Trajectory(
        scene, Outcome.TIMEOUT, poses, blank, np.zeros((steps, 2), np.float32), blank[:, 0], blank, blank[:, 0] > 0
    )


def test_the_nearest_of_a_crowd_counts_and_not_only_who_stands() -> None:
    scene = draw_crowd_scene("crowd_hall", 1)
    walker = scene.crowd.pedestrians[0]
    at = walker.places_at(np.arange(11) * 0.2)[5]
    poses = np.tile([at[0] + 0.5, at[1], 0.0], (11, 1)).astype(np.float32)
    one = stood(scene, poses)
    person = math.dist(poses[0, :2], (scene.person.pose.x, scene.person.pose.y))
    assert metrics.measure([one]).min_human_distance[0] < 0.51 < person


def test_measuring_nothing_is_an_error() -> None:
    with pytest.raises(ValueError, match="none given"):
        metrics.measure([])


def test_where_the_robot_looks_changes_no_distance() -> None:
    random = np.random.default_rng(3)
    poses = np.concatenate([np.cumsum(random.normal(size=(4, 9, 2)), axis=1), random.uniform(-3, 3, (4, 9, 1))], axis=2)
    goals, people = random.normal(size=(2, 4, 2))
    walking = random.normal(size=(4, 9, 3))
    scenes = draw_scenes("study_room", range(4))
    for measured in (
        metrics.path_length,
        lambda of: metrics.min_human_distance(of, people),
        lambda of: metrics.min_human_distance(of, walking),
        lambda of: metrics.min_obstacle_distance(of, scenes),
        lambda of: metrics.path_area(of, goals),
        lambda of: metrics.straight_distance(of[:, 0], goals),
    ):
        assert (measured(poses) == measured(poses[..., :2])).all()
    steps = np.linalg.norm(np.diff(poses[..., :2], axis=1), axis=2).sum(axis=1)
    assert metrics.path_length(poses) == pytest.approx(steps)
    away = [
        min(math.dist(p[:2], q[:2]) for p, q in zip(*both, strict=True)) for both in zip(poses, walking, strict=True)
    ]
    assert metrics.min_human_distance(poses, walking) == pytest.approx(away)
    assert metrics.straight_distance(poses[:, 0], poses[:, 1]) == pytest.approx(
        [math.dist(one[0, :2], one[1, :2]) for one in poses]
    )
