"""Drivers with a memory: a robot that is stuck is freed, drives on as usual, and stands where nothing frees it."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.deploy.steering import Recovery
from desirepath.simulation.acting import (
    ActFunction,
    EpisodeActs,
    EpisodicPolicy,
    Floats,
    RecoveringPolicy,
    Rows,
)
from desirepath.simulation.fast import evaluate, rollout
from desirepath.simulation.reference import rollout_reference
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import CONTROL_DT_S, SetupError, get_setup
from desirepath.simulation.trajectory import Outcome
from tests.simulation.simple_policies import towards_goal

CORRIDOR = get_setup("corridor")
STUDY_ROOM = get_setup("study_room")

SETUP = STUDY_ROOM
PATIENCE = round(Recovery().patience_s / CONTROL_DT_S)


def circling(observations: Floats) -> Floats:
    """Narrow circles on the spot: never nearer to the goal."""
    return np.tile(np.array([-0.9, 0.9], dtype=np.float32), (len(observations), 1))


def straight(observations: Floats) -> Floats:
    """Turn to the goal on the spot, then go."""
    actions = towards_goal(SETUP)(observations)
    actions[:, 0] = np.where(np.abs(observations[:, 1]) > 0.05, -1.0, 1.0)
    return actions


def half_way(observations: Floats) -> Floats:
    """At the goal until it is 1.5 m near, then circles: free robots get stuck again."""
    actions = straight(observations)
    near = observations[:, 0] * SETUP.distance_scale_m < 1.5
    actions[near] = circling(observations[near])
    return actions


def arriving(*, count: int) -> list[Scene]:
    """Scenes in which whoever goes straight to the goal arrives."""
    scenes = draw_scenes(SETUP, range(700, 760))
    table = evaluate(straight, SETUP, scenes)
    return [scene for scene, success in zip(scenes, table.success, strict=True) if success][:count]


def test_stuck_robots_are_freed_and_those_that_get_on_never_notice() -> None:
    scenes = arriving(count=8)
    stuck = evaluate(circling, SETUP, scenes)
    freed = evaluate(RecoveringPolicy(SETUP, circling, [straight]), SETUP, scenes)
    assert not stuck.success.any()
    assert freed.success.mean() > 0.5
    assert (freed.steps[freed.success] > PATIENCE).all()
    undisturbed = RecoveringPolicy(SETUP, straight, [circling])
    for ours, plain in zip(rollout(SETUP, undisturbed, scenes), rollout(SETUP, straight, scenes), strict=True):
        np.testing.assert_array_equal(ours.actions, plain.actions)


def test_free_again_it_drives_as_usual() -> None:
    scene = arriving(count=1)
    driver = RecoveringPolicy(SETUP, half_way, [straight], Recovery(patience_s=2.0, free_m=0.3))
    (drive,) = rollout(SETUP, driver, scene)
    ways = [int(np.allclose(action, [-0.9, 0.9])) for action in drive.actions]
    changes = np.count_nonzero(np.diff(ways))
    assert drive.outcome == Outcome.SUCCESS
    assert changes >= 4  # straight, circles, freed, circles, freed, ...


def test_where_nothing_frees_it_the_robot_stands_until_its_time_is_up() -> None:
    scene = arriving(count=1)
    (drive,) = rollout(SETUP, RecoveringPolicy(SETUP, circling, [circling]), scene)
    assert drive.outcome == Outcome.TIMEOUT
    np.testing.assert_array_equal(
        drive.actions[4 * PATIENCE :], np.tile([-1.0, 0.0], (len(drive.actions) - 4 * PATIENCE, 1))
    )
    (shuttling,) = rollout(SETUP, circling, scene)
    assert drive.self_intersections < shuttling.self_intersections


def test_every_episode_has_a_memory_of_its_own() -> None:
    scenes = arriving(count=5)
    driver = RecoveringPolicy(SETUP, half_way, [straight])
    together = rollout(SETUP, driver, scenes)
    alone = [rollout(SETUP, driver, [scene])[0] for scene in scenes]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one.actions, other.actions)


def test_pybullet_asks_drivers_with_a_memory_alike() -> None:
    scene = arriving(count=1)
    (drive,) = rollout_reference(SETUP, RecoveringPolicy(SETUP, circling, []), scene, max_steps=3 * PATIENCE)
    np.testing.assert_array_equal(drive.actions[-1], [-1.0, 0.0])


def test_who_remembers_is_asked_with_the_rows_still_running() -> None:
    asked: list[Rows] = []

    class Counting(EpisodicPolicy):
        def act(self, observations: Floats) -> Floats:
            return straight(observations)

        def begin(self, episodes: int) -> EpisodeActs:
            def steer(observations: Floats, rows: Rows) -> Floats:
                asked.append(rows)
                return self.act(observations)

            return steer

    evaluate(Counting(), SETUP, arriving(count=4))
    assert asked[0].tolist() == [0, 1, 2, 3]
    assert len(asked[-1]) < 4


def test_setups_whose_observation_does_not_begin_with_the_goal_are_refused() -> None:
    usual: ActFunction = towards_goal(CORRIDOR)
    with pytest.raises(SetupError, match="corridor observes closest points"):
        RecoveringPolicy(CORRIDOR, usual, [])
