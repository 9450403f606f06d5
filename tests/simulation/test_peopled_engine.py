"""Setups with pedestrians under the names of everything else: engine, scenes, rollouts, Gymnasium, refusals."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import desirepath.gymnasium_envs  # noqa: F401 - registers them
from desirepath.simulation.crowds.crowd_engine import CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.crowds.peopled_engine import PeopledEngine
from desirepath.simulation.fast import FastEngine, evaluate, make_engine, rollout, table_of
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.reference import ReferenceEngine
from desirepath.simulation.scene import SceneError
from desirepath.simulation.scenes import draw_scene, draw_scenes
from desirepath.simulation.setups import SETUPS, SetupError, get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

CROWD_HALL = get_setup("crowd_hall")
CROWD_OFFICE = get_setup("crowd_office")
CROWD_SETUPS = [setup for setup in SETUPS.values() if setup.crowded]
STUDY_ROOM = get_setup("study_room")


def slowly(observations: np.ndarray) -> np.ndarray:
    bearing = observations[:, 1]
    return np.stack([np.full(len(bearing), -0.2), np.clip(2 * bearing, -1, 1)], axis=1).astype(np.float32)


def test_the_same_pedestrians_walk_as_in_the_engine_of_chapter_4_and_it_ends_alike() -> None:
    scenes = draw_scenes("crowd_office", range(12))
    engine, crowd = make_engine(CROWD_OFFICE, 12, auto_reset=False, scenes=scenes), CrowdEngine(CROWD_OFFICE, n_envs=12)
    crowd.reset(scenes)
    assert isinstance(engine, PeopledEngine)
    ahead = np.tile(np.float32([0.2, 0.05]), (12, 1))
    while not engine.dones.all():
        engine.step(ahead)
        crowd.step(ahead)
        assert (engine.poses == crowd.poses).all()
        assert (engine.outcomes == crowd.outcomes).all()
        assert engine.rewards == pytest.approx(crowd.rewards, abs=1e-5)


def test_the_robot_is_told_of_the_three_nearest_and_how_they_move() -> None:
    scene = draw_scene("crowd_hall", 3)
    seen = rollout(CROWD_HALL, slowly, [scene], max_steps=10)[0]
    names = [str(one["name"]) for one in CROWD_HALL.observation_layout()]
    assert len(names) == CROWD_HALL.observation_size == seen.observations.shape[1]
    places = scene.people_at(seen.times)
    offsets = places[:, 5] - seen.poses[5, :2]
    apart = np.sort(np.linalg.norm(offsets, axis=1))
    after = dict(zip(names, seen.next_observations[4], strict=True))
    distances = [after["person_distance"], after["pedestrian_1_distance"], after["pedestrian_2_distance"]]
    assert np.array(distances) * 10 == pytest.approx(apart[:3], abs=1e-3)
    nearest = int(np.linalg.norm(offsets, axis=1).argmin())
    moved = np.linalg.norm(places[nearest, 5] - places[nearest, 4]) / 0.2
    assert np.hypot(after["pedestrian_0_along"], after["pedestrian_0_across"]) == pytest.approx(moved, abs=0.02)


def test_people_who_avoid_the_robot_are_kept_as_they_walked_and_judged_there() -> None:
    around = CrowdConditions(moving=(3, 3), standing=(1, 1), behaviour="orca")
    scenes = [draw_crowd_scene("crowd_hall", seed, around) for seed in range(4)]
    trajectories, table = rollout(CROWD_HALL, slowly, scenes), evaluate(slowly, CROWD_HALL, scenes)
    assert all(one.walk is not None for t in trajectories if t.scene.crowd for one in t.scene.crowd.pedestrians)
    assert all(Trajectory.from_bytes(t.to_bytes()) is not None for t in trajectories)
    whole = table.outcome != Outcome.COLLISION
    again = table_of(trajectories)
    assert again.min_human_distance[whole] == pytest.approx(table.min_human_distance[whole], abs=2e-3)


def test_social_metrics_are_of_everybody_not_of_the_one_who_stands() -> None:
    scene = draw_scene("crowd_hall", 5)
    alone = replace(scene, setup="study_room", crowd=None)
    table = evaluate(slowly, CROWD_HALL, [scene])
    among = rollout(CROWD_HALL, slowly, [scene])[0]
    one_person = table_of([replace(among, scene=alone)])
    assert table.social.personal_space_time[0] > one_person.social.personal_space_time[0]
    assert table.min_human_distance[0] < one_person.min_human_distance[0]


@pytest.mark.parametrize("setup", CROWD_SETUPS, ids=lambda setup: setup.name)
def test_every_setup_with_pedestrians_is_a_gymnasium_environment(setup) -> None:
    env = gymnasium.make(f"desirepath/{setup.name}-v0")
    observation, _ = env.reset(seed=1)
    assert observation.shape == (setup.observation_size,)
    assert env.observation_space.contains(env.step(np.float32([0.1, 0.0]))[0])


def test_what_cannot_be_says_so() -> None:
    scene = draw_scene("crowd_hall", 1)
    with pytest.raises(ValueError, match="`make_engine` makes the engine that moves them"):
        FastEngine(CROWD_HALL, 1)
    with pytest.raises(SceneError, match="no pedestrians walk in setup study_room"):
        make_engine(STUDY_ROOM, 1, scenes=[replace(draw_scene("study_room", 1), crowd=scene.crowd)])
    with pytest.raises(SceneError, match="pedestrians walk in setup crowd_hall"):
        make_engine(CROWD_HALL, 1, scenes=[replace(scene, crowd=None)])
    with pytest.raises(SetupError, match="the fast engine has"):
        ReferenceEngine(CROWD_HALL)
