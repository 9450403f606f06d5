"""Drawing scenes from a seed, checking scenes, and turning them into the number rows that the engines drive on.

What a scene is stands in `scene.py`; the compiled geometry in `kernels.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.ground_maps import GroundMap, load_map
from desirepath.simulation.known_world import SeenScene
from desirepath.simulation.scene import OBSTACLE_KINDS, Obstacle, Person, Pose, Room, Scene, SceneError
from desirepath.simulation.setups import SETUPS, Setup
from desirepath.simulation.worlds import WORLDS, RowWorld, SceneWorld

LARGEST_SEED = 2**53 - 1  # stays exact in JSON and JavaScript
OVERLAP_TOLERANCE_M = 1e-6  # drawn coordinates are rounded to this
FIRST_UNIFORMS = 1024
MOST_UNIFORMS = 2**20
MOST_SLOW = 4_096  # scenes of a `SceneWorld` in a pool: they take milliseconds to draw


def spacing_of(setup: Setup) -> k.Spacing:
    """How much room drawn scenes leave. Ours: the thesis only says "avoiding already occupied poses"."""
    return k.Spacing(
        robot_radius=setup.robot.radius_m, spare_at_ends=0.15, gap_between_bodies=0.10, spare_on_the_way=0.05
    )


def _setup(setup: str | Setup) -> Setup:
    if isinstance(setup, Setup):
        return setup
    found = SETUPS.get(setup)
    if found is None:
        raise SceneError("setup", setup, f"unknown; known: {', '.join(SETUPS)}")
    return found


def map_of(setup: str | Setup) -> GroundMap | None:
    """The map that a setup's scenes lie in. Raises ProtocolError for one that cannot be read."""
    plan = _setup(setup).plan
    return load_map(plan.map) if plan and plan.map else None


def own_map(scene: Scene, setup: Setup | None = None) -> GroundMap | None:
    """The map that a scene lies in. Raises SceneError where its setup has another one by now."""
    if isinstance(scene, SeenScene):
        return scene.seen
    if scene.ground is None:
        return None
    here = map_of(setup or scene.setup)
    if here is None or here.sha256 != scene.ground:
        raise SceneError("ground", scene.ground[:12], f"is not the map that setup {scene.setup} has now")
    return here


def ground_of(scene: Scene, setup: Setup | None = None) -> k.Ground | None:
    """What the compiled functions need of the map that a scene lies in. Raises SceneError where its setup has another
    one by now."""
    here = own_map(scene, setup)
    return here.ground if here else None


def walls_of(scene: Scene) -> NDArray[np.float64]:
    """(n, 4) what is occupied in the map that a scene lies in, as rectangles: smallest x and y, largest x and y (m)."""
    here = own_map(scene)
    return here.walls if here else np.zeros((0, 4))


def solids_near(scene: Scene, within_m: float) -> tuple[Obstacle, ...]:
    """Everything box-shaped that stops a robot or a ray; what a map has only that near (m) to start, goal and person,
    or between them."""
    places = [scene.start, scene.goal, *((scene.person.pose,) if scene.has_person else ())]
    points = np.array([(place.x, place.y) for place in places])
    low, high = points.min(axis=0) - within_m, points.max(axis=0) + within_m
    near = (one for one in walls_of(scene) if (one[:2] <= high).all() and (one[2:] >= low).all())
    return scene.solids() + tuple(
        Obstacle("wall", Pose((x1 + x2) / 2, (y1 + y2) / 2), x2 - x1, y2 - y1, Room.wall_height)
        for x1, y1, x2, y2 in (map(float, one) for one in near)
    )


def extent_m(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Smallest and largest x and y (m) of where a scene's robot may be: within its room, its map or the walls of its
    building; None in the open."""
    if scene.room is not None:
        half = np.array([scene.room.length, scene.room.width]) / 2
        return -half, half
    here = own_map(scene)
    if here is not None:
        return np.array(here.origin), np.array(here.origin) + here.size_m
    corners = [corner for obstacle in scene.obstacles if obstacle.kind == "wall" for corner in obstacle.corners()]
    return (np.min(corners, axis=0), np.max(corners, axis=0)) if corners else None


@lru_cache(maxsize=2 * MOST_SLOW)
def _drawn(world: SceneWorld, setup: Setup, seed: int) -> Scene:
    """One of its scenes, of which a row does not tell everything."""
    return world.draw(setup, seed)


def _check_seed(seed: int) -> None:
    if not 0 <= seed <= LARGEST_SEED:
        raise SceneError("seed", seed, f"must lie in 0..{LARGEST_SEED}")


def row_columns(boxes: int = 8) -> int:
    """Width of a scene row with places for that many boxes."""
    return k.FIRST_BOX + k.BOX_COLUMNS * boxes


def columns_of(setup: str | Setup) -> int:
    """Width of the rows that are drawn for the setup."""
    setup = _setup(setup)
    world, own = WORLDS[setup.world], len(setup.plan.obstacles) if setup.plan else 0
    return row_columns(max(8, len(world.kinds) if isinstance(world, RowWorld) else max(world.boxes, own)))


def draw_rows(setup: str | Setup, seeds: Sequence[int] | NDArray[np.int64]) -> k.Rows:
    """Draw one scene row per seed: (seeds, columns) float64. The same numbers as `draw_scene`, without the objects."""
    setup = _setup(setup)
    world, spacing = WORLDS[setup.world], spacing_of(setup)
    if isinstance(world, SceneWorld):
        return _rows_of_scenes(world, setup, seeds)
    number, draw = world.number, world.draw
    rows = np.zeros((len(seeds), columns_of(setup)))
    rows[:, k.GOAL_RADIUS], rows[:, k.PERSON_RADIUS] = setup.goal_radius_m, Person(Pose(0.0, 0.0)).radius
    for row, seed in zip(rows, seeds, strict=True):
        _check_seed(int(seed))
        size = FIRST_UNIFORMS
        # A longer draw from the same seed begins with the same numbers, so retrying changes nothing but the supply.
        while not draw(np.random.Generator(np.random.PCG64([int(seed), number])).random(size), row, spacing):
            size *= 4
            if size > MOST_UNIFORMS:
                raise SceneError("seed", int(seed), f"gave no solvable {setup.name} scene; use another seed")
    return rows


def _rows_of_scenes(world: SceneWorld, setup: Setup, seeds: Sequence[int] | NDArray[np.int64]) -> k.Rows:
    """Rows of the scenes, without their pedestrians."""
    rows = np.zeros((len(seeds), columns_of(setup)))
    for row, seed in zip(rows, seeds, strict=True):
        _check_seed(int(seed))
        row[:] = scene_to_row(_drawn(world, setup, int(seed)), len(row))
    return rows


def row_to_scene(setup: str | Setup, seed: int, row: k.Row) -> Scene:
    """The scene that `draw_rows` drew from that seed."""
    setup = _setup(setup)
    world = WORLDS[setup.world]
    if isinstance(world, SceneWorld):
        return _drawn(world, setup, int(seed))
    values = [float(value) for value in row]
    obstacles = []
    for box, kind in enumerate(world.kinds):
        o = k.FIRST_BOX + k.BOX_COLUMNS * box
        obstacles.append(
            Obstacle(
                kind,
                Pose(values[o + k.BOX_X], values[o + k.BOX_Y], values[o + k.BOX_YAW]),
                length=2 * values[o + k.BOX_HALF_LENGTH],
                width=2 * values[o + k.BOX_HALF_WIDTH],
                height=values[o + k.BOX_HEIGHT],
            )
        )
    half_x, half_y = values[k.ROOM_HALF_X], values[k.ROOM_HALF_Y]
    return Scene(
        setup=setup.name,
        seed=int(seed),
        start=Pose(values[k.START_X], values[k.START_Y], values[k.START_YAW]),
        goal=Pose(values[k.GOAL_X], values[k.GOAL_Y], values[k.GOAL_YAW]),
        goal_radius=values[k.GOAL_RADIUS],
        person=Person(
            Pose(values[k.PERSON_X], values[k.PERSON_Y], values[k.PERSON_YAW]), radius=values[k.PERSON_RADIUS]
        ),
        obstacles=tuple(obstacles),
        room=Room(2 * half_x, 2 * half_y) if half_x > 0 else None,
    )


def scene_to_row(scene: Scene, columns: int | None = None) -> k.Row:
    """The scene as a row of `columns` numbers (default: as many as it needs, at least those of a drawn scene).

    A scene that was drawn gives back exactly its row. Nothing is checked here; `check_scene` does that.
    """
    row = np.zeros(columns or row_columns(max(8, len(scene.obstacles))))
    row[k.START_X], row[k.START_Y], row[k.START_YAW] = scene.start.x, scene.start.y, scene.start.yaw
    row[k.GOAL_X], row[k.GOAL_Y], row[k.GOAL_YAW] = scene.goal.x, scene.goal.y, scene.goal.yaw
    row[k.GOAL_RADIUS] = scene.goal_radius
    if scene.has_person:
        person = scene.person
        row[k.PERSON_X], row[k.PERSON_Y], row[k.PERSON_YAW] = person.pose.x, person.pose.y, person.pose.yaw
        row[k.PERSON_RADIUS] = person.radius
    else:
        row[[k.PERSON_X, k.PERSON_Y, k.PERSON_YAW, k.PERSON_RADIUS]] = np.nan  # nearer to nothing than anything is
    if scene.room is not None:
        row[k.ROOM_HALF_X], row[k.ROOM_HALF_Y] = scene.room.length / 2, scene.room.width / 2
    row[k.BOX_COUNT] = len(scene.obstacles)
    for box, obstacle in enumerate(scene.obstacles):
        o = k.FIRST_BOX + k.BOX_COLUMNS * box
        row[o + k.BOX_X], row[o + k.BOX_Y], row[o + k.BOX_YAW] = obstacle.pose.x, obstacle.pose.y, obstacle.pose.yaw
        row[o + k.BOX_HALF_LENGTH], row[o + k.BOX_HALF_WIDTH] = obstacle.length / 2, obstacle.width / 2
        row[o + k.BOX_HEIGHT] = obstacle.height
    k.finish_row(row)
    return row


def scenes_to_rows(scenes: Sequence[Scene]) -> k.Rows:
    """Scenes as rows of one width: (scenes, columns) float64."""
    columns = row_columns(max([8] + [len(scene.obstacles) for scene in scenes]))
    return np.stack([scene_to_row(scene, columns) for scene in scenes]) if scenes else np.zeros((0, columns))


def draw_scene(setup: str | Setup, seed: int) -> Scene:
    """The scene of that setup and seed: valid, solvable, and the same on every machine.

    Raises SceneError for an unknown setup or a seed outside 0..LARGEST_SEED.
    """
    return row_to_scene(setup, seed, draw_rows(setup, [seed])[0])


def draw_scenes(setup: str | Setup, seeds: Sequence[int] | range) -> list[Scene]:
    """`draw_scene` for many seeds."""
    return [row_to_scene(setup, seed, row) for seed, row in zip(seeds, draw_rows(setup, list(seeds)), strict=True)]


class ScenePool:
    """Start scenes for training: drawn when needed, each from a seed of its own, repeated in new orders once full.

    The seeds lie above 2^32, so small seeds chosen by hand (evaluation) never meet a training scene.
    """

    SIZE = 16_384
    BLOCK = 256
    SLOW_BLOCK = 16

    def __init__(self, setup: str | Setup, seed: int) -> None:
        self.setup = _setup(setup)
        _check_seed(seed)
        world = WORLDS[self.setup.world]
        slow = isinstance(world, SceneWorld)
        self._generator = np.random.Generator(np.random.PCG64([seed, world.number, 0x9001]))
        self._size = min(self.SIZE, MOST_SLOW) if slow else self.SIZE
        self._block = self.SLOW_BLOCK if slow else self.BLOCK
        self._seeds = self._generator.integers(2**32, LARGEST_SEED, self._size)
        self._rows = np.zeros((self._size, columns_of(self.setup)))
        self._drawn = 0
        self._order = self._endless_order()

    def _endless_order(self) -> Iterator[int]:
        yield from range(self._size)
        while True:
            yield from (int(i) for i in self._generator.permutation(self._size))

    def take(self, count: int) -> tuple[k.Rows, NDArray[np.int64]]:
        """The next scenes: rows (count, columns) and their seeds (count,)."""
        chosen = np.fromiter(self._order, dtype=np.int64, count=count)
        needed = int(chosen.max(initial=-1)) + 1
        while self._drawn < min(needed, self._size):  # few for whoever asks for one scene, blocks for trainings
            end = self._drawn + min(self._block, max(needed - self._drawn, self._drawn))
            self._rows[self._drawn : end] = draw_rows(self.setup, self._seeds[self._drawn : end])
            self._drawn = min(end, self._size)
        return self._rows[chosen], self._seeds[chosen]


def _check_numbers(scene: Scene) -> None:
    poses = {"start": scene.start, "goal": scene.goal, "person.pose": scene.person.pose}
    poses |= {f"obstacles[{i}].pose": obstacle.pose for i, obstacle in enumerate(scene.obstacles)}
    for name, pose in poses.items():
        for part in ("x", "y", "yaw"):
            value = getattr(pose, part)
            if not math.isfinite(value):
                raise SceneError(f"{name}.{part}", value, "must be a finite number")
    sizes: dict[str, float] = {
        "goal_radius": scene.goal_radius,
        "person.radius": scene.person.radius,
        "person.height": scene.person.height,
    }
    for i, obstacle in enumerate(scene.obstacles):
        if obstacle.kind not in OBSTACLE_KINDS:
            raise SceneError(f"obstacles[{i}].kind", obstacle.kind, f"unknown; known: {', '.join(OBSTACLE_KINDS)}")
        sizes |= {f"obstacles[{i}].{part}": getattr(obstacle, part) for part in ("length", "width", "height")}
    if scene.room is not None:
        sizes |= {
            f"room.{part}": getattr(scene.room, part) for part in ("length", "width", "wall_height", "wall_thickness")
        }
    for name, value in sizes.items():
        if not (math.isfinite(value) and value > 0):
            raise SceneError(name, value, "must be a finite number above 0 m")


def _check_bodies(scene: Scene, row: k.Row, robot_m: float, ground: k.Ground | None) -> None:
    columns = [k.FIRST_BOX + k.BOX_COLUMNS * i for i in range(len(scene.obstacles))]
    person = scene.person
    for i, o in enumerate(columns):
        where = scene.obstacles[i].pose
        if k.nearest_wall_gap(row, i) < -OVERLAP_TOLERANCE_M:
            raise SceneError(f"obstacles[{i}].pose", where, "reaches into a wall; move it into the room")
        for j in range(i):
            both_walls = scene.obstacles[i].kind == scene.obstacles[j].kind == "wall"  # which meet at corners
            if not both_walls and k.boxes_gap(row, o, columns[j]) < -OVERLAP_TOLERANCE_M:
                raise SceneError(f"obstacles[{i}].pose", where, f"overlaps obstacles[{j}]; move them apart")
        if k.box_distance(row, o, person.pose.x, person.pose.y) < person.radius - OVERLAP_TOLERANCE_M:
            raise SceneError("person.pose", person.pose, f"overlaps obstacles[{i}]; move them apart")
    if k.nearest_wall_gap(row, len(columns)) < -OVERLAP_TOLERANCE_M:
        raise SceneError("person.pose", person.pose, "stands in a wall or outside the room")
    at_ground = math.inf if ground is None else k.ground_distance(ground, person.pose.x, person.pose.y)
    if at_ground < person.radius - OVERLAP_TOLERANCE_M:
        raise SceneError("person.pose", person.pose, "stands where the map is occupied or unknown")
    for name, pose in (("start", scene.start), ("goal", scene.goal)):
        for i, o in enumerate(columns):
            if k.box_distance(row, o, pose.x, pose.y) < robot_m:
                raise SceneError(name, pose, f"the robot would touch obstacles[{i}]")
        if k.surface_distance(row, pose.x, pose.y, ground) < robot_m:
            raise SceneError(name, pose, "the robot would touch a wall or be outside the room")
        if k.person_distance(row, pose.x, pose.y) < robot_m + person.radius:
            raise SceneError(name, pose, "the robot would touch the person")


def _check_walk(scene: Scene) -> None:
    if scene.walk is None:
        return
    begin, person = scene.walk.poses_at([0.0])[0], scene.person.pose
    if math.dist(begin[:2], (person.x, person.y)) > OVERLAP_TOLERANCE_M:
        raise SceneError("walk", begin.tolist(), f"must begin at person.pose {person}")


def check_scene(scene: Scene, setup: Setup | None = None) -> None:
    """Raise SceneError naming field and value for a scene that cannot be run; return quietly otherwise. setup: the
    scene's, for whoever has it: it may be none of the known ones, and looking for one asks the disk."""
    setup = setup or _setup(scene.setup)
    if scene.crowd is not None and not setup.crowded:
        raise SceneError("crowd", len(scene.crowd.pedestrians), f"no pedestrians walk in setup {setup.name}")
    if scene.crowd is None and setup.crowded:
        raise SceneError("crowd", None, f"is missing: pedestrians walk in setup {setup.name}")
    if scene.ground is None and setup.plan is not None and setup.plan.map is not None:
        raise SceneError("ground", None, f"is missing: setup {setup.name} lies in a map")
    _check_seed(scene.seed)
    _check_numbers(scene)
    heights = {f"obstacles[{i}].height": obstacle.height for i, obstacle in enumerate(scene.obstacles)}
    heights["person.height"] = scene.person.height
    if scene.room is not None:
        heights["room.wall_height"] = scene.room.wall_height
    for name, height in heights.items():
        if height <= setup.robot.lidar.height_m:
            raise SceneError(name, height, f"must exceed the lidar's {setup.robot.lidar.height_m} m")
    row, ground = scene_to_row(scene), ground_of(scene, setup)
    _check_bodies(scene, row, setup.robot.radius_m, ground)
    _check_walk(scene)
    if math.dist((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y)) <= scene.goal_radius:
        raise SceneError("goal", scene.goal, f"lies within goal_radius {scene.goal_radius} m of the start")
    if not k.reachable(row, setup.robot.radius_m, ground):
        problem = f"cannot be reached from the start by a robot of {setup.robot.radius_m:g} m radius"
        raise SceneError("goal", scene.goal, problem)
