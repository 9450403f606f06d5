"""The setups: a robot, a world that its scenes come from, and a task (reward, goal, time, observation) that belong
together. Each is one file `setup.yaml` in a folder of its name, read by `setup_files.py`.

A policy, buffer or query set belongs to exactly one setup; `require_same` refuses a mix.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field

from desirepath.installed import DATASETS
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import Obstacle, Pose
from desirepath.simulation.setup_parts import ConditioningSettings, DemonstrationSettings, PreferenceSettings

CONTROL_DT_S = 0.2  # 5 Hz everywhere
SETUP_FILE = "setup.yaml"
FOLDERS_VARIABLE = "DESIREPATH_SETUPS"
DATA_VARIABLE = "DESIREPATH_DATA"
UPLOADED = "setups"
"""Folder in an installation's data of the setups that somebody brought to it."""
"""Environment variable: folders, separated as in PATH, whose folders are setups."""
ENTRY_POINTS = "desirepath.setups"
"""Group of entry points of other packages. Each is the folder of one setup, or a function that returns it."""

MOST_BEAMS = 28_800  # of a turn
LARGEST_DETOUR = 1.3  # of the way around corners to the straight one: who is told only where the goal is gets there
LOOSE_TURN = 1e-3  # share of a turn that its sectors may overlap or leave out: 4.712 rad is 270 degrees
_STRICT = ConfigDict(extra="forbid")
NAME = re.compile("[a-z][a-z0-9_]{0,59}")
Length = Annotated[float, Field(gt=0, le=1_000)]  # m
Speed = Annotated[float, Field(ge=0, le=100)]  # m/s or rad/s
Offset = Annotated[float, Field(ge=-5, le=5)]  # m
Corner = tuple[Offset, Offset]


class SetupError(ValueError):
    """An unknown setup, one that cannot be read, or things of two setups mixed."""


@dataclass(frozen=True)
class Limits:
    """Robot command limits: v in [v_min, v_max] m/s, w in [-w_max, w_max] rad/s. Never backwards. v_change, w_change:
    the most that speeds change in a second, m/s^2 and rad/s^2; None: as quick as commanded."""

    v_min: Speed
    v_max: Speed
    w_max: Speed
    v_change: Length | None = None
    w_change: Length | None = None

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if not self.v_min < self.v_max:
            raise SetupError(f"v_max = {self.v_max:g}: must be above v_min, {self.v_min:g} m/s")
        if not self.w_max > 0:
            raise SetupError(f"w_max = {self.w_max:g}: must be above 0 rad/s")


@dataclass(frozen=True)
class Lidar:
    """`beams` rays in the order of `bearings`, pooled by minimum into `sectors`. field_of_view_rad: all round, or half
    to either side of straight ahead; x_m, y_m, yaw_rad: where it is mounted, in the robot's frame.

    What it gets wrong, beam by beam, before pooling: noise_m: standard deviation of a range; drop_out: share of beams
    that see nothing; min_range_m: what is nearer is not seen. rate_hz: scans a second, where they are fewer than
    commands: those between two scans are given by the last one."""

    beams: Annotated[int, Field(ge=1, le=7_200)]
    sectors: Annotated[int, Field(ge=1, le=7_200)]
    range_m: Length
    height_m: Length
    field_of_view_rad: Annotated[float, Field(gt=0, le=2 * math.pi + 1e-6)] = 2 * math.pi
    x_m: Offset = 0.0
    y_m: Offset = 0.0
    yaw_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    noise_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    drop_out: Annotated[float, Field(ge=0, lt=1)] = 0.0
    min_range_m: Annotated[float, Field(ge=0, le=10)] = 0.0
    rate_hz: Annotated[float, Field(ge=0.1, le=1_000)] | None = None

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if self.min_range_m >= self.range_m:
            raise SetupError(f"min_range_m = {self.min_range_m:g}: must be below range_m, {self.range_m:g} m")
        if self.beams % self.sectors or not self._is_part_of_a_turn(self.sectors):
            degrees = (
                f", be even, and fill {math.degrees(self.field_of_view_rad):g} degrees as a whole number would a turn"
            )
            must = f"must divide the {self.beams} beams{'' if self.all_round else degrees}"
            raise SetupError(f"sectors = {self.sectors}: {must}; what works: {self._near_ones()}")
        if self.beams_of_a_turn > MOST_BEAMS:
            raise SetupError(f"beams = {self.beams}: a whole turn of them must have at most {MOST_BEAMS:,}")

    def _is_part_of_a_turn(self, sectors: int) -> bool:
        whole = sectors * 2 * math.pi / self.field_of_view_rad
        return self.all_round or (sectors % 2 == 0 and abs(whole - round(whole)) <= whole * LOOSE_TURN)

    def _near_ones(self) -> str:
        """The three numbers of sectors nearest to ours that work, each with the nearest number of beams."""
        numbers = [number for number in range(1, min(self.beams, 400) + 1) if self._is_part_of_a_turn(number)]
        near = sorted(numbers, key=lambda number: (self.beams % number > 0, abs(number - self.sectors)))[:3]
        return (
            ", ".join(f"{number} sectors of {round(self.beams / number) * number} beams" for number in near)
            or "more beams"
        )

    @property
    def all_round(self) -> bool:
        return self.field_of_view_rad > 2 * math.pi - 1e-3

    @property
    def steps_per_scan(self) -> float:
        """How many commands are given by one scan, 1 where it is as quick as they are."""
        return max(1.0, 1 / (CONTROL_DT_S * self.rate_hz)) if self.rate_hz else 1.0

    @property
    def exact(self) -> bool:
        """Whether every command has a scan without errors."""
        return self.noise_m == self.drop_out == self.min_range_m == 0.0 and self.steps_per_scan == 1.0

    @property
    def sectors_of_a_turn(self) -> int:
        """How many sectors of this size a whole turn has."""
        return self.sectors if self.all_round else round(self.sectors * 2 * math.pi / self.field_of_view_rad)

    @property
    def beams_of_a_turn(self) -> int:
        return self.beams // self.sectors * self.sectors_of_a_turn

    def bearings(self) -> tuple[float, ...]:
        """Of every beam, radians in the lidar's frame: from straight ahead counter-clockwise; where it does not see all
        round, those to the left, then those to the right up to straight ahead."""
        whole = self.beams_of_a_turn
        return tuple(2 * math.pi * n / whole for n in _seen(self.beams, whole))

    def middles(self) -> tuple[float, ...]:
        """Of every sector likewise, the bearing of its middle."""
        whole = self.sectors_of_a_turn
        return tuple((n + 0.5) * (2 * math.pi / whole) for n in _seen(self.sectors, whole))


def _seen(number: int, whole: int) -> list[int]:
    """Of `whole` parts of a turn from straight ahead, those within a field of view of `number` of them."""
    left = (number + 1) // 2
    return [*range(left), *range(whole - number + left, whole)]


@dataclass(frozen=True)
class Robot:
    """What drives, with differential drive, `height_m` tall: a disc of `radius_m` on the floor, or the polygon
    `footprint`: corners x, y (m) in the robot's frame, x ahead, y to the left. Of a polygon, `radius_m` is that of the
    circle around it. urdf: the file of its picture (`urdf.py`). source: where its numbers are from."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    height_m: Annotated[float, Field(gt=0, le=5)]
    limits: Limits
    lidar: Lidar
    radius_m: Annotated[float, Field(gt=0, le=5)] = 0.0
    footprint: Annotated[tuple[Corner, ...], Field(min_length=3, max_length=40)] | None = None
    urdf: Path | None = None
    source: Annotated[str, Field(max_length=400)] = ""

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        around = max((math.hypot(x, y) for x, y in self.footprint or ()), default=0.0)
        plausible = self.radius_m in (0.0, around) if self.footprint else self.radius_m > 0
        if not plausible:
            raise SetupError("radius_m: give it for a round robot, or else `footprint`, its corners")
        if self.footprint is not None:
            check_outline(self.footprint)
            object.__setattr__(self, "radius_m", around)

    @property
    def inscribed_m(self) -> float:
        """Radius (m) of the largest circle around its centre within its body."""
        if self.footprint is None:
            return self.radius_m
        sides = zip(self.footprint, self.footprint[1:] + self.footprint[:1], strict=True)
        return min(_to_side((0.0, 0.0), a, b) for a, b in sides)


def _to_side(point: Corner, a: Corner, b: Corner) -> float:
    """Distance from a point to the line segment from a to b."""
    along, squared = (b[0] - a[0], b[1] - a[1]), math.dist(a, b) ** 2
    part = ((point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1]) / squared
    part = min(max(part, 0.0), 1.0)
    return math.dist(point, (a[0] + part * along[0], a[1] + part * along[1]))


def check_outline(corners: tuple[Corner, ...]) -> None:
    """Raise SetupError unless the corners go once around the robot's centre without crossing themselves."""
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
    if any(math.dist(a, b) < 1e-4 for a, b in sides):
        raise SetupError("footprint: two neighbouring corners are one; leave one of them out")
    turned = sum(math.remainder(math.atan2(b[1], b[0]) - math.atan2(a[1], a[0]), 2 * math.pi) for a, b in sides)
    if abs(abs(turned) - 2 * math.pi) > 1e-6:
        raise SetupError("footprint: must go once around 0, 0, the middle between the robot's wheels")
    for i, (a, b) in enumerate(sides):
        for c, d in sides[i + 2 : len(sides) - (i == 0)]:
            if _left(a, b, c) * _left(a, b, d) < 0 and _left(c, d, a) * _left(c, d, b) < 0:
                raise SetupError(f"footprint: its sides cross near {a[0]:g}, {a[1]:g}; name the corners in their order")


def _left(a: Corner, b: Corner, point: Corner) -> float:
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])


@dataclass(frozen=True)
class FloorPlan:
    """A lab's own building (`worlds/building.py`), metres, in one frame. map: a `map.yaml` of ROS (`ground_maps.py`);
    obstacles: walls and furniture beside it; starts, goals, people: where they may be, anywhere with room where none
    are named; way_m: how far goals are from starts, straight."""

    map: Path | None = None
    obstacles: tuple[Obstacle, ...] = ()
    starts: tuple[Pose, ...] = ()
    goals: tuple[Pose, ...] = ()
    people: tuple[Pose, ...] = ()
    way_m: tuple[float, float] = (1.5, 8.0)


@dataclass(frozen=True)
class CoreReward:
    """The task reward r of a setup, without any preference and without the training-only progress term."""

    goal: float
    collision: float
    timeout: float
    self_intersection: float
    time_per_step: float = 0.0
    jerk_weight: float = 0.0

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class NearPenalty:
    """What a step costs that ends with the robot's centre this near to the surface of a wall, an obstacle or a person.

    Beside `CoreReward`, whose fields every exported data set names.
    """

    reward: float
    within_m: Length

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class Setup:
    """Everything a policy is bound to. world: the name of what draws its scenes (`worlds.py`); people: who walks in
    them beside the person, None: nobody; plan: what a lab's own building is. Observation: float32 vector of

    [goal distance / distance_scale_m, goal bearing / pi,
     (person distance / distance_scale_m, person bearing / pi if with_person),
     (of the `pedestrians` nearest ones, the nearest being the person: motion of the nearest along and across the
      robot's heading, m/s; of each of the others distance and bearing likewise, and motion),
     (`path_points` next places of the path, x and y in the robot's frame / distance_scale_m),
     (v / v_max, w / w_max if with_velocity), sector ranges / lidar range ...].

    Where `solids` is above 0 (chapter 2), the robot knows that many walls and obstacles instead of a lidar scan:
    [person distance / distance_scale_m, cos and sin of the person's bearing, of the goal's bearing, of the person's
     heading relative to the robot's, then per solid: distance of its closest point / distance_scale_m, cos and sin of
     that point's bearing]; the four walls (+x, -x, +y, -y) first. Angles as cosine and sine (ours): nothing jumps
    where a bearing passes straight behind.
    """

    name: str
    robot: Robot
    world: str
    reward: CoreReward
    goal_radius_m: float
    max_steps: int
    gamma: float
    with_velocity: bool
    distance_scale_m: float = 10.0
    self_intersection_min_age_steps: int = 4
    solids: int = 0
    with_person: bool = True
    near: NearPenalty | None = None
    extractors: bool = True  # networks read task part and lidar by an extractor each (ch. 6), or all at once (ch. 8)
    pedestrians: int = 0
    path_points: int = 0
    people: CrowdConditions | None = None
    preferences: PreferenceSettings = field(default_factory=PreferenceSettings, hash=False)
    conditioning: ConditioningSettings = field(default_factory=ConditioningSettings, hash=False)
    demonstrations: DemonstrationSettings | None = None
    plan: FloorPlan | None = None

    @property
    def crowded(self) -> bool:
        """Whether pedestrians walk in its scenes."""
        return self.people is not None

    @property
    def polar_size(self) -> int:
        """Length of the task part of the observation (everything before lidar or solids)."""
        if self.solids:
            return 7
        return 2 + 2 * self.with_person + self.pedestrian_inputs + 2 * self.path_points + 2 * self.with_velocity

    @property
    def pedestrian_inputs(self) -> int:
        """How many inputs tell of pedestrians, after distance and bearing of the nearest one."""
        return 4 * self.pedestrians - 2 if self.pedestrians else 0

    @property
    def person_inputs(self) -> tuple[int, int] | None:
        """Where distance and bearing of the person are observed; None where only the lidar tells of them."""
        return (2, 3) if self.with_person and not self.solids else None

    @property
    def surroundings_size(self) -> int:
        """Length of the rest of the observation: lidar sectors, or three numbers per solid."""
        return 3 * self.solids if self.solids else self.robot.lidar.sectors

    @property
    def observation_size(self) -> int:
        return self.polar_size + self.surroundings_size

    def observation_layout(self) -> list[dict[str, object]]:
        """One entry per input, in order: name, unit, scale that was applied; written into every policy's manifest."""
        if self.solids:
            return self._solids_layout()
        polar: list[dict[str, object]] = [
            {"name": "goal_distance", "unit": "m", "divided_by": self.distance_scale_m},
            {"name": "goal_bearing", "unit": "rad", "divided_by": math.pi},
        ]
        if self.with_person:
            polar += [
                {"name": "person_distance", "unit": "m", "divided_by": self.distance_scale_m},
                {"name": "person_bearing", "unit": "rad", "divided_by": math.pi},
            ]
        for k in range(self.pedestrians):
            if k:
                polar += [
                    {"name": f"pedestrian_{k}_distance", "unit": "m", "divided_by": self.distance_scale_m},
                    {"name": f"pedestrian_{k}_bearing", "unit": "rad", "divided_by": math.pi},
                ]
            polar += [
                {"name": f"pedestrian_{k}_{part}", "unit": "m/s", "divided_by": 1.0} for part in ("along", "across")
            ]
        for k in range(self.path_points):
            polar += [{"name": f"path_{k}_{axis}", "unit": "m", "divided_by": self.distance_scale_m} for axis in "xy"]
        if self.with_velocity:
            polar += [
                {"name": "linear_velocity", "unit": "m/s", "divided_by": self.robot.limits.v_max},
                {"name": "angular_velocity", "unit": "rad/s", "divided_by": self.robot.limits.w_max},
            ]
        return polar + [
            {"name": f"lidar_{i}", "unit": "m", "divided_by": self.robot.lidar.range_m}
            for i in range(self.robot.lidar.sectors)
        ]

    def _solids_layout(self) -> list[dict[str, object]]:
        def distance(name: str) -> list[dict[str, object]]:
            return [{"name": f"{name}_distance", "unit": "m", "divided_by": self.distance_scale_m}]

        def angle(name: str) -> list[dict[str, object]]:
            return [{"name": f"{name}_{part}", "unit": "1", "divided_by": 1.0} for part in ("cos", "sin")]

        layout = distance("person") + angle("person_bearing") + angle("goal_bearing") + angle("person_heading")
        for i in range(self.solids):
            layout += distance(f"solid_{i}") + angle(f"solid_{i}_bearing")
        return layout


def setup_folders() -> Mapping[str, Path]:
    """Name -> folder of every setup: the shipped ones, those in the folders of `DESIREPATH_SETUPS`, those of this
    installation (`uploaded_setups`), those that other packages name by entry points, those that were `include`d. Looked
    for again where another was uploaded. Raises SetupError for a name that two have, or that is none."""
    return _find(*_places())


def uploaded_setups() -> Path:
    """The folder of the setups that somebody brought to this installation: in its data, as `settings.py` has it."""
    return Path(os.environ.get(DATA_VARIABLE, "data")) / UPLOADED


def include(folder: Path) -> str:
    """Make the setup in that folder known to this process; its name. Raises SetupError."""
    folder = folder.resolve()
    if not (folder / SETUP_FILE).is_file():
        raise SetupError(f"{folder}: has no {SETUP_FILE}; name a setup's folder")
    if folder not in setup_folders().values():
        _included.append(folder)
        try:
            setup_folders()
        except SetupError:
            _included.remove(folder)
            raise
    return folder.name


_included: list[Path] = []


def _places() -> tuple[str, str, int, tuple[Path, ...]]:
    """What the answer of `_find` depends on."""
    return os.environ.get(FOLDERS_VARIABLE, ""), os.environ.get(DATA_VARIABLE, "data"), version(), tuple(_included)


def version() -> int:
    """Of the setups of this installation and of what lies in their folders: what was remembered of another is old."""
    try:  # at every `get_setup`, so without a Path, which takes twice as long
        return os.stat(f"{os.environ.get(DATA_VARIABLE, 'data')}/{UPLOADED}").st_mtime_ns  # noqa: PTH116
    except OSError:
        return 0


def tell_changed() -> None:
    """Let every process know that something in a setup's folder changed. Raises OSError."""
    os.utime(uploaded_setups())


@lru_cache(maxsize=8)
def _find(named: str, data: str, changed: int, included: tuple[Path, ...]) -> Mapping[str, Path]:
    found: dict[str, Path] = {}
    uploaded = (Path(data) / UPLOADED).resolve()
    for folder in (one.resolve() for one in (*_folders(named, uploaded), *included)):
        if folder.parent == uploaded and (folder.name in found or not NAME.fullmatch(folder.name)):
            continue  # what a page brought takes no other one down
        if not NAME.fullmatch(folder.name):
            wanted = "lower-case letters, digits and _, beginning with a letter"
            raise SetupError(f"setup {folder.name!r} in {folder.parent}: its folder's name must be {wanted}")
        if found.get(folder.name, folder).parent == uploaded:
            found[folder.name] = folder
        first = found.setdefault(folder.name, folder)
        if first != folder:
            raise SetupError(f"setup {folder.name}: {first} and {folder} both have this name; rename one of them")
    return found


def _folders(named: str, uploaded: Path) -> Iterator[Path]:
    further = [Path(one) for one in named.split(os.pathsep) if one]
    for parent in further:
        if not parent.is_dir():
            raise SetupError(f"{FOLDERS_VARIABLE}: {parent} is no folder; name folders whose folders are setups")
    for parent in (DATASETS, *further, uploaded):
        yield from sorted(file.parent for file in parent.glob(f"*/{SETUP_FILE}"))
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            named_there = entry.load()
            folder = Path(named_there() if callable(named_there) else named_there)
        except Exception as wrong:
            raise SetupError(f"entry point {entry.name} = {entry.value}: cannot be loaded: {wrong}") from wrong
        if not (folder / SETUP_FILE).is_file():
            raise SetupError(f"entry point {entry.name} = {entry.value}: {folder} has no {SETUP_FILE}")
        yield folder


def get_setup(name: str) -> Setup:
    """The setup of that name. Raises SetupError listing the known ones, or saying what is wrong in its file."""
    places = _places()  # which asks the disk: once a call, as every measure asks for its setup
    folders = _find(*places)
    if name not in folders:
        raise SetupError(f"unknown setup {name!r}; known: {', '.join(folders)}")
    return _read(folders[name], places[2])


@lru_cache(maxsize=256)
def _read(folder: Path, changed: int) -> Setup:
    from desirepath.simulation.setup_files import read_setup

    return read_setup(folder)


class _Setups(Mapping[str, Setup]):
    """The setups by name, each read when it is asked for."""

    def __getitem__(self, name: str) -> Setup:
        if name not in setup_folders():
            raise KeyError(name)
        return get_setup(name)

    def __iter__(self) -> Iterator[str]:
        return iter(setup_folders())

    def __len__(self) -> int:
        return len(setup_folders())


SETUPS: Mapping[str, Setup] = _Setups()


def setups_with(artefact: str) -> tuple[str, ...]:
    """The setups that an artefact of that name is shipped for: `base`, `conditioned`."""
    return tuple(setup for setup, folder in setup_folders().items() if (folder / f"{artefact}.npz").is_file())


def preference_setups() -> tuple[str, ...]:
    """The setups in which a person who stands is asked how the robot should drive: they have a conditioned policy, and
    nobody walks."""
    return tuple(setup.name for setup in _readable(setups_with("conditioned")) if not setup.crowded)


def trainable_setups() -> tuple[str, ...]:
    """The setups in which a base policy can be trained: the robot has a lidar, and reaching the goal is rewarded."""
    return tuple(setup.name for setup in _readable(SETUPS) if not setup.solids and setup.reward.goal > 0)


def is_shipped(folder: Path) -> bool:
    """Whether the setup of that folder comes with the product."""
    return folder.parent == DATASETS.resolve()


def own_setups() -> tuple[str, ...]:
    """Those of them that a lab brought, in whose folders what is trained may be put: none of the shipped ones."""
    folders = setup_folders()
    return tuple(name for name in trainable_setups() if not is_shipped(folders[name]))


def demonstration_setups() -> tuple[str, ...]:
    """The setups in which paths are drawn that a controller of known places learns from (ch. 2)."""
    return tuple(setup.name for setup in _readable(SETUPS) if setup.demonstrations and setup.solids)


def _readable(names: Iterable[str]) -> Iterator[Setup]:
    """Those of them that can be read: one broken file takes no list down (`broken_setups`)."""
    for name in names:
        try:
            yield get_setup(name)
        except SetupError:
            continue


def broken_setups() -> Mapping[str, str]:
    """What is wrong with each that is not offered: it cannot be read, or was brought and another has its name."""
    broken = {}
    for name in setup_folders():
        try:
            get_setup(name)
        except SetupError as wrong:
            broken[name] = str(wrong)
    uploaded = uploaded_setups().resolve()
    for folder in sorted(file.parent for file in uploaded.glob(f"*/{SETUP_FILE}")):
        if (first := setup_folders().get(folder.name)) not in (None, folder):
            broken[folder.name] = f"{first} has this name, too; this one is not used"
    return broken


def has_depth_camera(setup: str) -> bool:
    """Whether controllers learned from paths there go by a depth camera (ch. 3)."""
    drawn = get_setup(setup).demonstrations
    return drawn is not None and drawn.depth_camera


def check_names(setup: str, part: str, given: Mapping[str, float], known: Sequence[str]) -> None:
    """Raise SetupError if `preferences.part` of the setup's file names what is none of `known`."""
    for name in given:
        if name not in known:
            raise SetupError(f"setup {setup}: preferences.{part} names {name!r}; known are {', '.join(known)}")


def _names(can: Callable[[Setup], bool]) -> str:
    return ", ".join(setup.name for setup in SETUPS.values() if can(setup))


def require_plain(setup: Setup, where: str) -> None:
    """Raise SetupError for what only the fast engine knows, where nobody walks: some robots, and maps."""
    lidar, limits = setup.robot.lidar, setup.robot.limits
    special = {
        "footprint": setup.robot.footprint is not None,
        "limits.v_change or w_change": limits.v_change is not None or limits.w_change is not None,
        "lidar.x_m, y_m or yaw_rad": (lidar.x_m, lidar.y_m, lidar.yaw_rad) != (0, 0, 0),
        "lidar.field_of_view_rad": not lidar.all_round,
        "lidar.noise_m, drop_out, min_range_m or rate_hz": not lidar.exact,
        "map": setup.plan is not None and setup.plan.map is not None,
    }
    for what, given in special.items():
        if given:
            raise SetupError(f"setup {setup.name}: {where} cannot do with `{what}`; leave it out there")


def require_lidar(setup: Setup) -> None:
    """Raise SetupError for a setup whose observation holds no lidar scan: its inputs mean something else."""
    if setup.solids:
        raise SetupError(
            f"setup {setup.name} observes closest points, no lidar; this needs one of "
            f"{_names(lambda one: not one.solids)}"
        )


def require_person(setup: Setup) -> None:
    """Raise SetupError for a setup whose robot scans its surroundings and is not told where the person is."""
    require_lidar(setup)
    if setup.person_inputs is None:
        raise SetupError(
            f"setup {setup.name} does not observe where the person is; this needs one of "
            f"{_names(lambda one: one.person_inputs is not None)}"
        )


def require_same(**named: str) -> str:
    """The one setup that all the named things share. Raises SetupError naming who differs."""
    if len(set(named.values())) != 1:
        raise SetupError("setups differ: " + ", ".join(f"{who} is {name}" for who, name in named.items()))
    return next(iter(named.values()))
