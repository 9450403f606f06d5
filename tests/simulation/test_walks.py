"""People who walk while the robot drives: recorded, kept with the scene, replayed alike by both engines."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.analysis.metrics import measure
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.simulation.fast import evaluate, replay, rollout, table_of
from desirepath.simulation.reference import rollout_reference
from desirepath.simulation.scene import Person, Pose, Scene, SceneError
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.simulation.walks import Walk, WalkError

CORRIDOR = get_setup("corridor")

STANDING = demonstration_scene("corridor", 0)
STRAIGHT_ON = np.array([[1.0, 0.0]] * 260, dtype=np.float32)


def walking(*, along: float = 0.0, across: float = 0.0, seconds: float = 10.0) -> Scene:
    """The person walks so far from where they stood, metres."""
    begin = STANDING.person.pose
    times = np.linspace(3.0, 3.0 + seconds, 80)
    share = np.linspace(0, 1, 80)
    poses = np.stack([begin.x + along * share, begin.y + across * share, begin.yaw + 4.0 * share], axis=1)
    walk = Walk.recorded(times, poses)
    start = walk.poses_at([0.0])[0]
    return replace(STANDING, walk=walk, person=Person(Pose(*map(float, start))))


def ahead(observations: np.ndarray) -> np.ndarray:
    goal = np.arctan2(observations[:, 4], observations[:, 3]) / np.pi
    return np.stack([np.ones(len(goal)), np.clip(2 * goal, -1, 1)], axis=1).astype(np.float32)


def test_a_recorded_walk_is_smooth_near_the_record_and_stands_at_its_ends() -> None:
    random = np.random.default_rng(0)
    times = np.sort(random.uniform(5, 17, 300))
    wanted = np.stack([np.cos(times / 3), np.sin(times / 3), times / 3], axis=1)
    walk = Walk.recorded(times, wanted + random.normal(0, 0.01, wanted.shape))
    found = walk.poses_at(times - times[0])
    assert np.linalg.norm(found[:, :2] - wanted[:, :2], axis=1).max() < 0.05
    assert np.abs(np.angle(np.exp(1j * (found[:, 2] - wanted[:, 2])))).max() < 0.1
    assert (walk.poses_at([-3.0]) == walk.poses_at([0.0])).all()
    assert (walk.poses_at([99.0]) == walk.poses_at([walk.duration_s])).all()
    assert len(walk.times_s) < 70


def test_a_walk_travels_with_its_scene_and_standing_scenes_stay_what_they_were() -> None:
    scene = walking(along=-1.0)
    again = Scene.from_dict(json.loads(json.dumps(scene.as_dict())))
    assert again == scene
    assert again.digest() == scene.digest() != STANDING.digest()
    assert "walk" not in STANDING.as_dict()
    (drive,) = replay(CORRIDOR, [scene], [STRAIGHT_ON])
    assert Trajectory.from_bytes(drive.to_bytes()).scene == scene


def test_both_engines_replay_the_walk_alike_and_the_robot_sees_it() -> None:
    scenes = [walking(along=-1.5, across=-0.3), walking(along=1.0), STANDING]
    fast, reference = rollout(CORRIDOR, ahead, scenes), rollout_reference(CORRIDOR, ahead, scenes)
    for a, b in zip(fast, reference, strict=True):
        assert (a.outcome, len(a.actions)) == (b.outcome, len(b.actions))
        assert np.abs(a.observations - b.observations).max() < 0.02
    first = fast[0]
    people = first.scene.person_poses(first.times)
    seen = np.linalg.norm(people[:-1, :2] - first.poses[:-1, :2], axis=1) / CORRIDOR.distance_scale_m
    assert first.observations[:, 0] == pytest.approx(seen, abs=1e-5)
    assert np.ptp(people[:, 0]) > 1.4


def test_distances_are_to_where_the_person_is_at_that_moment() -> None:
    scenes = [walking(along=-2.0, across=-0.3), walking(along=1.0, across=0.1), STANDING]
    table, drives = evaluate(ahead, CORRIDOR, scenes), rollout(CORRIDOR, ahead, scenes)
    by_hand = [np.linalg.norm(d.poses[:, :2] - d.scene.person_poses(d.times)[:, :2], axis=1).min() for d in drives]
    assert table.min_human_distance == pytest.approx(by_hand, abs=1e-4)
    assert table_of(drives).min_human_distance == pytest.approx(by_hand, abs=1e-4)
    assert measure(drives).min_human_distance == pytest.approx(by_hand, abs=1e-4)


def test_who_walks_into_the_driving_robot_has_collided_with_it() -> None:
    into = walking(along=-3.0, across=0.6, seconds=16.0)
    (drive,) = replay(CORRIDOR, [into], [STRAIGHT_ON])
    assert drive.outcome == Outcome.COLLISION
    end = drive.scene.person_poses([drive.duration_s])[0]
    assert math.dist(end[:2], drive.poses[-1, :2]) < 0.48 + 0.1
    assert replay(CORRIDOR, [STANDING], [STRAIGHT_ON])[0].outcome == Outcome.SUCCESS


def test_impossible_walks_are_refused() -> None:
    with pytest.raises(WalkError, match="m/s"):
        Walk((0.0, 1.0), (0.0, 5.0), (0.0, 0.0), (0.0, 0.0))
    with pytest.raises(WalkError, match="rise from 0"):
        Walk((0.0, 0.0), (0.0, 0.1), (0.0, 0.0), (0.0, 0.0))
    with pytest.raises(WalkError, match="fewer than two times"):
        Walk.recorded([1.0, 1.0], [[0, 0, 0], [0, 0, 0]])
    with pytest.raises(WalkError, match="not finite"):
        Walk.recorded([0.0, 1.0], [[0, 0, 0], [0, math.nan, 0]])
    elsewhere = replace(walking(along=-1.0), person=Person(Pose(2.0, 0.9)))
    with pytest.raises(SceneError, match=r"must begin at person\.pose"):
        replay(CORRIDOR, [elsewhere], [STRAIGHT_ON])
    damaged = walking(along=1.0).as_dict()
    damaged["walk"]["x"] = damaged["walk"]["x"][:1]
    with pytest.raises(SceneError, match="walk"):
        Scene.from_dict(damaged)
