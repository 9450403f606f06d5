"""Drawing scenes with crowds from a seed: who walks and who stands where in a building.

Buildings live in `crowd_buildings.py`, ways in them in `crowd_maps.py`. What a scene is stands in `scene.py`, its
pedestrians in `pedestrians.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from desirepath.simulation.crowds.crowd_buildings import BUILDINGS, TRIES
from desirepath.simulation.crowds.crowd_maps import CELL_M, FreePlaces, boxes_of, map_of, robot_path, tidy
from desirepath.simulation.crowds.crowd_setups import PED_DEPTH_M, PED_WIDTH_M, get_crowd_setup
from desirepath.simulation.pedestrians import MOST_PEDESTRIANS, Crowd, CrowdConditions, Pedestrian
from desirepath.simulation.scene import Person, Pose, Room, Scene, SceneError
from desirepath.simulation.setups import Setup, SetupError, get_setup
from desirepath.simulation.worlds import WORLDS

Doubles = NDArray[np.float64]
FROM_START_M = 1.2  # ours: nobody begins nearer to the robot
NEAR_PATH_M = 0.5  # ours: "around the robot path"
SHORTEST_ROUTE_M = 3.0  # ours


UNSEEN_HOMES = CrowdConditions(  # section 4.5.6, after the iGibson challenge: its maximum speed, its free floor
    standing=(1, 1), speeds=(0.5, 0.5), behaviour="orca", area_m2=8.0
)
PUBLISHED = CrowdConditions(moving=(2, 2), standing=(1, 1), speeds=(0.6, 0.6))  # table 4.1


def draw_crowd_scene(setup: str, seed: int, conditions: CrowdConditions | None = None) -> Scene:
    """The scene of that crowd setup and seed among such pedestrians (the setup's own, if none are given): the same on
    every machine.

    Its person is the first who stands; all others are its crowd. Raises SetupError, or SceneError for a seed that gave
    no scene.
    """
    chosen = get_crowd_setup(setup)
    if chosen.world not in BUILDINGS:
        raise SetupError(f"setup {setup}: its world {chosen.world} is no building; one of {', '.join(BUILDINGS)}")
    rules = conditions or chosen.people or CrowdConditions()
    random = np.random.Generator(np.random.PCG64([seed, WORLDS[chosen.world].number]))
    for _ in range(TRIES):
        room, obstacles, ends = BUILDINGS[chosen.world](random)
        start, goal = Pose(tidy(ends[0, 0]), tidy(ends[0, 1])), Pose(tidy(ends[1, 0]), tidy(ends[1, 1]))
        scene = Scene(setup, seed, start, goal, chosen.goal_radius_m, Person(start), obstacles, room)
        try:
            peopled = people_scene(scene, rules, random)
        except SceneError:
            continue
        return peopled
    raise SceneError("seed", seed, f"gave no {setup} scene; use another seed")


def people_scene(scene: Scene, conditions: CrowdConditions, random: np.random.Generator) -> Scene:
    """Any scene with a room, its person and its crowd drawn anew; the robot faces its path. Raises SceneError."""
    path = robot_path(scene)
    room, boxes = scene.room, boxes_of(scene)
    if room is None:
        raise SceneError("room", None, "pedestrians need a room with walls")
    inside = map_of(room, boxes)
    free = inside.places()
    start, goal = np.array([scene.start.x, scene.start.y]), np.array([scene.goal.x, scene.goal.y])
    free = free[np.linalg.norm(free - start, axis=1) > FROM_START_M]
    if len(free) < 2:
        raise SceneError("room", room, "has too few free places for pedestrians")
    moving = [
        _moving(inside, free, path if number == 0 else None, conditions, random)
        for number in range(_how_many(conditions, scene, random))
    ]
    stands = int(random.integers(conditions.standing[0], conditions.standing[1] + 1))
    robot_m = get_setup(scene.setup).robot.radius_m
    standing = _standing(room, boxes, free, (start, goal), stands, robot_m, random)
    yaw = math.atan2(path[1][1] - path[0][1], path[1][0] - path[0][0]) + random.uniform(-0.3, 0.3)
    person = Person(Pose(*standing[0].route[0], standing[0].yaw))
    return Scene(
        scene.setup,
        scene.seed,
        Pose(scene.start.x, scene.start.y, tidy(yaw)),
        scene.goal,
        scene.goal_radius,
        person,
        scene.obstacles,
        scene.room,
        crowd=Crowd(conditions.behaviour, (*moving, *standing[1:])),
    )


def _how_many(conditions: CrowdConditions, scene: Scene, random: np.random.Generator) -> int:
    if conditions.area_m2 is not None and scene.room is not None:
        fits = map_of(scene.room, boxes_of(scene), get_setup(scene.setup).robot.radius_m)
        parts, _ = label(fits.free)
        reached = CELL_M**2 * int((parts == parts[fits.cell(scene.start.x, scene.start.y)]).sum())
        return min(max(1, int(reached / conditions.area_m2)), MOST_PEDESTRIANS - conditions.standing[1])
    return int(random.integers(conditions.moving[0], conditions.moving[1] + 1))


def _moving(
    inside: FreePlaces,
    free: Doubles,
    path: Sequence[tuple[float, float]] | None,
    conditions: CrowdConditions,
    random: np.random.Generator,
) -> Pedestrian:
    """path: the robot's, near which the first one's route begins and ends."""
    speed = tidy(random.uniform(*conditions.speeds))
    near = free if path is None else free[_away(free, path) < NEAR_PATH_M]
    for _ in range(TRIES):
        if len(near) < 2:
            break
        begin, end = near[random.integers(len(near), size=2)]
        if math.dist(begin, end) < SHORTEST_ROUTE_M:
            continue
        route = inside.way(begin, end)
        if route:
            return Pedestrian(route, speed)
    raise SceneError("crowd", len(free), "no route of 3 m between free places")


def _away(places: Doubles, path: Sequence[tuple[float, float]]) -> Doubles:
    """(n,) distances of places from a polyline, m."""
    nearest = np.full(len(places), np.inf)
    for a, b in zip(np.array(path[:-1]), np.array(path[1:]), strict=True):
        along = np.clip((places - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(places - a - along[:, None] * (b - a), axis=1))
    return nearest


def _standing(
    room: Room,
    boxes: Doubles,
    free: Doubles,
    ends: tuple[Doubles, Doubles],
    number: int,
    robot_m: float,
    random: np.random.Generator,
) -> list[Pedestrian]:
    """Who stands leaves the robot (`robot_m` its radius) a way of its own width, checked by A*, and its goal free."""
    free = free[np.linalg.norm(free - ends[1], axis=1) > FROM_START_M / 2]
    found: list[Pedestrian] = []
    for _ in range(TRIES):
        if len(found) == number or not len(free):
            break
        x, y = free[random.integers(len(free))]
        yaw = random.uniform(-math.pi, math.pi)
        more = np.array([(x, y, PED_DEPTH_M / 2, PED_WIDTH_M / 2, math.cos(yaw), math.sin(yaw))])
        trial = np.concatenate([boxes, more])
        around = map_of(room, trial, robot_m + 0.06)
        if around.way(ends[0], ends[1]):
            boxes = trial
            found.append(Pedestrian(((tidy(x), tidy(y)),), 0.0, tidy(yaw)))
    if len(found) < number:
        raise SceneError("crowd", number, "no place to stand that leaves the robot a way")
    return found


def draw_in_building(setup: Setup, seed: int) -> Scene:
    """The scene of that setup and seed, among the setup's own people."""
    return draw_crowd_scene(setup.name, seed)
