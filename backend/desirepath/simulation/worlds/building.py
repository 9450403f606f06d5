"""A lab's own building: a map of ROS, walls and furniture, or both (`setups.FloorPlan`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from desirepath.simulation import kernels as k
from desirepath.simulation.crowds import planning_kernels as plan_on
from desirepath.simulation.ground_maps import GroundMap, largest_part, load_map
from desirepath.simulation.scene import Person, Pose, Scene, SceneError
from desirepath.simulation.setups import LARGEST_DETOUR, FloorPlan, Setup
from desirepath.simulation.worlds import SceneWorld

CELL_M = 0.1  # of the places that are drawn from
TRIES, PEOPLE_TRIED = 200, 8  # starts with a goal; places of the person between them
AT_ENDS_M, ON_THE_WAY_M, BESIDE_M = 0.15, 0.05, 0.1  # room left, as `scenes.spacing_of`
NEAR_THE_WAY_M = 0.6  # of a person from the way

Bools = NDArray[np.bool_]
Cells = NDArray[np.int64]
Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]


class _Places:
    """Where there is room in a building, on a grid. free: for the robot on its way; roomy: to begin and to end."""

    def __init__(self, setup: Setup, plan: FloorPlan) -> None:
        here = load_map(plan.map) if plan.map else None
        self.ground = here.ground if here else None
        self.sha256 = here.sha256 if here else None
        low, high = _extent(plan, here)
        xs, ys = (np.arange(a + CELL_M / 2, b, CELL_M) for a, b in zip(low, high, strict=True))
        if not len(xs) * len(ys):
            raise SceneError("plan", setup.name, "has no inside: its walls enclose nothing")
        self.places = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1)
        self.low = low
        self.row = _row(Scene(setup.name, 0, Pose(0, 0), Pose(0, 0), 1.0, FAR_AWAY, plan.obstacles))
        robot_m = setup.robot.radius_m
        self.free = largest_part(self._fits(robot_m + ON_THE_WAY_M))
        self.costs = np.where(self.free, 1, np.inf).astype(np.float32)
        self.roomy = np.argwhere(self.free & self._fits(robot_m + AT_ENDS_M))
        self.standing = self._fits(FAR_AWAY.radius + BESIDE_M) & ndimage.binary_dilation(self.free, iterations=5)
        if len(self.roomy) < 2:
            raise SceneError("plan", setup.name, f"leaves a robot of {robot_m:g} m radius no room")

    def _fits(self, radius_m: float) -> Bools:
        free = np.zeros(self.places.shape[:2], dtype=np.bool_)
        k.mark_free(self.row, self.places, radius_m, free, self.ground)
        return free

    def goals_from(self, start: Pose, least_m: float, most_m: float) -> tuple[Cells, Floats]:
        """(n, 2) the roomy cells that far from there, straight, with no long detour on the way; and the field of ways
        to the start, in cells."""
        to_start = plan_on.distances(self.costs, self.cell(start.x, start.y), LARGEST_DETOUR * most_m / CELL_M)
        near = self.roomy[np.isfinite(to_start[self.roomy[:, 0], self.roomy[:, 1]])]
        middles = self.places[near[:, 0], near[:, 1]]
        straight = np.hypot(middles[:, 0] - start.x, middles[:, 1] - start.y)
        way_m = to_start[near[:, 0], near[:, 1]] * CELL_M
        wanted = (straight >= least_m) & (straight <= most_m) & (way_m <= LARGEST_DETOUR * straight)
        return near[wanted], to_start

    def cell(self, x: float, y: float) -> tuple[int, int]:
        i, j = int((x - self.low[0]) / CELL_M), int((y - self.low[1]) / CELL_M)
        return min(max(i, 0), self.free.shape[0] - 1), min(max(j, 0), self.free.shape[1] - 1)

    def way(self, start: Pose, goal: Pose, around: Pose | None = None, gap_m: float = 0.0) -> Doubles:
        """(n, 2) the shortest way on the grid, m; (0, 2) for none, or none but a long detour. It keeps `gap_m` away
        from who stands there, `around`."""
        aside = 5 + int(0.5 * math.dist((start.x, start.y), (goal.x, goal.y)) / CELL_M)
        (i, j), (u, v) = self.cell(start.x, start.y), self.cell(goal.x, goal.y)
        low_i, low_j = max(min(i, u) - aside, 0), max(min(j, v) - aside, 0)
        window = (slice(low_i, max(i, u) + aside), slice(low_j, max(j, v) + aside))
        free = self.free[window].copy()
        if around is not None:
            dx, dy = self.places[window][..., 0] - around.x, self.places[window][..., 1] - around.y
            free &= dx * dx + dy * dy >= gap_m * gap_m
        cells = plan_on.a_star(free, (i - low_i, j - low_j), (u - low_i, v - low_j))
        return self.places[cells[:, 0] + low_i, cells[:, 1] + low_j]


FAR_AWAY = Person(Pose(1e6, 1e6))


def _row(scene: Scene) -> k.Row:
    from desirepath.simulation.scenes import scene_to_row  # which draws from the worlds

    return scene_to_row(scene)


def _extent(plan: FloorPlan, here: GroundMap | None) -> tuple[Doubles, Doubles]:
    """Smallest and largest x and y of the map, else of what stands there."""
    if here is not None:
        return np.asarray(here.origin), np.asarray(here.origin) + here.size_m
    corners = np.array([corner for obstacle in plan.obstacles for corner in obstacle.corners()]).reshape(-1, 2)
    if not len(corners):
        raise SceneError("plan", None, "has neither a map nor walls")
    return corners.min(axis=0), corners.max(axis=0)


@lru_cache(maxsize=8)
def _places(setup: Setup) -> _Places:
    return _Places(setup, setup.plan or FloorPlan())


def draw_in_building(setup: Setup, seed: int) -> Scene:
    """Start, goal and a person near the way between them. Raises SceneError where the building leaves no room."""
    if setup.plan is None:
        raise SceneError("plan", setup.name, "is missing: this world needs a map or walls")
    plan, here = setup.plan, _places(setup)
    random = np.random.Generator(np.random.PCG64([seed, WORLD.number]))
    for _ in range(TRIES):
        start = _pose(plan.starts, here, here.roomy, random)
        goals, to_start = here.goals_from(start, *plan.way_m)
        if not (len(goals) or plan.goals):
            continue
        goal = _pose(plan.goals, here, goals, random)
        straight = math.dist((start.x, start.y), (goal.x, goal.y))
        if not plan.way_m[0] <= straight <= plan.way_m[1]:
            continue
        cells = plan_on.descend(to_start, *here.cell(goal.x, goal.y), to_start.size)
        way = here.places[cells[:, 0], cells[:, 1]][::-1]
        if to_start[here.cell(goal.x, goal.y)] * CELL_M > LARGEST_DETOUR * straight:
            continue
        for _ in range(PEOPLE_TRIED):
            stand = _person(plan.people, here, way, random)
            if stand is None:
                continue
            scene = Scene(
                setup.name, seed, start, goal, setup.goal_radius_m, Person(stand), plan.obstacles, ground=here.sha256
            )
            if _fits(scene, here, setup.robot.radius_m):
                return scene
    raise SceneError("seed", seed, f"gave no {setup.name} scene; name starts, goals and people, or make way_m wider")


def _pose(named: Sequence[Pose], here: _Places, free: Cells, random: np.random.Generator) -> Pose:
    """One of the named poses, else anywhere in the cells `free` (n, 2), looking anywhere."""
    if named:
        return named[int(random.integers(len(named)))]
    i, j = free[random.integers(len(free))]
    x, y = here.places[i, j] + random.uniform(-CELL_M / 2, CELL_M / 2, 2)
    return Pose(_tidy(x), _tidy(y), _tidy(random.uniform(-math.pi, math.pi)))


def _person(named: Sequence[Pose], here: _Places, way: Doubles, random: np.random.Generator) -> Pose | None:
    """One of the named poses, else between 0.3 and 0.7 of the way, somewhere near it; None where there is no room."""
    if named:
        return named[int(random.integers(len(named)))]
    x, y = way[int(random.uniform(0.3, 0.7) * len(way))] + random.uniform(-NEAR_THE_WAY_M, NEAR_THE_WAY_M, 2)
    if not here.standing[here.cell(x, y)]:
        return None
    return Pose(_tidy(x), _tidy(y), _tidy(random.uniform(-math.pi, math.pi)))


def _fits(scene: Scene, here: _Places, robot_m: float) -> bool:
    """Whether start, goal and person leave each other room, and the robot a way past the person."""
    row, person = _row(scene), scene.person
    for pose in (scene.start, scene.goal):
        if k.person_distance(row, pose.x, pose.y) < robot_m + person.radius + AT_ENDS_M:
            return False
        if k.surface_distance(row, pose.x, pose.y, here.ground) < robot_m + AT_ENDS_M:
            return False
    if k.surface_distance(row, person.pose.x, person.pose.y, here.ground) < person.radius:
        return False
    around = here.way(scene.start, scene.goal, person.pose, robot_m + person.radius + ON_THE_WAY_M)
    return not _is_detour(around, math.dist((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y)))


def _is_detour(way: Doubles, straight_m: float) -> bool:
    """Whether a way is longer than is asked of who is told only where the goal is; no way is, too."""
    return len(way) < 2 or float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) > LARGEST_DETOUR * straight_m


def _tidy(value: float) -> float:
    return round(float(value), 6)


WORLD = SceneWorld(10, draw_in_building)
