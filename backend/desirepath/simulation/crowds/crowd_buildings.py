"""Drawing the buildings that crowds walk in: corridor, intersection, office, home, hall; where a robot's way begins.

The ways in them live in `crowd_maps.py`, the people in `crowd_scenes.py`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.crowds.crowd_maps import boxes_of, map_of, tidy
from desirepath.simulation.scene import Obstacle, Pose, Room
from desirepath.simulation.scenes import draw_scene

Doubles = NDArray[np.float64]
OUTER_M = 8.0  # ours: side of intersection and office
DOOR_M, WALL_M = 1.0, 0.15  # ours
HALL_M = (9.0, 6.0)  # ours
TRIES = 60
Building = tuple[Room, tuple[Obstacle, ...], Doubles]
"""Room, obstacles, places (n, 2) m of which the first two are the robot's start and goal."""


def _corridor(random: np.random.Generator) -> Building:
    room = Room(tidy(random.uniform(6.0, 8.0)), tidy(random.uniform(2.0, 2.5)))
    x, y = room.length / 2 - 0.6, room.width / 2 - 0.5
    return room, (), np.array([(sx * x, y * random.uniform(-1, 1)) for sx in (-1, 1)])


def _intersection(random: np.random.Generator) -> Building:
    half = OUTER_M / 2
    wide_x, wide_y = random.uniform(2.0, 2.5, 2)  # of the arms along x and along y
    length, width = half - wide_y / 2, half - wide_x / 2
    blocks = tuple(
        Obstacle("wall", Pose(tidy(sx * (half - length / 2)), tidy(sy * (half - width / 2))), length, width, 2.0)
        for sx in (1, -1)
        for sy in (1, -1)
    )
    end = half - 0.6
    ends = np.array([(end, 0.0), (-end, 0.0), (0.0, end), (0.0, -end)])
    return Room(OUTER_M, OUTER_M), blocks, ends[random.permutation(4)]


def _office(random: np.random.Generator) -> Building:
    """Walls across, each with a door; then in every strip between them a wall or none, with a door."""
    half = OUTER_M / 2
    turned = bool(random.integers(2))
    cuts = (
        [random.uniform(-1.2, 1.2)]
        if random.integers(2)
        else sorted((random.uniform(-1.8, -1.2), random.uniform(1.2, 1.8)))
    )
    walls: list[tuple[float, float, float, float]] = []  # x, y, length, width in the unturned office
    edges = [-half, *cuts, half]
    for cut in cuts:
        walls += _with_door(random, cut, -half, half, along_x=False)
    for low, high in itertools.pairwise(edges):
        if random.random() < 0.75:
            walls += _with_door(random, random.uniform(-1.5, 1.5), low + WALL_M / 2, high - WALL_M / 2, along_x=True)
    obstacles = tuple(
        Obstacle("wall", Pose(tidy(y), tidy(x)), width, length, 2.0)
        if turned
        else Obstacle("wall", Pose(tidy(x), tidy(y)), length, width, 2.0)
        for x, y, length, width in walls
    )
    corner = half - 0.6
    corners = np.array([(sx * corner, sy * corner) for sx in (1, -1) for sy in (1, -1)])
    return Room(OUTER_M, OUTER_M), obstacles, corners[random.permutation(4)]


def _with_door(
    random: np.random.Generator, at: float, low: float, high: float, *, along_x: bool
) -> list[tuple[float, float, float, float]]:
    door = random.uniform(low + 0.3, high - 0.3 - DOOR_M)
    found = []
    for begin, end in ((low, door), (door + DOOR_M, high)):
        middle, length = (begin + end) / 2, end - begin
        found.append((middle, at, length, WALL_M) if along_x else (at, middle, WALL_M, length))
    return found


def _home(random: np.random.Generator) -> Building:
    """A furnished home of `home_interiors.py`; start and goal 1 to 10 m apart anywhere in it, as in section 4.5.6."""
    scene = draw_scene("home", int(random.integers(2**31, 2**32)))
    room = scene.room or Room(OUTER_M, OUTER_M)
    free = map_of(room, boxes_of(scene)).places()
    for _ in range(TRIES):
        ends: Doubles = free[random.integers(len(free), size=2)]
        if 1.0 <= math.dist(ends[0], ends[1]) <= 10.0:
            break
    return room, scene.obstacles, ends


def _hall(random: np.random.Generator) -> Building:
    """Nothing but people: the robot crosses it along its length."""
    half_x, half_y = HALL_M[0] / 2 - 0.6, HALL_M[1] / 2 - 0.9
    side = 1.0 if random.integers(2) else -1.0
    ends = np.array([(end * half_x, random.uniform(-half_y, half_y)) for end in (side, -side)])
    return Room(*HALL_M), (), ends


BUILDINGS: dict[str, Callable[[np.random.Generator], Building]] = {
    "crowd_home": _home,
    "crowd_corridor": _corridor,
    "crowd_intersection": _intersection,
    "crowd_office": _office,
    "crowd_hall": _hall,
}
