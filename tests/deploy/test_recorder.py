"""A run as MCAP: others' readers read it, and it comes back as a trajectory that people can judge."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from desirepath.deploy.inputs import Command, Odometry, Person, Scan
from desirepath.deploy.recorder import TOPICS, Recorder
from desirepath.recordings.importing import import_recordings
from desirepath.recordings.mapping import Mapping

START = 1_700_000_000.0


def run(seconds: float = 8.0, aside: float = 0.0) -> Recorder:
    """A drive of 0.5 m/s past somebody, stopped once, with other weights from half-way on."""
    recorder = Recorder(laser=(0.1, 0.0, math.pi / 2))
    recorder.goal(START, (4.0, 0.0))
    recorder.state(START, "driving")
    for k in range(int(seconds * 5) + 1):
        at = START + 0.2 * k
        bend = aside * math.sin(math.pi * k / (seconds * 5))
        recorder.odometry(Odometry(at, 0.1 * k, bend, 0.0, 0.5, 0.0))
        ranges = np.full(360, 2.5)
        ranges[:10], ranges[10] = math.inf, math.nan
        recorder.scan(Scan(at, -math.pi, math.tau / 360, 0.1, 10.0, ranges))
        recorder.people(at, [Person(2.0, 1.5)])
        recorder.command(at, Command(0.5, 0.1))
        recorder.weights(at, {"farther": 0.2 if 2 * k < seconds * 5 else 0.9})
    recorder.state(at, "stopped", "person within 0.3 m")
    return recorder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recorder = run()
    assert (round(recorder.way_m, 6), recorder.stops) == (4.0, [(START + 8.0, "person within 0.3 m")])
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    path.write_bytes(recorder.finish())
    return path


def test_readers_of_others_find_all_of_it(recorded: Path):
    reader = make_reader(io.BytesIO(recorded.read_bytes()), decoder_factories=[DecoderFactory()])
    said: dict[str, list] = {}
    for _, channel, _, message in reader.iter_decoded_messages():
        said.setdefault(channel.topic, []).append(message)
    assert set(said) == set(TOPICS)
    assert len(said["/scan"]) == len(said["/odom"]) == len(said["/cmd_vel"]) == 41
    scan = said["/scan"][3]
    assert (len(scan.ranges), scan.ranges[0], scan.header.frame_id) == (360, math.inf, "laser")
    assert math.isnan(scan.ranges[10])
    assert scan.ranges[100] == pytest.approx(2.5)
    assert said["/odom"][10].pose.pose.position.x == pytest.approx(1.0)
    assert said["/cmd_vel"][0].twist.angular.z == pytest.approx(0.1)
    assert said["/people"][0].poses[0].position.y == pytest.approx(1.5)
    assert said["/tf_static"][0].transforms[0].child_frame_id == "laser"
    assert said["/tf"][5].transforms[0].transform.translation.x == pytest.approx(0.5)
    assert [json.loads(one.data) for one in said["/desirepath/weights"]] == [{"farther": 0.2}, {"farther": 0.9}]
    assert [json.loads(one.data)["reason"] for one in said["/desirepath/state"]] == ["", "person within 0.3 m"]


def test_rosbags_reads_it_too(recorded: Path):
    with AnyReader([recorded]) as reader:
        counts = {one.topic: (one.msgtype, one.msgcount) for one in reader.connections}
        assert counts["/scan"] == ("sensor_msgs/msg/LaserScan", 41)
        scans = [one for one in reader.connections if one.topic == "/scan"]
        connection, stamp, raw = next(reader.messages(connections=scans))
        scan = reader.deserialize(raw, connection.msgtype)
    assert (len(scan.ranges), stamp) == (360, round(START * 1e9))


def test_two_runs_come_back_as_a_pair_to_be_judged(recorded: Path, tmp_path: Path):
    for name, aside in (("straight", 0.0), ("around", -1.0)):
        (tmp_path / f"{name}.mcap").write_bytes(run(aside=aside).finish())
    found = import_recordings(tmp_path, "study_room", Mapping(scene="hall"))
    query = found.query_set.queries[0]
    ways = sorted((query.trajectory_a, query.trajectory_b), key=lambda one: float(one.poses[:, 1].min()))
    assert ways[0].poses[20, 1] == pytest.approx(-1.0, abs=0.02)
    assert ways[1].poses[-1, 0] == pytest.approx(4.0, abs=0.02)
    assert ways[0].scene.goal.x == pytest.approx(4.0)
    assert {"poses", "people", "goal"} <= set(ways[0].recorded.has)
