"""The planner that policies imitate knows the scene, gets around everything, and does not waver between two ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.analysis.metrics import success_rate
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.way_guide import WayGuide
from desirepath.simulation.crowds.planning_kernels import arrival_times
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scene import Pose
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome


@pytest.mark.parametrize("setup", ["open_field", "study_room"])
def test_the_guide_gets_there_around_everything(setup):
    scenes = scene_set(setup, 60, purpose=Purpose.SELECT, seed=0)
    engine = make_engine(get_setup(setup), len(scenes), auto_reset=False, scenes=scenes)
    guide = WayGuide(engine)
    while not engine.dones.all():
        engine.step(guide.act())
    assert success_rate(engine.outcomes) > 0.97


def test_the_guide_knows_the_new_scene_after_a_restart():
    engine = make_engine(get_setup("study_room"), 8, seed=1)
    guide = WayGuide(engine)
    arrived = 0
    for _ in range(150):
        engine.step(guide.act())
        assert not (engine.outcomes == Outcome.COLLISION).any()
        arrived += int((engine.outcomes[engine.dones] == Outcome.SUCCESS).sum())
    assert arrived > 16  # each of the eight more than twice


def test_ways_in_the_open_are_as_long_as_they_are_straight_in_any_direction():
    times = np.empty((60, 50), dtype=np.float32)
    arrival_times(np.ones_like(times), 20.3, 30.8, times)
    i, j = np.indices(times.shape)
    straight = np.hypot(i + 0.5 - 20.3, j + 0.5 - 30.8)
    far = straight > 5
    assert np.abs(times[far] / straight[far] - 1).max() < 0.06


def test_a_wall_is_gone_around():
    costs = np.ones((40, 40), dtype=np.float32)
    costs[20, :35] = 1_000
    times = np.empty_like(costs)
    arrival_times(costs, 10.5, 5.5, times)
    around = np.hypot(20 - 10, 35 - 5) + np.hypot(30 - 20, 35 - 5)
    assert times[30, 5] == pytest.approx(around, rel=0.06)


def test_of_two_ways_as_short_it_takes_the_one_that_it_faces():
    """The clone of one that decides by the place alone turns to and fro before a person in the middle."""
    (scene,) = scene_set("open_field", 1, purpose=Purpose.SELECT, seed=0)
    between = replace(scene.person, pose=Pose(0.0, 0.0, 0.0))
    turns = []
    for yaw in (0.4, -0.4):
        ahead = replace(scene, start=Pose(-1.0, 0.0, yaw), goal=Pose(3.0, 0.0, 0.0), person=between, obstacles=())
        engine = make_engine(get_setup("open_field"), 1, auto_reset=False, scenes=[ahead])
        turns.append(float(WayGuide(engine).act()[0, 1]))
    assert turns[0] > 0 > turns[1]
