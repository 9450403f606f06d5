"""What a mapping says of files that somebody else wrote: columns, units, topics, runs, pairs. A strict YAML file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from desirepath.grammar.error_words import parse
from desirepath.grammar.parts import Part
from desirepath.grammar.source import ProtocolError, Source, file_text
from desirepath.recordings.recording import RecordingError

Format = Literal["csv", "socnav3", "mcap", "rosbag2", "minari", "lerobot"]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Metres = Annotated[float, Field(ge=-1e7, le=1e7, allow_inf_nan=False)]
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1_000.0, "in": 0.0254, "ft": 0.3048}
ANGLES = {"rad": 1.0, "deg": 0.017453292519943295}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}


class Units(Part):
    """Of columns whose heads name none."""

    length: Literal["m", "cm", "mm", "km", "in", "ft"] | None = None
    angle: Literal["rad", "deg"] | None = None
    time: Literal["s", "ms", "us", "ns", "min"] | None = None


class Topics(Part):
    """Of bags. pose: Odometry, PoseStamped or PoseWithCovarianceStamped of the robot; people: PoseArray or
    people_msgs/People; goal: PoseStamped; scan: said to be there, not imported; map: OccupancyGrid."""

    pose: Name = "/odom"
    people: Name | None = "/people"
    scan: Name | None = "/scan"
    goal: Name | None = "/goal_pose"
    map: Name | None = "/map"


class Keys(Part):
    """Of Minari and LeRobot data sets: where in an array x, y and yaw stand. field: its name, such as
    observation.state or infos.pose."""

    field: Name
    x: int = Field(0, ge=0, le=10_000)
    y: int = Field(1, ge=0, le=10_000)
    yaw: int | None = Field(None, ge=0, le=10_000)


class GoalPlace(Part):
    """Where the robot was to go, m."""

    x: Metres
    y: Metres
    radius_m: float | None = Field(None, gt=0, le=100)


class Run(Part):
    """A piece of one file. from_s, to_s: seconds since the file's first pose."""

    name: Name
    file: Name | None = None
    scene: Name | None = None
    from_s: float = Field(0.0, ge=0, le=1e7)
    to_s: float | None = Field(None, gt=0, le=1e7)
    goal: GoalPlace | None = None


class Mapping(Part):
    """All of it; nothing is needed where names and units are the usual ones.

    columns: our name of a column -> theirs. origin: subtracted from all places, m. scene: all runs are of this one.
    goal: of all runs that have none. frame: in which poses must be. leave_out: people who are not shown. pairs: names
    of runs, which are A and which B. people, robot: of arrays. dt_s: between rows that have no time.
    """

    format: Format | None = None
    columns: dict[Name, Name] = Field(default_factory=dict, max_length=200)
    units: Units = Units()
    topics: Topics = Topics()
    robot: Keys | None = None
    people: dict[Name, Keys] = Field(default_factory=dict, max_length=21)
    dt_s: float | None = Field(None, gt=0, le=10)
    frame: Name | None = None
    origin: tuple[Metres, Metres] = (0.0, 0.0)
    scene: Name | None = None
    goal: GoalPlace | None = None
    runs: list[Run] = Field(default_factory=list, max_length=2_000)
    leave_out: list[Name] = Field(default_factory=list, max_length=1_000)
    pairs: list[tuple[Name, Name]] = Field(default_factory=list, max_length=10_000)


def read_mapping(path: Path) -> tuple[Mapping, str]:
    """The mapping and the sha256 of its file. Raises RecordingError with every problem, by line and field."""
    try:
        text = file_text(path)
        return parse(Source(path.name, text), Mapping), hashlib.sha256(text.encode()).hexdigest()
    except ProtocolError as wrong:
        raise RecordingError(path.name, "", None, str(wrong)) from None
