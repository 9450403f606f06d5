"""MCAP files and rosbag2 folders: the topics that the mapping names, out of however many messages; and MCAP out again.

`mcap` comes with `pip install desirepath[recordings]`; SQLite bags need nothing.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
import sqlite3
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.ros_messages import (
    ODOMETRY,
    POSE,
    POSE_ARRAY,
    SCAN,
    SCHEMAS,
    TRANSFORMS,
    encode_odometry,
    encode_pose,
    encode_poses,
)
from desirepath.recordings.frames import Frames
from desirepath.recordings.grids import grid_of, walls_of
from desirepath.recordings.mapping import Mapping
from desirepath.recordings.recording import (
    BOUNDS,
    MIB,
    Bounds,
    Goal,
    Recording,
    RecordingError,
    Source,
    Thing,
    file_sha256,
    track,
)
from desirepath.recordings.resampling import body_speeds
from desirepath.recordings.ros_messages import (
    GRID,
    PEOPLE,
    POSE_WITH_COVARIANCE,
    CdrError,
    GridMessage,
    Stamped,
    decode,
    decode_grid,
    decode_transforms,
)
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
MCAP, ROSBAG2 = "mcap", "rosbag2"
SUFFIXES = {".mcap": MCAP, ".db3": ROSBAG2}
METADATA = "metadata.yaml"
POSES, GROUPS = (ODOMETRY, POSE, POSE_WITH_COVARIANCE), (POSE_ARRAY, PEOPLE)
FITS = {"pose": POSES, "people": GROUPS, "goal": (POSE,), "scan": (SCAN,), "map": (GRID,)}
TF = {"/tf": False, "/tf_static": True}
"""Topics of transforms: whether they hold for all times."""
"""What a topic may be, as the mapping calls it -> of which types."""
CHUNK_BYTES = 256 * MIB
LACKING = "MCAP needs the package mcap: pip install 'desirepath[recordings]'"
SAME_PERSON_M, FASTEST_M_S, FORGOTTEN_S = (
    0.4,
    2.5,
    1.0,
)  # who is who in a PoseArray: the nearest who may have come there
MOST_AT_ONCE = 100  # poses without names in a message
BRIEF_S = 1.0  # whom a detector saw for less is left out
_NUMBER = re.compile(r"(\d+)")


NOTHING = Stamped(0.0, "", ())  # of a message that is kept elsewhere


@dataclass
class _Topic:
    kind: str
    messages: list[tuple[int, Stamped]] = field(default_factory=list)  # number in the bag, and what it says


@dataclass
class _Bag:
    """What was read. kinds: type of every topic there is; read: of those asked for; counts: messages of each."""

    name: str
    kinds: dict[str, str] = field(default_factory=dict)
    read: dict[str, _Topic] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)
    grid: GridMessage | None = None
    counts: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    messages: int = 0
    poses: int = 0

    def topic(self, name: str, kind: str, bounds: Bounds) -> None:
        if len(self.kinds) >= bounds.topics and name not in self.kinds:
            raise RecordingError(self.name, "topics", len(self.kinds) + 1, f"at most {bounds.topics} are read")
        self.kinds[name] = kind

    def add(self, name: str, data: bytes, logged_ns: int, bounds: Bounds) -> None:
        """One message of a topic that is wanted."""
        kind = self.kinds[name]
        topic = self.read.setdefault(name, _Topic(kind))
        where = f"topic {name}, message {len(topic.messages)}"
        if len(data) > bounds.message_bytes:
            raise RecordingError(self.name, where, len(data), f"bytes; at most {bounds.message_bytes} are read")
        if len(topic.messages) >= bounds.rows:
            raise RecordingError(
                self.name, where, None, f"at most {bounds.rows} messages of a topic are read; cut the bag"
            )
        try:
            if kind == TRANSFORMS:
                topic.messages.append((len(topic.messages), NOTHING))
                for time_s, parent, child, place in decode_transforms(data):
                    self.frames.add(time_s or logged_ns * 1e-9, parent, child, place, static=TF[name])
                return
            if kind == GRID:
                self.grid = decode_grid(data)  # the newest
                topic.messages.append((len(topic.messages), NOTHING))
                return
            found = decode(kind, data)
        except CdrError as wrong:
            raise RecordingError(self.name, where, None, f"{wrong}; {kind} was expected") from None
        self.poses += len(found.bodies)
        if self.poses > bounds.poses:
            raise RecordingError(self.name, where, self.poses, f"poses; at most {bounds.poses} of a bag are read")
        time_s = found.time_s if found.time_s > 0 else logged_ns * 1e-9
        topic.messages.append((len(topic.messages), Stamped(time_s, found.frame, found.bodies)))


def read_bag(path: Path, mapping: Mapping, bounds: Bounds = BOUNDS) -> list[Recording]:
    """The one run of an MCAP file, an SQLite bag or a rosbag2 folder. Raises RecordingError by topic and message."""
    files = bag_files(path) if path.is_dir() else [path]
    if not files:
        raise RecordingError(path.name, "", None, "no .mcap or .db3 in it; compressed files need unpacking (zstd -d)")
    topics = mapping.topics
    wanted = {topics.pose, topics.people, topics.goal, topics.map, *TF} - {None}
    bag, digests = _Bag(path.name), []
    for file in files:
        digests.append(_sha256(file, bounds))
        reader = _read_mcap if file.suffix.lower() == ".mcap" else _read_sqlite
        reader(file, bag, {name for name in wanted if name}, bounds)
    sha = digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()
    kind = ROSBAG2 if path.is_dir() or path.suffix.lower() == ".db3" else MCAP
    return [_recording(Source(path.name, kind, sha), path, bag, mapping, bounds)]


def look_at_topics(path: Path, bounds: Bounds = BOUNDS) -> dict[str, tuple[str, int]]:
    """Topic -> its type and how many messages it has, by name; no message is read. Raises RecordingError."""
    bag = _Bag(path.name)
    for file in bag_files(path) if path.is_dir() else [path]:
        _sha256(file, bounds)  # which looks at the size, too
        (_read_mcap if file.suffix.lower() == ".mcap" else _read_sqlite)(file, bag, set(), bounds)
    return {name: (kind, bag.counts[name]) for name, kind in sorted(bag.kinds.items())}


def bag_files(folder: Path) -> list[Path]:
    """The files of a rosbag2 folder, in the order of their numbers."""

    def by_number(file: Path) -> list[str | int]:
        return [int(part) if part.isdigit() else part for part in _NUMBER.split(file.name)]

    return sorted((one for one in folder.iterdir() if one.suffix.lower() in SUFFIXES), key=by_number)


def _sha256(file: Path, bounds: Bounds) -> str:
    size = file.stat().st_size
    if size == 0:
        raise RecordingError(file.name, "", None, "is empty (0 bytes)")
    if size > bounds.bag_bytes:
        raise RecordingError(
            file.name, "bytes", size, f"at most {bounds.bag_bytes} are read; cut the bag, or drop its images"
        )
    return file_sha256(file)


# ---- containers ------------------------------------------------------------------------------------------------------


def _read_mcap(file: Path, bag: _Bag, wanted: set[str], bounds: Bounds) -> None:
    try:
        from mcap import records
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader
    except ModuleNotFoundError:
        raise RecordingError(file.name, "", None, LACKING) from None
    schemas: dict[int, str] = {}  # id -> name
    channels: dict[int, tuple[str, str]] = {}  # id -> topic, encoding
    unpacked = 0

    def take(record: object) -> None:
        if isinstance(record, records.Schema):
            schemas[record.id] = record.name
        elif isinstance(record, records.Channel):
            if len(channels) >= bounds.topics:
                raise RecordingError(file.name, "channels", len(channels) + 1, f"at most {bounds.topics} are read")
            channels[record.id] = record.topic, record.message_encoding
            bag.topic(record.topic, _ros2_name(schemas.get(record.schema_id, "")), bounds)
        elif isinstance(record, records.Message):
            bag.messages += 1
            topic, encoding = channels.get(record.channel_id, ("", ""))
            bag.counts[topic] += 1
            if topic in wanted and _is_read(bag, topic):
                if encoding != "cdr":
                    problem = "only ROS 2's cdr is read; convert the bag (`ros2 bag convert`, `rosbags-convert`)"
                    raise RecordingError(file.name, f"topic {topic}, encoding", encoding, problem)
                bag.add(topic, record.data, record.log_time, bounds)

    def every(stream: IO[bytes], *, inside: bool) -> Iterator[object]:
        reader = StreamReader(stream, skip_magic=inside, emit_chunks=True, record_size_limit=CHUNK_BYTES)
        yield from reader.records

    try:
        with file.open("rb") as opened:
            for record in every(opened, inside=False):
                if isinstance(record, records.Chunk):
                    unpacked += record.uncompressed_size
                    if record.uncompressed_size > CHUNK_BYTES or unpacked > bounds.unpacked_bytes:
                        problem = f"bytes unpacked; at most {bounds.unpacked_bytes}, {CHUNK_BYTES} of a chunk, are read"
                        raise RecordingError(file.name, "chunk", unpacked, problem)
                    _read_chunk(file, record, every, take)
                else:
                    take(record)
    except RecordingError:
        raise
    except (McapError, EOFError, struct.error, ValueError, KeyError, OverflowError, MemoryError) as wrong:
        problem = f"is cut or no MCAP ({str(wrong) or type(wrong).__name__}); `mcap recover` saves what is whole"
        raise RecordingError(file.name, f"after message {bag.messages}", None, problem) from None


def _read_chunk(file: Path, chunk: Any, every: Callable[..., Iterator[object]], take: Callable[[object], None]) -> None:
    """The records of a chunk, unpacked to no more than it says."""
    from mcap.exceptions import EndOfFile

    data = _unpack(file, chunk.compression, chunk.data, chunk.uncompressed_size)
    try:
        for record in every(io.BytesIO(data), inside=True):
            take(record)
    except EndOfFile:
        pass  # a chunk has no footer


def _unpack(file: Path, how: str, data: bytes, size: int) -> bytes:
    found = data
    try:
        if how == "zstd":
            import zstandard

            with zstandard.ZstdDecompressor(max_window_size=CHUNK_BYTES).stream_reader(data) as stream:
                found = stream.read(size + 1)
        elif how == "lz4":
            import lz4.frame

            found = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        elif how:
            raise RecordingError(file.name, "compression", how, "unknown; zstd, lz4 or none are read")
    except RecordingError:
        raise
    except Exception as wrong:  # whatever a decompressor raises
        raise RecordingError(file.name, "chunk", None, f"cannot be unpacked ({how}): {wrong}") from None
    if len(found) != size:
        raise RecordingError(file.name, "chunk", len(found), f"bytes unpacked, it says {size}")
    return found


def _read_sqlite(file: Path, bag: _Bag, wanted: set[str], bounds: Bounds) -> None:
    with file.open("rb") as opened:
        if opened.read(16) != b"SQLite format 3\0":
            raise RecordingError(
                file.name, "", None, "is no SQLite file, as rosbag2's .db3 are; was it cut or compressed?"
            )
    try:
        connection = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            connection.execute("PRAGMA trusted_schema=OFF")
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, bounds.message_bytes)
            kinds = dict(
                connection.execute("SELECT type, type FROM sqlite_master WHERE name IN ('topics', 'messages')")
            )
            if set(kinds) != {"table"}:
                raise RecordingError(
                    file.name, "", None, "has no tables topics and messages, as rosbag2 has; is it a bag?"
                )
            named: dict[int, str] = {}
            counted = connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id")
            counts = {int(number): int(count) for number, count in counted}
            rows = connection.execute("SELECT id, name, type, serialization_format FROM topics")
            for number, name, kind, encoding in rows:
                bag.topic(str(name), _ros2_name(str(kind)), bounds)
                bag.counts[str(name)] += counts.get(int(number), 0)
                if name in wanted and _is_read(bag, str(name)):
                    if encoding != "cdr":
                        raise RecordingError(file.name, f"topic {name}, encoding", encoding, "only cdr is read")
                    named[int(number)] = str(name)
            marks = ", ".join("?" * len(named))
            query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp, id"  # noqa: S608
            for number, logged_ns, data in connection.execute(query, list(named)):
                bag.messages += 1
                if not isinstance(data, bytes) or not isinstance(logged_ns, int):
                    raise RecordingError(file.name, f"topic {named[number]}", None, "holds a message that is no bytes")
                bag.add(named[number], data, logged_ns, bounds)
        finally:
            connection.close()
    except (sqlite3.Error, TypeError, ValueError, OverflowError) as wrong:
        if isinstance(wrong, RecordingError):
            raise
        raise RecordingError(file.name, f"after message {bag.messages}", None, f"is cut or damaged: {wrong}") from None


def _ros2_name(kind: str) -> str:
    """`nav_msgs/Odometry` as `nav_msgs/msg/Odometry`."""
    package, _, name = kind.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{name}" if package else name


def _is_read(bag: _Bag, topic: str) -> bool:
    kind = bag.kinds[topic]
    return kind in (*POSES, *GROUPS, GRID) or (kind == TRANSFORMS and topic in TF)


# ---- what they say ---------------------------------------------------------------------------------------------------


def _recording(source: Source, path: Path, bag: _Bag, mapping: Mapping, bounds: Bounds) -> Recording:
    topics, how = mapping.topics, []
    named = topics.model_fields_set
    poses = _wanted(bag, topics.pose, POSES, "pose", needed=True)
    assert poses is not None  # noqa: S101  needed
    frame = _frame_of(bag, poses, mapping)
    people_topic = _wanted(bag, topics.people, GROUPS, "people", needed="people" in named and topics.people is not None)
    goal_topic = _wanted(bag, topics.goal, (POSE,), "goal", needed="goal" in named and topics.goal is not None)
    if topics.scan and topics.scan in bag.kinds:
        how.append(f"lidar scans ({topics.scan}) are in the recording and were not imported")
    shift = np.array([*mapping.origin, 0.0])
    rows = [(one.time_s, *one.bodies[0][1]) for _, one in _brought(bag, topics.pose, poses, frame, how)]
    values = np.array(rows, dtype=np.float64).reshape(-1, 4)
    if np.isnan(values[:, 3]).any():
        values[:, 3] = np.nan
    robot = track(
        bag.name, "the robot", values[:, 0], values[:, 1:] - shift, lambda k: f"topic {topics.pose}, message {k}",
        bounds=bounds,
    )  # fmt: skip
    people = {}
    if people_topic is not None and topics.people is not None:
        people_topic = _Topic(people_topic.kind, _brought(bag, topics.people, people_topic, frame, how))
        ways = _named(people_topic) if people_topic.kind == PEOPLE else _told_apart(bag.name, people_topic, how)
        for who, seen in ways.items():
            if who in mapping.leave_out:
                continue
            at = np.array([(time_s, *place) for _, time_s, place in seen], dtype=np.float64)
            if np.isnan(at[:, 3]).any():
                at[:, 3] = np.nan
            people[who] = track(
                bag.name, f"person {who!r}", at[:, 0], at[:, 1:] - shift,
                lambda k, of=seen: f"topic {topics.people}, message {of[k][0]}",  # type: ignore[misc]
                bounds=bounds, gaps=True,
            )  # fmt: skip
        if len(people) > bounds.people:
            problem = (
                f"people; at most {bounds.people} are shown. Does the detector lose them? `leave_out` names others"
            )
            raise RecordingError(bag.name, f"topic {topics.people}", len(people), problem)
    goal = None
    if goal_topic is not None and goal_topic.messages and topics.goal is not None:
        x, y, yaw = _brought(bag, topics.goal, goal_topic, frame, how)[-1][1].bodies[0][1]
        if not (math.isfinite(x) and math.isfinite(y)):
            raise RecordingError(bag.name, f"topic {topics.goal}", [x, y], "must be finite numbers")
        goal = Goal(x - mapping.origin[0], y - mapping.origin[1], 0.0 if math.isnan(yaw) else yaw)
    things: tuple[Thing, ...] = ()
    if _wanted(bag, topics.map, (GRID,), "map", needed="map" in named and topics.map is not None):
        around = [robot.poses[:, :2], *(seen.poses[:, :2] for seen in people.values())]
        things = _walls(bag, str(topics.map), frame, around, mapping, how, bounds)
    return Recording(
        source=source, run=path.stem, scene=path.resolve().parent.name or path.stem, robot=robot, people=people,
        things=things, goal=goal, how=tuple(how),
    )  # fmt: skip


def _wanted(bag: _Bag, name: str | None, kinds: tuple[str, ...], what: str, *, needed: bool) -> _Topic | None:
    """The topic with its messages. Raises RecordingError where it is needed and missing, or of another type."""
    if name is None:
        return None
    if name not in bag.kinds:
        if not needed:
            return None
        there = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(bag.kinds.items())[:20]) or "none"
        problem = f"is not in the bag; map another with `topics: {{{what}: ...}}`. There are {there}"
        raise RecordingError(bag.name, f"topic {name}", None, problem)
    if bag.kinds[name] not in kinds:
        if not needed:
            return None
        raise RecordingError(bag.name, f"topic {name}, type", bag.kinds[name], f"must be one of {', '.join(kinds)}")
    found = bag.read.get(name)
    if found is None and needed:
        raise RecordingError(bag.name, f"topic {name}", 0, "messages; was the robot recorded?")
    return found


def _frame_of(bag: _Bag, topic: _Topic, mapping: Mapping) -> str:
    """The frame of all places: the one that is asked for, the map's where transforms lead there, else the robot's."""
    own = topic.messages[0][1].frame
    if mapping.frame is None and bag.grid is not None and bag.frames.links(own, bag.grid.frame):
        return bag.grid.frame
    return mapping.frame or own


def _brought(bag: _Bag, name: str, topic: _Topic, frame: str, how: list[str]) -> list[tuple[int, Stamped]]:
    """The topic's messages with places in `frame`, by the bag's transforms where theirs is another."""
    found = []
    for number, one in topic.messages:
        if one.frame.lstrip("/") != frame.lstrip("/"):
            if not bag.frames.links(one.frame, frame):
                known = ", ".join(bag.frames.known()[:20])
                there = f"its transforms are between {known}" if known else "no transforms (/tf) are in the bag"
                problem = (
                    f"must be {frame!r}, as the robot's poses are: {there}; map a topic in that frame, or name another "
                    "with `frame`"
                )
                raise RecordingError(bag.name, f"topic {name}, message {number}, frame", one.frame, problem)
            places = [(who, bag.frames.place(place, one.frame, frame, one.time_s)) for who, place in one.bodies]
            how.append(f"places of frame {one.frame!r} were brought into {frame!r} by the bag's transforms")
            one = Stamped(one.time_s, frame, tuple(places))
        found.append((number, one))
    return found


def _walls(
    bag: _Bag, name: str, frame: str, ways: list[Doubles], mapping: Mapping, how: list[str], bounds: Bounds
) -> tuple[Thing, ...]:
    """What is occupied in the bag's map. Raises RecordingError for a map that was named and lies in no known frame."""
    grid = bag.grid
    assert grid is not None  # noqa: S101  it was read
    if not bag.frames.links(grid.frame, frame):
        problem = f"must be {frame!r}, as the robot's poses are, and no transforms lead there"
        if "map" in mapping.topics.model_fields_set:
            raise RecordingError(bag.name, f"topic {name}, frame", grid.frame, problem)
        how.append(f"the map was left out: its frame {grid.frame!r} {problem}")
        return ()
    x, y, yaw = bag.frames.place(grid.origin, grid.frame, frame, math.inf)
    origin = (x - mapping.origin[0], y - mapping.origin[1], 0.0 if math.isnan(yaw) else yaw)
    cells = np.frombuffer(grid.cells, dtype=np.int8)
    found = grid_of(bag.name, f"topic {name}", cells, grid.width, grid.height, grid.cell_m, origin)
    return walls_of(found, np.concatenate(ways), how, bounds)


Seen = list[tuple[int, float, tuple[float, float, float]]]
"""Message, time and place of one person."""


def _named(topic: _Topic) -> dict[str, Seen]:
    found: dict[str, Seen] = defaultdict(list)
    for number, one in topic.messages:
        for who, place in one.bodies:
            found[who].append((number, one.time_s, place))
    return dict(found)


def _told_apart(file: str, topic: _Topic, how: list[str]) -> dict[str, Seen]:
    """Poses without names as ways of people: who is nearest to where somebody was just before is the same one."""
    ways: list[Seen] = []
    recent: list[Seen] = []
    brief = 0
    for number, one in topic.messages:
        left = [place for _, place in one.bodies if math.isfinite(place[0]) and math.isfinite(place[1])]
        if len(left) > MOST_AT_ONCE:
            raise RecordingError(
                file, f"topic people, message {number}", len(left), f"poses; at most {MOST_AT_ONCE} are told apart"
            )
        over = [way for way in recent if not 0 < one.time_s - way[-1][1] <= FORGOTTEN_S]
        recent = [way for way in recent if 0 < one.time_s - way[-1][1] <= FORGOTTEN_S]
        lasting = [way for way in over if way[-1][1] - way[0][1] >= BRIEF_S]
        ways, brief = ways + lasting, brief + len(over) - len(lasting)
        near = sorted(
            (math.dist(way[-1][2][:2], place[:2]), w, p) for w, way in enumerate(recent) for p, place in enumerate(left)
        )
        met_ways: set[int] = set()
        met_places: set[int] = set()
        for apart, w, p in near:
            reach = SAME_PERSON_M + FASTEST_M_S * (one.time_s - recent[w][-1][1])
            if apart <= reach and w not in met_ways and p not in met_places:
                met_ways.add(w)
                met_places.add(p)
                recent[w].append((number, one.time_s, left[p]))
        recent += [[(number, one.time_s, place)] for p, place in enumerate(left) if p not in met_places]
    lasting = [way for way in recent if way[-1][1] - way[0][1] >= BRIEF_S]
    kept, brief = sorted(ways + lasting, key=lambda way: way[0]), brief + len(recent) - len(lasting)
    if kept or brief:
        how.append("poses of people have no names: the nearest to where somebody was just before is the same person")
    if brief:
        how.append(f"{brief} people who were seen for less than {BRIEF_S:g} s were left out")
    return {str(k): way for k, way in enumerate(kept, start=1)}


# ---- out -------------------------------------------------------------------------------------------------------------


def to_mcap(trajectory: Trajectory) -> bytes:
    """One trajectory as an MCAP file: /odom, /people (PoseArray) and /goal_pose in the frame map, from 1 s on."""
    from mcap.writer import CompressionType, Writer

    out = io.BytesIO()
    writer: Any = Writer(out, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="desirepath")
    topics = {"/odom": ODOMETRY, "/people": POSE_ARRAY, "/goal_pose": POSE}
    channels = {}
    for topic, kind in topics.items():
        schema = writer.register_schema(name=kind, encoding="ros2msg", data=SCHEMAS[kind].encode())
        channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)

    def put(topic: str, time_s: float, data: bytes) -> None:
        stamp = round(time_s * 1e9)
        writer.add_message(channels[topic], log_time=stamp, data=data, publish_time=stamp)

    scene, times = trajectory.scene, trajectory.times.astype(np.float64)
    speeds = body_speeds(trajectory.poses.astype(np.float64), trajectory.dt)
    people = trajectory.scene.people_poses_at(times)
    goal = (scene.goal.x, scene.goal.y, scene.goal.yaw)
    put("/goal_pose", 1.0, encode_pose(1.0, "map", goal))
    for k, (time_s, place) in enumerate(zip(times, trajectory.poses, strict=True)):
        stamp = 1.0 + float(time_s)
        x, y, yaw = map(float, place)
        put("/odom", stamp, encode_odometry(stamp, "map", (x, y, yaw), speeds[k]))
        if len(people):
            where = [(float(px), float(py), float(pyaw)) for px, py, pyaw in people[:, k]]
            put("/people", stamp, encode_poses(stamp, "map", where))
    writer.finish()
    return out.getvalue()
