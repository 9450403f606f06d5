"""Scenes of chapter 5 beside the drawn ones: a person who walks towards the robot, and an intersection of corridors.

Neither is trained in. Drawing the others is `scenes.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice

import numpy as np

from desirepath.simulation import kernels as k
from desirepath.simulation.scene import Obstacle, Person, Pose, Scene
from desirepath.simulation.scenes import check_scene, draw_scene, scene_to_row
from desirepath.simulation.setups import get_setup
from desirepath.simulation.walks import Walk

ADAPTABLE = get_setup("adaptable")

WALKING_SPEED_M_S = 0.5  # section 5.4.2
FREE_OF_WALKER_M = 0.1  # ours: boxes stand so far from where the person walks
CORRIDOR_M = 4.0  # ours: width of both corridors
WALLS_M = 6.0  # ours: side of the four blocks between which the corridors run


def walking_person(scene: Scene) -> Scene | None:
    """The scene with a person who comes from the goal, walks to where the robot started at 0.5 m/s and stays there.

    They begin two bodies before the goal, so that nobody stands in it. None where a box is in their way.
    """
    start, goal = scene.start, scene.goal
    way = np.array([start.x - goal.x, start.y - goal.y])
    length = float(np.linalg.norm(way))
    towards, yaw = way / length, math.atan2(way[1], way[0])
    begin_m = scene.person.radius + 2 * get_setup(scene.setup).robot.radius_m
    row = scene_to_row(scene)
    for s in np.arange(begin_m, length, 0.05):
        x, y = np.array([goal.x, goal.y]) + s * towards
        if k.surface_distance(row, x, y) < scene.person.radius + FREE_OF_WALKER_M:
            return None
    first = np.array([goal.x, goal.y]) + begin_m * towards
    places = np.stack([first, [start.x, start.y]])
    walk = Walk(
        (0.0, (length - begin_m) / WALKING_SPEED_M_S),
        tuple(map(float, places[:, 0])),
        tuple(map(float, places[:, 1])),
        (yaw, yaw),
    )
    return replace(scene, person=Person(Pose(float(first[0]), float(first[1]), yaw)), walk=walk)


def walking_scenes(n: int, first_seed: int) -> list[Scene]:
    """The first n drawn scenes from that seed on in which a person can walk as `walking_person` says."""

    def walked() -> Iterator[Scene]:
        for seed in count(first_seed):
            scene = walking_person(draw_scene(ADAPTABLE, seed))
            if scene is not None:
                yield scene

    return list(islice(walked(), n))


def intersection(seed: int) -> Scene:
    """Two corridors that cross: the robot comes from the west and turns north; a person stands where they meet.

    Start, goal and person move a little with the seed (0.6 m along and 0.4 m across a corridor).
    """
    random = np.random.Generator(np.random.PCG64([seed, 5, 1]))
    start_s, start_d, goal_s, goal_d, person_x, person_y = (2 * random.random(6) - 1).tolist()
    middle = (CORRIDOR_M + WALLS_M) / 2
    walls = tuple(
        Obstacle("wall", Pose(sx * middle, sy * middle), WALLS_M, WALLS_M, 2.0) for sx in (1, -1) for sy in (1, -1)
    )
    scene = Scene(
        setup=ADAPTABLE.name,
        seed=seed,
        start=Pose(-5.5 + 0.6 * start_s, 0.4 * start_d, 0.0),
        goal=Pose(0.4 * goal_d, 5.5 + 0.6 * goal_s, math.pi / 2),
        goal_radius=ADAPTABLE.goal_radius_m,
        person=Person(Pose(0.4 * person_x, 0.4 * person_y, math.pi)),
        obstacles=walls,
    )
    check_scene(scene)
    return scene
