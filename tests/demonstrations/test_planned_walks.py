"""People who walk planned ways: free of obstacles, the same for the same seed, and part of a demonstration."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.demonstrations.controllers import DWA, roll_out
from desirepath.demonstrations.demonstration import Demonstration, augment, demonstration_from
from desirepath.demonstrations.demonstrators import draw_stroke
from desirepath.demonstrations.planned_walks import MODES, walking_scene
from desirepath.demonstrations.stroke import StrokeProblem
from desirepath.simulation import kernels
from desirepath.simulation.demonstration_scenes import demonstration_scene, demonstration_scenes
from desirepath.simulation.scene import SceneError
from desirepath.simulation.scenes import scene_to_row
from desirepath.simulation.trajectory import Outcome


@pytest.mark.parametrize("mode", MODES)
def test_planned_walks_touch_nothing_and_come_again(mode: str) -> None:
    speeds = []
    for seed, scene in enumerate(demonstration_scenes("room")):
        walked = walking_scene(scene, mode, seed)
        assert walked == walking_scene(scene, mode, seed)
        assert walked.walk is not None
        times = np.arange(0.0, walked.walk.duration_s, 0.2)
        people = walked.person_poses(times)
        row = scene_to_row(scene)
        assert min(kernels.surface_distance(row, x, y) for x, y, _ in people) > scene.person.radius
        lengths = np.linalg.norm(np.diff(people[:, :2], axis=0), axis=1)
        assert lengths.sum() > 1.5
        speeds.append(lengths.mean() / 0.2)
        moving = people[:-1][lengths > 0.02], np.diff(people[:, :2], axis=0)[lengths > 0.02]
        facing = np.cos(np.arctan2(moving[1][:, 1], moving[1][:, 0]) - moving[0][:, 2])
        assert np.median(facing) > 0.95  # they look where they go
    assert len({round(speed, 3) for speed in speeds}) > 1
    assert 0.08 <= min(speeds) <= max(speeds) <= 1.6


def test_the_opposite_way_comes_towards_the_robot() -> None:
    scene = demonstration_scene("corridor", 0)
    walked = walking_scene(scene, "opposite", 1)
    assert walked.walk is not None
    begin, end = walked.person_poses([0.0, walked.walk.duration_s])
    assert math.dist(begin[:2], (scene.goal.x, scene.goal.y)) < 2.0
    assert math.dist(end[:2], (scene.start.x, scene.start.y)) < 2.0


def test_a_demonstration_beside_a_walking_person_is_kept_with_the_walk_and_replayed() -> None:
    scene = demonstration_scene("room", 0)
    stroke = draw_stroke("wall_follower", scene, 0)
    found = []
    for seed in range(20):
        walked = walking_scene(scene, "random", seed)
        with contextlib.suppress(StrokeProblem):  # where the two meet
            found.append((demonstration_from(stroke, walked), walked))
            break
    made, walked = found[0]
    again = Demonstration.from_bytes(made.to_bytes())
    assert again.scene.walk == walked.walk
    assert made.trajectory.outcome == Outcome.SUCCESS
    standing = demonstration_from(stroke, replace(scene))
    assert (standing.commands == made.commands).all()
    assert np.abs(standing.trajectory.observations - made.trajectory.observations)[:, :3].max() > 0.1
    assert all(drive.scene.walk == walked.walk for drive in augment(made, 3))


def test_who_walks_into_the_path_is_named() -> None:
    scene = demonstration_scene("corridor", 0)
    stroke = draw_stroke("slow_near_person", scene, 0)
    met = []
    for seed in range(12):
        try:
            demonstration_from(stroke, walking_scene(scene, "opposite", seed))
        except StrokeProblem as problem:
            met.append((problem.code, problem.thing, problem.numbers["after_s"] > 0))
    assert ("collides", "person", True) in met


def test_unknown_modes_are_named_and_baselines_meet_walking_people() -> None:
    scene = demonstration_scene("room", 0)
    with pytest.raises(SceneError, match="opposite, random"):
        walking_scene(scene, "dancing", 0)
    (driven,) = roll_out(DWA, [walking_scene(scene, "random", 3)])
    assert driven.outcome in (Outcome.SUCCESS, Outcome.COLLISION)  # the window does not foresee where people go
