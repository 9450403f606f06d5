"""A base training that stands still is noticed within its first updates and begun anew with what cures it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.analysis.metrics import collision_rate, success_rate
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3 import base
from desirepath.learning.td3.base import BaseConfig, Look, base_config, train_base
from desirepath.learning.td3.goal_seeker import GoalSeeker
from desirepath.simulation import setups
from desirepath.simulation.fast import evaluate
from desirepath.simulation.setups import get_setup

QUICK = {"smoothing_updates": 50, "n_envs": 64, "random_transitions": 3_000, "buffer_size": 30_000}
STANDS = """\
robot: turtlebot3_burger
world: {name: open_field}
task: {reward: {goal: 20, collision: -500, timeout: 0, self_intersection: -50}}
"""
"""Nothing that moves by chance fares better here than what stands."""


@pytest.mark.parametrize(("setup", "least"), [("open_field", 0.85), ("study_room", 0.85)])
def test_the_goal_seeker_gets_there_without_any_training(setup, least):
    scenes = scene_set(setup, 60, purpose=Purpose.SELECT, seed=0)
    table = evaluate(GoalSeeker(get_setup(setup)).act, get_setup(setup), scenes)
    assert success_rate(table.outcome) > least
    assert collision_rate(table.outcome) < 0.05


def test_standing_still_is_noticed_said_and_begun_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "stands_still"
    folder.mkdir()
    (folder / "setup.yaml").write_text(STANDS)
    monkeypatch.setattr(setups, "_included", [])
    setups.include(folder)
    monkeypatch.setattr(base, "LOOKS", (Look(1, 1.0), Look(250, 0.05)))
    monkeypatch.setattr(base, "MOST_RESTARTS", 1)
    told = []
    config = replace(BaseConfig("stands_still", seed=3, updates=300, checkpoints=1, selection_scenes=50), **QUICK)
    made = train_base(config, lambda _, metrics: told.append(metrics))
    (restart,) = made.restarts
    assert restart["seed"] == 3
    assert restart["updates"] <= 300
    assert restart["success_rate"] < 0.05
    assert [one["begun_anew"] for one in told if "begun_anew" in one] == [1.0]


def test_what_begins_anew_has_another_seed_and_more_of_the_guide():
    config = BaseConfig("study_room", seed=4)
    first, again, last = (base._begun_anew(config, times) for times in range(3))
    assert first == config
    assert (again.seed, last.seed) == (10_004, 20_004)
    assert 0 < again.seeking_share < last.seeking_share <= 1
    assert again.guidance > 0


def test_a_training_that_drives_is_left_alone():
    config = replace(base_config("open_field", seed=1), updates=300, checkpoints=1, selection_scenes=50, **QUICK)
    assert train_base(config).restarts == []


def test_settings_without_a_seeker_are_stored_as_before_there_was_one():
    assert "seeking_share" not in BaseConfig("open_field").as_dict()
    assert base_config("open_field").as_dict()["seeking_share"] == base.SEEKING_SHARE
    assert np.isclose(base_config("adaptable").seeking_share, base.SEEKING_SHARE)
