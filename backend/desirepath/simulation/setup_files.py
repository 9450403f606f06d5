"""Reading `setup.yaml`: what it may say, and what is wrong with one, by line and field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from desirepath.grammar.error_words import meant, parse
from desirepath.grammar.parts import FileName, Part, Slug
from desirepath.grammar.source import Problem, ProtocolError, Source, file_text
from desirepath.installed import DATASETS
from desirepath.simulation.ground_maps import LARGEST_M, load_map
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import OBSTACLE_KINDS, Obstacle, Pose
from desirepath.simulation.setup_parts import ConditioningSettings, DemonstrationSettings, PreferenceSettings
from desirepath.simulation.setups import (
    CONTROL_DT_S,
    LARGEST_DETOUR,
    SETUP_FILE,
    CoreReward,
    FloorPlan,
    NearPenalty,
    Robot,
    Setup,
    SetupError,
    require_plain,
)
from desirepath.simulation.worlds import WORLDS

Metres = Annotated[float, Field(ge=-1_000, le=1_000)]
Side = Annotated[float, Field(gt=0, le=1_000)]
WATCHED_S = 14.0  # of a straight way: with people in it, twenty seconds to watch
FORESEEN_M = 5.0  # the open field's


class Place(Part):
    """A place in the building's frame, metres and radians."""

    x: Metres
    y: Metres
    yaw: float = Field(0.0, ge=-7, le=7)

    def pose(self) -> Pose:
        return Pose(self.x, self.y, self.yaw)


class Furniture(Place):
    """A box on the floor: length along its own x axis, width along y, metres."""

    kind: Literal[OBSTACLE_KINDS]  # type: ignore[valid-type]
    length: Side
    width: Side
    height: Side


class Building(Part):
    """A lab's own building. map: a `map.yaml` of ROS; walls: x1, y1, x2, y2 of each one's middle line; starts, goals,
    people: where they may be, anywhere with room if none are named; way_m: how far goals are from starts, straight."""

    map: FileName | None = None
    walls: list[Annotated[list[Metres], Field(min_length=4, max_length=4)]] = Field([], max_length=300)
    wall_thickness_m: Side = 0.1
    wall_height_m: Side = 2.0
    furniture: list[Furniture] = Field([], max_length=100)
    starts: list[Place] = Field([], max_length=1_000)
    goals: list[Place] = Field([], max_length=1_000)
    people: list[Place] = Field([], max_length=1_000)
    way_m: Annotated[list[Side], Field(min_length=2, max_length=2)] | None = None

    def plan(self, folder: Path, robot: Robot) -> FloorPlan:
        walls = [_wall(wall, self.wall_thickness_m, self.wall_height_m) for wall in self.walls]
        pieces = [Obstacle(one.kind, one.pose(), one.length, one.width, one.height) for one in self.furniture]
        starts, goals, people = (
            tuple(place.pose() for place in named) for named in (self.starts, self.goals, self.people)
        )
        place = (folder / self.map.replace("\0", "/")).resolve() if self.map else None
        way_m = (self.way_m[0], self.way_m[1]) if self.way_m else usual_way_m(robot)
        return FloorPlan(place, (*walls, *pieces), starts, goals, people, way_m)


def usual_way_m(robot: Robot) -> tuple[float, float]:
    """How far goals are from starts where nobody says it: what the robot does while somebody watches, and in any case
    far enough for a person to stand between."""
    longest = min(max(WATCHED_S * robot.limits.v_max, 3.0), 8.0) + 2 * robot.radius_m
    return 1.5 + robot.radius_m, round(longest, 2)


def _wall(line: Sequence[float], thickness_m: float, height_m: float) -> Obstacle:
    """The wall along a line, as much longer at both ends as it is thick by half: walls that meet leave no gap."""
    x1, y1, x2, y2 = line
    middle = Pose((x1 + x2) / 2, (y1 + y2) / 2, math.atan2(y2 - y1, x2 - x1))
    return Obstacle("wall", middle, math.dist((x1, y1), (x2, y2)) + thickness_m, thickness_m, height_m)


def _extent_m(plan: FloorPlan) -> float:
    """How far (m) its walls and furniture reach along x or y."""
    corners = [corner for obstacle in plan.obstacles for corner in obstacle.corners()]
    return max((max(axis) - min(axis) for axis in zip(*corners, strict=True)), default=0.0)


class World(Part):
    """Where scenes come from. people: who walks in them beside the person; without it nobody does. building: a lab's
    own, for the world of that name."""

    name: Slug
    people: CrowdConditions | None = None
    building: Building | None = None


class Observation(Part):
    """What a policy is told, besides the goal; `Setup` says in which order. person: where the person is; velocity: its
    own; solids: so many walls and obstacles instead of a lidar scan; pedestrians: of so many nearest ones how they
    move; path_points: places of the path ahead; extractors: networks read lidar and the rest by one each.
    """

    person: bool
    velocity: bool
    solids: int = Field(0, ge=0, le=64)
    pedestrians: int = Field(0, ge=0, le=20)
    path_points: int = Field(0, ge=0, le=5)
    distance_scale_m: float = Field(10.0, gt=0, le=1_000)
    extractors: bool = True


class Task(Part):
    """What the robot is for: its reward, when a goal is reached, how many steps of 0.2 s it has, its discount. What is
    not said is the study room's, sized to how fast and large the robot is."""

    reward: CoreReward = CoreReward(20.0, -20.0, -1.0, -2.0, -0.001)
    near: NearPenalty | None = None
    goal_radius_m: Annotated[float, Field(gt=0, le=10)] | None = None
    max_steps: Annotated[int, Field(ge=1, le=10_000)] | None = None
    gamma: Annotated[float, Field(gt=0, le=1)] | None = None
    observation: Observation = Observation(person=True, velocity=True)

    def goal_of(self, robot: Robot) -> float:
        """Radius (m) of the goal."""
        return self.goal_radius_m or max(0.3, round(1.2 * robot.radius_m, 2))

    def steps_of(self, robot: Robot, plan: FloorPlan | None) -> int:
        """The most steps: thrice the longest way at full speed, with the detour that it may have."""
        longest_m = LARGEST_DETOUR * (plan.way_m[1] if plan else 8.0)
        usual = round(3 * longest_m / robot.limits.v_max / CONTROL_DT_S)
        return self.max_steps or min(max(usual, 300), 3_000)

    def discount_of(self, robot: Robot) -> float:
        """The discount whose horizon is FORESEEN_M of driving."""
        usual = round(1 - robot.limits.v_max * CONTROL_DT_S / FORESEEN_M, 4)
        return self.gamma or min(max(usual, 0.98), 0.997)


class SetupFile(Part):
    """A whole `setup.yaml`. robot: its description, the name of a shipped one, or that of a file in the same folder.
    What it does not say of preferences and conditioning is computed where it is needed; paths are drawn where it says
    `demonstrations`."""

    robot: Robot
    world: World
    task: Task = Task()
    preferences: PreferenceSettings = PreferenceSettings()
    conditioning: ConditioningSettings | None = None
    demonstrations: DemonstrationSettings | None = None


class RobotFile(Part):
    """A `robot.yaml`."""

    robot: Robot


def shipped_robots() -> dict[str, Path]:
    """Name -> file of the robots that are shipped."""
    return {file.stem: file for file in sorted((DATASETS / "robots").glob("*.yaml"))}


def read_robot(path: Path) -> Robot:
    """The robot in a `robot.yaml`. Raises ProtocolError with every problem, by line and field."""
    source = Source(str(path), file_text(path))
    _find_urdf(source, path.resolve().parent)
    return parse(source, RobotFile).robot


def _find_urdf(source: Source, folder: Path) -> None:
    """Put where it is in the place of the name of the robot's URDF. Raises ProtocolError for one that is not beside."""
    named = source.value(("robot", "urdf"))
    if not isinstance(named, str):
        return
    path = folder / named.replace("\0", "/")  # which is no file's name
    if path.resolve().parent != folder or not path.is_file():
        raise ProtocolError([source.problem(("robot", "urdf"), "must be the name of a file in the same folder")])
    source.data["robot"]["urdf"] = str(path)


def _fill_in_robot(source: Source, folder: Path) -> None:
    """Put the description of the robot in the place of its name. Raises ProtocolError for one that cannot be read."""
    named = source.value(("robot",))
    if not isinstance(named, str):
        _find_urdf(source, folder.resolve())
        return
    shipped = shipped_robots()
    path = shipped.get(named, folder / named)
    if (path.parent != folder and named not in shipped) or not path.is_file():
        problem = f"is no file in this folder and no shipped robot, {', '.join(shipped)}{meant(named, list(shipped))}"
        raise ProtocolError([source.problem(("robot",), problem)])
    described = Source(str(path), file_text(path))
    _find_urdf(described, path.resolve().parent)
    parse(described, RobotFile)
    source.data["robot"] = described.data["robot"]


def check_setup(folder: Path) -> Setup:
    """The setup in that folder, whose name it bears. Raises ProtocolError with every problem, by line and field."""
    path = folder / SETUP_FILE
    source = Source(str(path), file_text(path))
    _fill_in_robot(source, folder)
    found = parse(source, SetupFile)
    task, observed, known = found.task, found.task.observation, list(WORLDS)
    problems: list[Problem] = []
    if found.world.name not in known:
        problem = f"no such world; one of {', '.join(known)}{meant(found.world.name, known)}"
        problems.append(source.problem(("world", "name"), problem))
    if observed.pedestrians and found.world.people is None:
        where = ("task", "observation", "pedestrians")
        problems.append(source.problem(where, "must be 0, or world.people say who walks"))
    building = found.world.building
    if (found.world.name == "building") != (building is not None):
        problem = "must be there for the world `building`, and for no other"
        problems.append(source.problem(("world", "building"), problem))
    plan = building.plan(folder, found.robot) if building else None
    if plan and not plan.way_m[0] < plan.way_m[1]:
        problems.append(source.problem(("world", "building", "way_m"), "must be two lengths, the shorter one first"))
    if plan and (size := _extent_m(plan)) > LARGEST_M:
        problem = f"reaches over {size:,.0f} m; at most {LARGEST_M:g} m are plausible"
        problems.append(source.problem(("world", "building"), problem))
    if plan and plan.map:
        if plan.map.parent != folder.resolve():
            problems.append(source.problem(("world", "building", "map"), "must be the name of a file in this folder"))
        else:
            try:
                load_map(plan.map)
            except ProtocolError as wrong:
                problems += wrong.problems
    if problems:
        raise ProtocolError(problems)
    setup = Setup(
        name=folder.name,
        robot=found.robot,
        world=found.world.name,
        people=found.world.people,
        plan=plan,
        reward=task.reward,
        near=task.near,
        goal_radius_m=task.goal_of(found.robot),
        max_steps=task.steps_of(found.robot, plan),
        gamma=task.discount_of(found.robot),
        with_person=observed.person,
        with_velocity=observed.velocity,
        solids=observed.solids,
        pedestrians=observed.pedestrians,
        path_points=observed.path_points,
        distance_scale_m=observed.distance_scale_m,
        extractors=observed.extractors,
        preferences=found.preferences,
        conditioning=found.conditioning or ConditioningSettings(recovery=plan is not None),
        demonstrations=found.demonstrations,
    )
    if setup.crowded:
        try:
            require_plain(setup, "the engine of pedestrians")
        except SetupError as wrong:
            raise ProtocolError([source.problem(("world", "people"), str(wrong))]) from None
    return setup


def read_setup(folder: Path) -> Setup:
    """As `check_setup`. Raises SetupError."""
    try:
        return check_setup(folder)
    except ProtocolError as wrong:
        raise SetupError(str(wrong)) from None
