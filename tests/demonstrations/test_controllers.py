"""The controllers that learned ones are compared with: they arrive, and each does what it is for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.analysis.metrics import measure
from desirepath.demonstrations.controllers import BASELINES, DWA, SOCIAL_COST, roll_out
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.dwa import lidar_setup
from desirepath.demonstrations.social_cost import SocialCost
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.preferences.oracles import ORACLE_PREFERENCES, min_human_distance_m
from desirepath.simulation.demonstration_scenes import demonstration_scene, demonstration_scenes
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scene import Person, Pose
from desirepath.simulation.setups import SetupError, demonstration_setups, get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath.simulation.walks import Walk

CORRIDOR = get_setup("corridor")
ROOM = get_setup("room")


@pytest.mark.parametrize("setup", demonstration_setups())
@pytest.mark.parametrize("controller", BASELINES)
def test_both_arrive_in_every_pair_with_the_setups_own_observations(setup: str, controller: str) -> None:
    drives = roll_out(controller, demonstration_scenes(setup))
    assert [d.outcome for d in drives] == [Outcome.SUCCESS] * 4
    size = {"corridor": CORRIDOR, "room": ROOM}[setup].observation_size
    assert all(d.observations.shape[1] == size for d in drives)


def test_social_cost_keeps_more_distance_than_the_window_that_knows_no_person() -> None:
    scenes = demonstration_scenes("room")
    social, window = (measure(roll_out(name, scenes)).min_human_distance for name in (SOCIAL_COST, DWA))
    assert (social > window + 0.1).all()
    assert window.max() < 0.7


def test_the_window_reads_goal_velocity_and_every_beam() -> None:
    setup = lidar_setup(ROOM)
    scene = demonstration_scene("room", 0)
    seen = make_engine(setup, 1, scenes=[scene]).observations[0]
    assert len(seen) == 6 + 360
    turned = make_engine(setup, 1, scenes=[replace(scene, person=replace(scene.person, pose=Pose(-0.1, 0.0, 1.0)))])
    assert (turned.observations[0] == seen).all()  # it cannot tell where the person looks


def test_social_cost_finds_itself_by_the_walls_and_plans_around_who_walks() -> None:
    scene = demonstration_scene("room", 3)
    controller = SocialCost(scene)
    for x, y, yaw in ((-2.0, 1.0, 0.3), (1.0, -0.5, -2.8), (0.5, 1.7, 3.1)):
        seen = make_engine(ROOM, 1, scenes=[replace(scene, start=Pose(x, y, yaw))]).observations[0]
        found = controller.located(seen.astype(np.float64))
        assert (found.x, found.y) == pytest.approx((x, y), abs=1e-4)
        assert found.yaw == pytest.approx(yaw, abs=1e-4)
    begin = scene.person.pose
    times = np.linspace(0, 12, 60)
    poses = np.stack([begin.x + 0.12 * times, begin.y + 0.08 * times, np.full(60, begin.yaw)], axis=1)
    walk = Walk.recorded(times, poses)
    walked = replace(scene, walk=walk, person=Person(Pose(*map(float, walk.poses_at([0.0])[0]))))
    (driven,) = roll_out(SOCIAL_COST, [walked])
    assert driven.outcome == Outcome.SUCCESS
    (standing,) = roll_out(SOCIAL_COST, [scene])
    assert len(driven.poses) != len(standing.poses) or np.abs(driven.poses - standing.poses).max() > 0.05


def test_strangers_are_refused() -> None:
    with pytest.raises(ValueError, match="dwa, social_cost"):
        roll_out("teleport", [demonstration_scene("room", 0)])
    with pytest.raises(SetupError, match="differ"):
        roll_out(DWA, [demonstration_scene("room", 0), demonstration_scene("corridor", 0)])
    with pytest.raises(SetupError, match="differ"):
        roll_out(load_policy("study_room/base"), [demonstration_scene("room", 0)])
    assert roll_out(DWA, []) == []


@pytest.mark.parametrize("environment", ["room", "corridor"])
def test_bots_can_choose_between_drives_of_chapter_two(environment: str) -> None:
    scenes = demonstration_scenes(environment)[:1]
    (close,), (far,) = roll_out("dwa", scenes), [demonstrate("wall_follower", scenes[0], 0).trajectory]
    for name, taste in ORACLE_PREFERENCES.items():
        assert np.isfinite(taste.value([close, far])).all(), name
    near, wide = ORACLE_PREFERENCES["min-human-distance"].value([close, far])
    assert (wide > near) == (min_human_distance_m(far) > min_human_distance_m(close))
