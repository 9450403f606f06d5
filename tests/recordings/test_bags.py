"""I have a bag of my robot, as ROS 2 or Foxglove write them."""

from __future__ import annotations

import io
import sqlite3
import struct
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from desirepath.deploy.ros_messages import (
    ODOMETRY,
    POSE_ARRAY,
    SCHEMAS,
    TRANSFORMS,
    encode_grid,
    encode_odometry,
    encode_poses,
    encode_transform,
)
from desirepath.learning.policies.shipped import load_queries
from desirepath.recordings.bags import read_bag, to_mcap
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Mapping, Topics
from desirepath.recordings.recording import BOUNDS, RecordingError
from desirepath.recordings.ros_messages import GRID
from desirepath.simulation.trajectory import Outcome
from tests.recordings.walks import ANNA, RUNS, refusal, robot_at, times

pytest.importorskip("mcap")
START = 1_700_000_000.0


def messages(
    aside: float, *, frame: str = "odom", people_frame: str = "odom"
) -> Iterable[tuple[str, str, float, bytes]]:
    """topic, type, time (s), CDR."""
    for t in map(float, times()):
        stamp = START + t
        yield "/odom", ODOMETRY, stamp, encode_odometry(stamp, frame, robot_at(t, aside), (0.7, 0.0, 0.0))
        walks = (1.0 + 0.5 * t, -3.0, 0.0)
        both = [ANNA, walks] if int(t * 10) % 2 else [walks, ANNA]  # a detector's order is nobody's
        yield "/people", POSE_ARRAY, stamp + 0.01, encode_poses(stamp + 0.01, people_frame, both)


def write_mcap(file: Path, said: Iterable[tuple[str, str, float, bytes]], compression: str = "ZSTD") -> Path:
    from mcap.writer import CompressionType, Writer

    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType[compression], chunk_size=4_000)
    writer.start()
    channels: dict[str, int] = {}
    for topic, kind, stamp, data in said:
        if topic not in channels:
            text = SCHEMAS.get(kind, "float64 x\n").encode()
            schema = writer.register_schema(name=kind, encoding="ros2msg", data=text)
            channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
        writer.add_message(channels[topic], log_time=round(stamp * 1e9), data=data, publish_time=round(stamp * 1e9))
    writer.finish()
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(out.getvalue())
    return file


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, aside in RUNS.items():
        write_mcap(tmp_path / "hall" / f"{name}.mcap", messages(aside))
    return tmp_path / "hall"


def test_a_folder_of_mcap_files_is_one_scene(folder: Path) -> None:
    found = import_recordings(folder, "study_room")
    assert (found.scenes, found.trajectories, len(found.query_set)) == (1, 3, 3)
    wide = next(
        t for q in found.query_set.queries for t in (q.trajectory_a, q.trajectory_b) if t.recorded.run == "wide"
    )
    truth = np.array([robot_at(float(t), RUNS["wide"]) for t in wide.times])
    np.testing.assert_allclose(wide.poses, truth, atol=1e-3)
    people = wide.scene.people_at(wide.times)
    np.testing.assert_allclose(people[0], np.tile(ANNA[:2], (41, 1)), atol=1e-6)
    np.testing.assert_allclose(people[1, :, 0], 1.0 + 0.5 * wide.times, atol=0.02)
    assert any("have no names" in how for how in wide.recorded.how)


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_however_it_is_compressed(tmp_path: Path, compression: str) -> None:
    file = write_mcap(tmp_path / "one.mcap", messages(0.5), compression)
    (found,) = read_bag(file, Mapping())
    assert (found.source.format, len(found.robot.times_s), len(found.people)) == ("mcap", 81, 2)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_rosbag2_folder_that_rosbags_wrote(tmp_path: Path, storage: str) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    bag = tmp_path / "walk"
    with rosbag2.Writer(bag, version=9, storage_plugin=rosbag2.StoragePlugin[storage]) as writer:
        links = {}
        for topic, kind, stamp, data in messages(0.5):
            if topic not in links:
                links[topic] = writer.add_connection(topic, kind, typestore=store)
            said = store.deserialize_cdr(data, kind)  # theirs reads ours ...
            assert said.header.frame_id == "odom"
            writer.write(links[topic], round(stamp * 1e9), store.serialize_cdr(said, kind))  # ... and ours reads theirs
    (found,) = read_bag(bag, Mapping())
    assert (found.source.format, found.source.file) == ("rosbag2", "walk")
    truth = np.array([robot_at(float(t), 0.5) for t in times()])
    np.testing.assert_allclose(found.robot.poses, truth, atol=1e-9)
    assert len(found.people) == 2
    mapping = Mapping.model_validate(
        {"runs": [{"name": "a", "from_s": 0, "to_s": 3}, {"name": "b", "from_s": 3}], "pairs": [("a", "b")]}
    )
    assert import_recordings(tmp_path, "study_room", mapping).trajectories == 2


def test_ours_opens_in_mcap_and_says_the_same(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    ours = load_queries("study_room/queries_500").queries[0].trajectory_a
    (tmp_path / "ours.mcap").write_bytes(to_mcap(ours))
    with (tmp_path / "ours.mcap").open("rb") as opened:
        summary = make_reader(opened, validate_crcs=True).get_summary()
        assert {one.topic for one in summary.channels.values()} == {"/odom", "/people", "/goal_pose"}
    (back,) = read_bag(tmp_path / "ours.mcap", Mapping())
    np.testing.assert_allclose(back.robot.poses, ours.poses, atol=1e-5)
    assert back.goal is not None
    assert (back.goal.x, back.goal.y) == pytest.approx((ours.scene.goal.x, ours.scene.goal.y))
    (person,) = back.people.values()
    assert person.poses[0, 0] == pytest.approx(ours.scene.person.pose.x)


def test_ours_decodes_with_the_schema_that_it_holds(tmp_path: Path) -> None:
    decoding = pytest.importorskip("mcap_ros2.decoder")
    from mcap.reader import make_reader

    ours = load_queries("study_room/queries_500").queries[0].trajectory_a
    reader = make_reader(io.BytesIO(to_mcap(ours)), decoder_factories=[decoding.DecoderFactory()])
    places = [
        (said.pose.pose.position.x, said.pose.pose.position.y)
        for _, channel, _, said in reader.iter_decoded_messages()
        if channel.topic == "/odom"
    ]
    np.testing.assert_allclose(places, ours.poses[:, :2], atol=1e-5)


def test_without_people_or_goal_these_are_absent(tmp_path: Path) -> None:
    for name, aside in RUNS.items():
        alone = [said for said in messages(aside) if said[0] == "/odom"]
        write_mcap(tmp_path / "hall" / f"{name}.mcap", alone)
    one = import_recordings(tmp_path, "study_room").query_set.queries[0].trajectory_a
    assert one.recorded.has == ("poses", "heading")
    assert one.outcome == Outcome.RUNNING


def nonsense(topic: str, data: bytes) -> list[tuple[str, str, float, bytes]]:
    said = list(messages(0.5))
    said[10] = (topic, said[10][1] if topic == "/odom" else POSE_ARRAY, said[10][2], data)
    return said


def moved(k: int, **changed: object) -> list[tuple[str, str, float, bytes]]:
    """The message of /odom with that number, otherwise."""
    said = [one for one in messages(0.5) if one[0] == "/odom"]
    t = float(times()[k])
    given = {"stamp": START + t, "frame": "odom", "place": robot_at(t, 0.5), **changed}
    data = encode_odometry(given["stamp"], given["frame"], given["place"], (0, 0, 0))
    said[k] = ("/odom", ODOMETRY, START + t, data)
    return said


WRONG = {
    "no odometry": (
        [one for one in messages(0.5) if one[0] == "/people"],
        r"topic /odom: is not in the bag; map another with `topics: \{pose: ...\}`. There are /people \(geometry_msgs",
    ),
    "another type": (
        [("/odom", "std_msgs/msg/String", START, b"\0\1\0\0")],
        r"topic /odom, type = 'std_msgs/msg/String': must be one of nav_msgs/msg/Odometry",
    ),
    "NaN poses": (
        moved(5, place=(float("nan"), 0.0, 0.0)),
        r"topic /odom, message 5, x of the robot = nan: must be a finite",
    ),
    "time going back": (moved(5, stamp=START), r"topic /odom, message 5, time of the robot = 1700000000.0: goes back"),
    "a wrong frame": (moved(5, frame="map"), r"topic /odom, message 5, frame = 'map': must be 'odom'"),
    "people in another frame": (list(messages(0.5, people_frame="map")), r"topic /people, message 0, frame = 'map'"),
    "a torn message": (
        nonsense("/odom", b"\0\1\0\0\1\2\3"),
        r"topic /odom, message 5: ends after 7 bytes, in the middle",
    ),
    "another encoding within": (nonsense("/odom", b"\7\7\7\7"), r"topic /odom, message 5: is no CDR of ROS 2"),
    "a crowd of millions": (
        nonsense("/people", encode_poses(START, "odom", [])[:-4] + struct.pack("<I", 4_000_000_000)),
        r"topic /people, message [0-9]+: holds 4000000000 of something; at most 1000",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_named_by_topic(tmp_path: Path, wrong: str) -> None:
    said, message = WRONG[wrong]
    file = write_mcap(tmp_path / "walk.mcap", said)
    with pytest.raises(RecordingError, match=f"walk.mcap, {message}"):
        import_recordings(file, "study_room")


def test_a_topic_that_is_named_must_be_there(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "walk.mcap", messages(0.5))
    with pytest.raises(RecordingError, match="topic /crowd: is not in the bag"):
        read_bag(file, Mapping(topics=Topics(people="/crowd")))


def test_a_cut_bag_says_how_far_it_went(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "walk.mcap", messages(0.5))
    file.write_bytes(file.read_bytes()[:9_000])
    with pytest.raises(RecordingError, match=r"walk.mcap, after message [0-9]+: is cut or no MCAP .*mcap recover"):
        read_bag(file, Mapping())
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"empty \(0 bytes\)"):
        read_bag(tmp_path / "empty.mcap", Mapping())


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """A chunk that says it is small and is a gigabyte of zeros; and one that says it is a gigabyte."""
    zstandard = pytest.importorskip("zstandard")
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, Header

    bomb = zstandard.ZstdCompressor().compress(bytes(300 * 2**20))
    for says, message in ((1_000, "bytes unpacked, it says 1000"), (300 * 2**20, "268435456 of a chunk")):
        builder = RecordBuilder()
        Header(profile="", library="").write(builder)
        Chunk(
            compression="zstd", data=bomb, message_start_time=0, message_end_time=0, uncompressed_crc=0,
            uncompressed_size=says,
        ).write(builder)  # fmt: skip
        (tmp_path / "bomb.mcap").write_bytes(b"\x89MCAP0\r\n" + builder.end())
        with pytest.raises(RecordingError, match=message):
            read_bag(tmp_path / "bomb.mcap", Mapping())


def test_too_many_topics_or_messages_are_refused(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "walk.mcap", messages(0.5))
    for bounds, message in (
        (replace(BOUNDS, topics=1), "at most 1 are read"),
        (replace(BOUNDS, rows=20), "topic /odom, message 20: at most 20 messages of a topic"),
        (replace(BOUNDS, bag_bytes=100), "at most 100 are read; cut the bag"),
        (replace(BOUNDS, message_bytes=100), "bytes; at most 100"),
        (replace(BOUNDS, poses=5), "poses; at most 5 of a bag"),
    ):
        with pytest.raises(RecordingError, match=message):
            read_bag(file, Mapping(), bounds)


def test_an_sqlite_file_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.db3"
    connection = sqlite3.connect(file)
    connection.execute("CREATE VIEW messages AS SELECT 1")
    connection.execute("CREATE TABLE topics (id)")
    connection.commit()
    connection.close()
    with pytest.raises(RecordingError, match="has no tables topics and messages"):
        read_bag(file, Mapping())
    file.write_bytes(file.read_bytes()[:600])
    with pytest.raises(RecordingError, match=r"other.db3"):
        read_bag(file, Mapping())
    file.write_bytes(b"zstd")
    with pytest.raises(RecordingError, match="is no SQLite file"):
        read_bag(file, Mapping())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    return write_mcap(folder / "walk.mcap", list(messages(0.5))[:30], "NONE").read_bytes()


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 6_000), st.binary(min_size=1, max_size=8))
def test_whatever_bytes_stand_there_it_is_read_or_refused(tmp_path: Path, whole: bytes, at: int, noise: bytes) -> None:
    file = tmp_path / "any.mcap"
    file.write_bytes(whole[:at] + noise + whole[at + len(noise) :])
    assert refusal(read_bag, file) in ("", "any.mcap")


def with_map(aside: float, *, linked: bool = True, cell_m: float = 0.05) -> list[tuple[str, str, float, bytes]]:
    """The run with a wall 2 m to the left in a map's frame, in which the odometry's origin is at 10 m."""
    cells = np.zeros((40, 220), dtype=np.int8)
    cells[:, 0], cells[39, 1:] = -1, 100
    grid = encode_grid("map", cells.tobytes(), 220, 40, cell_m, (9.0, 0.0, 0.0))
    said = [("/map", GRID, START, grid)]
    if linked:
        said.append(("/tf_static", TRANSFORMS, START, encode_transform(START, "map", "odom", (10.0, 0.0, 0.0))))
        said.append(("/tf", TRANSFORMS, START, encode_transform(START, "odom", "base_link", (0.0, 0.0, 0.0))))
    return [*said, *messages(aside)]


def test_a_map_in_a_bag_is_walls_and_transforms_bring_all_into_its_frame(tmp_path: Path) -> None:
    for name, aside in RUNS.items():
        write_mcap(tmp_path / "hall" / f"{name}.mcap", with_map(aside))
    found = import_recordings(tmp_path / "hall", "study_room")
    one = found.query_set.queries[0].trajectory_a
    assert "obstacles" in one.recorded.has
    assert one.poses[0, 0] == pytest.approx(10.0, abs=0.01)  # the robot starts at the odometry's origin
    people = one.scene.people_at(one.times)
    assert np.abs(people[:, 0] - (10.0 + ANNA[0], ANNA[1])).max(axis=1).min() < 1e-6
    (wall,) = one.scene.obstacles
    assert (wall.kind, wall.length, wall.width) == ("wall", pytest.approx(10.95), pytest.approx(0.05))
    assert (wall.pose.x, wall.pose.y) == (pytest.approx(9.0 + 0.05 + 5.475), pytest.approx(1.975))
    assert any("were brought into 'map'" in how for how in one.recorded.how)


def test_a_map_in_no_known_frame_is_left_out_and_one_that_was_named_refused(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "hall" / "one.mcap", with_map(0.0, linked=False))
    (found,) = read_bag(file, Mapping())
    assert found.things == ()
    assert any("the map was left out: its frame 'map'" in how for how in found.how)
    with pytest.raises(RecordingError, match="no transforms lead there"):
        read_bag(file, Mapping(topics=Topics(map="/map")))
    with pytest.raises(RecordingError, match="no transforms \\(/tf\\) are in the bag"):
        read_bag(file, Mapping(frame="map"))
    with pytest.raises(RecordingError, match="resolution = 2"):
        read_bag(write_mcap(tmp_path / "hall" / "two.mcap", with_map(0.0, cell_m=2.0)), Mapping())


def test_a_map_of_many_cells_is_shown_in_larger_ones() -> None:
    from desirepath.recordings.grids import Grid, walls_of

    noise, how = np.random.default_rng(1).random((200, 200)) > 0.7, []
    walls = walls_of(Grid(noise, 0.05, (0.0, 0.0, 0.5)), np.array([[2.0, 2.0], [3.0, 3.0]]), how)
    assert 0 < len(walls) <= BOUNDS.things
    assert "in cells of" in how[0]
    assert {round(one.yaw, 3) for one in walls} == {0.5}
    assert walls_of(Grid(np.zeros((9, 9), bool), 0.05, (0, 0, 0)), np.zeros((1, 2)), []) == ()
