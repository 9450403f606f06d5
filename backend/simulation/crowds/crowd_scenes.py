"""Drawing scenes with crowds from a seed: corridor, intersection, office, home; who walks where in them.

Ways come from A* on the empty map. What a scene is stands in `scene.py`, its pedestrians in `pedestrians.py`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from backend.simulation.crowds import planning_kernels as plan
from backend.simulation.crowds.crowd_setups import (
    CURRICULUM,
    PED_DEPTH_M,
    PED_SPEEDS_M_S,
    PED_WIDTH_M,
    get_crowd_setup,
)
from backend.simulation.pedestrians import MOST_KNOTS, MOST_PEDESTRIANS, Behaviour, Crowd, Pedestrian
from backend.simulation.scene import Obstacle, Person, Pose, Room, Scene, SceneError
from backend.simulation.scenes import draw_scene
from backend.simulation.setups import ROBOT_RADIUS_M

Doubles = NDArray[np.float64]
CELL_M = 0.1
CLEARANCE_M = 0.32  # of routes from walls: half a pedestrian's diagonal
FROM_START_M = 1.2  # ours: nobody begins nearer to the robot
NEAR_PATH_M = 0.5  # ours: "around the robot path"
SHORTEST_ROUTE_M = 3.0  # ours
OUTER_M = 8.0  # ours: side of intersection and office
DOOR_M, WALL_M = 1.0, 0.15  # ours
TRIES = 60
TAGS = {"crowd_corridor": 41, "crowd_intersection": 42, "crowd_office": 43, "crowd_home": 44}


@dataclass(frozen=True)
class CrowdConditions:
    """Who is drawn into a scene. moving, standing: numbers, from-to; speeds: m/s, from-to. Thesis: section 4.4.6.1."""

    moving: tuple[int, int] = (1, CURRICULUM[0])
    standing: tuple[int, int] = (1, 2)
    speeds: tuple[float, float] = PED_SPEEDS_M_S
    behaviour: Behaviour = "path"
    area_m2: float | None = None  # so many square metres of the room for each who moves, instead of `moving`

    def __post_init__(self) -> None:
        if self.standing[0] < 1 or self.moving[0] < 0:
            raise SceneError("crowd", (self.moving, self.standing), "one person at least stands: the scene's own")


UNSEEN_HOMES = CrowdConditions(  # section 4.5.6, after the iGibson challenge; at most, as it has maximum speeds only
    standing=(1, 1), speeds=(0.5, 0.5), behaviour="orca", area_m2=8.0
)
PUBLISHED = CrowdConditions(moving=(2, 2), standing=(1, 1), speeds=(0.6, 0.6))  # table 4.1


@dataclass(frozen=True)
class _Map:
    """Free places of an empty building, on a grid. xs, ys: coordinates (m) of columns and lines."""

    free: NDArray[np.bool_]
    xs: Doubles
    ys: Doubles

    def cell(self, x: float, y: float) -> tuple[int, int]:
        return round((x - self.xs[0]) / CELL_M), round((y - self.ys[0]) / CELL_M)

    def places(self) -> Doubles:
        """(n, 2) all free places, m."""
        i, j = np.nonzero(self.free)
        return np.stack([self.xs[i], self.ys[j]], axis=1)

    def way(self, begin: Sequence[float] | Doubles, end: Sequence[float] | Doubles) -> tuple[tuple[float, float], ...]:
        """The way between two places as a polyline; empty where there is none, or none with few enough corners."""
        cells = plan.a_star(self.free, self.cell(begin[0], begin[1]), self.cell(end[0], end[1]))
        if len(cells) < 2:
            return ()
        corners = plan.pulled_straight(self.free, cells)
        if len(corners) > MOST_KNOTS:
            return ()
        return tuple((_tidy(self.xs[i]), _tidy(self.ys[j])) for i, j in corners)


def _tidy(value: float) -> float:
    return round(float(value), 6)


def boxes_of(scene: Scene) -> Doubles:
    """Walls and obstacles of a scene: (n, 6) x, y, half length, half width (m), cosine and sine of the yaw."""
    return np.array(
        [
            (o.pose.x, o.pose.y, o.length / 2, o.width / 2, math.cos(o.pose.yaw), math.sin(o.pose.yaw))
            for o in scene.solids()
        ],
        dtype=np.float64,
    ).reshape(-1, 6)


def _line(side_m: float) -> Doubles:
    half = math.floor(side_m / 2 / CELL_M)
    return np.arange(-half, half + 1, dtype=np.float64) * CELL_M


def map_of(room: Room, boxes: Doubles, clearance_m: float = CLEARANCE_M) -> _Map:
    """The grid of places in a room that keep clear of all boxes (n, 6)."""
    xs, ys = (_line(side) for side in (room.length, room.width))
    return _Map(plan.mark_free_cells(boxes, xs, ys, clearance_m), xs, ys)


@lru_cache(maxsize=4_096)
def robot_path(scene: Scene) -> tuple[tuple[float, float], ...]:
    """A* on the empty map from the robot's start to its goal, which is its last place. Raises SceneError for none."""
    if scene.room is None:
        raise SceneError("room", None, "a robot's path needs a room with walls")
    inside = map_of(scene.room, boxes_of(scene))
    way = inside.way((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y))
    if not way:
        raise SceneError("goal", scene.goal, "has no way from the start on the empty map")
    return ((scene.start.x, scene.start.y), *way[1:-1], (scene.goal.x, scene.goal.y))


def _corridor(random: np.random.Generator) -> tuple[Room, tuple[Obstacle, ...], Doubles]:
    room = Room(_tidy(random.uniform(6.0, 8.0)), _tidy(random.uniform(2.0, 2.5)))
    x, y = room.length / 2 - 0.6, room.width / 2 - 0.5
    return room, (), np.array([(sx * x, y * random.uniform(-1, 1)) for sx in (-1, 1)])


def _intersection(random: np.random.Generator) -> tuple[Room, tuple[Obstacle, ...], Doubles]:
    half = OUTER_M / 2
    wide_x, wide_y = random.uniform(2.0, 2.5, 2)  # of the arms along x and along y
    length, width = half - wide_y / 2, half - wide_x / 2
    blocks = tuple(
        Obstacle("wall", Pose(_tidy(sx * (half - length / 2)), _tidy(sy * (half - width / 2))), length, width, 2.0)
        for sx in (1, -1)
        for sy in (1, -1)
    )
    end = half - 0.6
    ends = np.array([(end, 0.0), (-end, 0.0), (0.0, end), (0.0, -end)])
    return Room(OUTER_M, OUTER_M), blocks, ends[random.permutation(4)]


def _office(random: np.random.Generator) -> tuple[Room, tuple[Obstacle, ...], Doubles]:
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
        Obstacle("wall", Pose(_tidy(y), _tidy(x)), width, length, 2.0)
        if turned
        else Obstacle("wall", Pose(_tidy(x), _tidy(y)), length, width, 2.0)
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


def _home(random: np.random.Generator) -> tuple[Room, tuple[Obstacle, ...], Doubles]:
    """A furnished home of `home_interiors.py`; start and goal 1 to 10 m apart anywhere in it, as in section 4.5.6."""
    scene = draw_scene("home", int(random.integers(2**31, 2**32)))
    room = scene.room or Room(OUTER_M, OUTER_M)
    free = map_of(room, boxes_of(scene)).places()
    for _ in range(TRIES):
        ends: Doubles = free[random.integers(len(free), size=2)]
        if 1.0 <= math.dist(ends[0], ends[1]) <= 10.0:
            break
    return room, scene.obstacles, ends


_BUILDINGS = {
    "crowd_home": _home,
    "crowd_corridor": _corridor,
    "crowd_intersection": _intersection,
    "crowd_office": _office,
}


def draw_crowd_scene(setup: str, seed: int, conditions: CrowdConditions | None = None) -> Scene:
    """The scene of that crowd setup and seed among such pedestrians: the same on every machine.

    Its person is the first who stands; all others are its crowd. Raises SetupError, or SceneError for a seed that gave
    no scene.
    """
    chosen, rules = get_crowd_setup(setup), conditions or CrowdConditions()
    random = np.random.Generator(np.random.PCG64([seed, TAGS[setup]]))
    for _ in range(TRIES):
        room, obstacles, ends = _BUILDINGS[setup](random)
        start, goal = Pose(_tidy(ends[0, 0]), _tidy(ends[0, 1])), Pose(_tidy(ends[1, 0]), _tidy(ends[1, 1]))
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
        for number in range(_how_many(conditions, room, random))
    ]
    stands = int(random.integers(conditions.standing[0], conditions.standing[1] + 1))
    standing = _standing(room, boxes, free, (start, goal), stands, random)
    yaw = math.atan2(path[1][1] - path[0][1], path[1][0] - path[0][0]) + random.uniform(-0.3, 0.3)
    person = Person(Pose(*standing[0].route[0], standing[0].yaw))
    return Scene(
        scene.setup,
        scene.seed,
        Pose(scene.start.x, scene.start.y, _tidy(yaw)),
        scene.goal,
        scene.goal_radius,
        person,
        scene.obstacles,
        scene.room,
        crowd=Crowd(conditions.behaviour, (*moving, *standing[1:])),
    )


def _how_many(conditions: CrowdConditions, room: Room, random: np.random.Generator) -> int:
    if conditions.area_m2 is not None:
        return min(int(room.length * room.width / conditions.area_m2), MOST_PEDESTRIANS - conditions.standing[1])
    return int(random.integers(conditions.moving[0], conditions.moving[1] + 1))


def _moving(
    inside: _Map,
    free: Doubles,
    path: Sequence[tuple[float, float]] | None,
    conditions: CrowdConditions,
    random: np.random.Generator,
) -> Pedestrian:
    """path: the robot's, near which the first one's route begins and ends."""
    speed = _tidy(random.uniform(*conditions.speeds))
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
    random: np.random.Generator,
) -> list[Pedestrian]:
    """Who stands leaves the robot a way of its own width (checked by A*) and stands clear of its goal."""
    free = free[np.linalg.norm(free - ends[1], axis=1) > FROM_START_M / 2]
    found: list[Pedestrian] = []
    for _ in range(TRIES):
        if len(found) == number or not len(free):
            break
        x, y = free[random.integers(len(free))]
        yaw = random.uniform(-math.pi, math.pi)
        more = np.array([(x, y, PED_DEPTH_M / 2, PED_WIDTH_M / 2, math.cos(yaw), math.sin(yaw))])
        trial = np.concatenate([boxes, more])
        around = map_of(room, trial, ROBOT_RADIUS_M + 0.06)
        if around.way(ends[0], ends[1]):
            boxes = trial
            found.append(Pedestrian(((_tidy(x), _tidy(y)),), 0.0, _tidy(yaw)))
    if len(found) < number:
        raise SceneError("crowd", number, "no place to stand that leaves the robot a way")
    return found
