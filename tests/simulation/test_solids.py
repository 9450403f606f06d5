"""What a robot of chapter 2 observes, against geometry written another way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapely import LineString, Point, Polygon
from shapely.ops import nearest_points

from desirepath.learning.policies.mirroring import mirror_of
from desirepath.learning.preferences.features import step_features
from desirepath.simulation.environments import NavigationEnv, observation_space
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import SETUPS, SetupError, demonstration_setups


def by_hand(scene: Scene, scale: float) -> list[float]:
    """The observation at the scene's start, from shapely's nearest points."""
    start, person = scene.start, scene.person.pose
    robot = Point(start.x, start.y)

    def bearing(x: float, y: float) -> list[float]:
        angle = math.atan2(y - start.y, x - start.x) - start.yaw
        return [math.cos(angle), math.sin(angle)]

    assert scene.room is not None
    x, y = scene.room.length / 2, scene.room.width / 2
    shapes = [
        LineString([(x, -y), (x, y)]),
        LineString([(-x, -y), (-x, y)]),
        LineString([(-x, y), (x, y)]),
        LineString([(-x, -y), (x, -y)]),
        *(Polygon(obstacle.corners()) for obstacle in scene.obstacles),
    ]
    turned = person.yaw - start.yaw
    seen = [math.dist((start.x, start.y), (person.x, person.y)) / scale, *bearing(person.x, person.y)]
    seen += [*bearing(scene.goal.x, scene.goal.y), math.cos(turned), math.sin(turned)]
    for shape in shapes:
        _, nearest = nearest_points(robot, shape)
        seen += [robot.distance(shape) / scale, *bearing(nearest.x, nearest.y)]
    return seen


@pytest.mark.parametrize("name", demonstration_setups())
def test_the_observation_holds_person_goal_bearing_and_every_closest_point(name: str) -> None:
    setup, scenes = SETUPS[name], draw_scenes(name, range(40))
    seen = make_engine(setup, 40, scenes=scenes).observations
    assert seen == pytest.approx(np.array([by_hand(scene, setup.distance_scale_m) for scene in scenes]), abs=1e-5)
    names = [entry["name"] for entry in setup.observation_layout()]
    assert len(names) == len(set(names)) == setup.observation_size == seen.shape[1]
    assert all(observation_space(setup).contains(row) for row in seen)
    env = NavigationEnv(name)
    assert (env.reset(options={"scene": scenes[0]})[0] == seen[0]).all()


@pytest.mark.parametrize("name", demonstration_setups())
def test_what_reads_a_lidar_refuses_such_observations(name: str) -> None:
    setup = SETUPS[name]
    seen = np.zeros((2, setup.observation_size), dtype=np.float32)
    with pytest.raises(SetupError, match="no lidar"):
        step_features(np.zeros((2, 2), dtype=np.float32), seen, setup)
    with pytest.raises(SetupError, match="no lidar"):
        mirror_of(setup)
