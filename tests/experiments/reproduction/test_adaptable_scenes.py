"""Setup `adaptable`: what chapter 5 says of its scenes, a person who walks, an intersection; the same from a seed."""

from __future__ import annotations

import math

import numpy as np

from desirepath.simulation.fast import make_engine, rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import check_scene, draw_scenes
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_experiments.reproduction.adaptable.adaptable_scenes import (
    WALKING_SPEED_M_S,
    intersection,
    walking_scenes,
)

ADAPTABLE = get_setup("adaptable")


def test_start_and_goal_lie_six_to_twelve_metres_apart_with_the_person_between_and_three_boxes() -> None:
    for scene in draw_scenes(ADAPTABLE, range(500)):
        way = np.array([scene.goal.x - scene.start.x, scene.goal.y - scene.start.y])
        to_person = np.array([scene.person.pose.x - scene.start.x, scene.person.pose.y - scene.start.y])
        length = float(np.linalg.norm(way))
        along, aside = float(way @ to_person) / length, float(way[0] * to_person[1] - way[1] * to_person[0]) / length
        assert 6 - 1e-5 <= length <= 12 + 1e-5
        assert 0.35 - 1e-5 <= along / length <= 0.65 + 1e-5
        assert abs(aside) <= 0.6 + 1e-5
        assert len(scene.obstacles) == 3
        assert scene.room is None


def test_the_robot_sees_goal_person_and_thirty_ranges_within_four_metres() -> None:
    engine = make_engine(ADAPTABLE, 50, seed=1)
    assert engine.observations.shape == (50, 34)
    assert ADAPTABLE.robot.lidar.beams == 720
    assert (engine.observations[:, 4:] <= 1).all()
    assert (ADAPTABLE.robot.limits.v_max, ADAPTABLE.robot.limits.w_max) == (0.5, math.pi)


def test_a_person_walks_from_the_goal_to_the_start_and_touches_no_box() -> None:
    for scene in walking_scenes(20, 0):
        check_scene(scene)
        assert Scene.from_dict(scene.as_dict()) == scene
        places = scene.person_poses(np.arange(0, 30, CONTROL_DT_S))[:, :2]
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / CONTROL_DT_S
        assert speeds.max() <= WALKING_SPEED_M_S + 1e-6
        np.testing.assert_allclose(places[-1], [scene.start.x, scene.start.y], atol=1e-6)


def test_who_stands_in_the_walkers_way_is_met_by_them() -> None:
    (scene,) = walking_scenes(1, 0)
    (one,) = rollout(ADAPTABLE, lambda seen: np.tile(np.float32([-1, 0]), (len(seen), 1)), [scene])
    assert one.observations[-1, 2] < one.observations[0, 2]


def test_an_intersection_is_the_same_from_the_same_seed_and_can_be_crossed() -> None:
    assert intersection(3) == intersection(3)
    assert intersection(3) != intersection(4)
    for seed in range(20):
        scene = intersection(seed)
        assert {obstacle.kind for obstacle in scene.obstacles} == {"wall"}
        assert scene.start.x < -4
        assert scene.goal.y > 4
