"""A base training that stands still is noticed within its first updates and begun anew with what cures it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.analysis.metrics import success_rate
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3 import base
from desirepath.learning.td3.base import BaseConfig, Look, base_config, train_base
from desirepath.simulation import setups
from desirepath.simulation.fast import evaluate

QUICK = {"smoothing_updates": 50, "n_envs": 64, "random_transitions": 3_000, "buffer_size": 30_000}
STANDS = """\
robot: turtlebot3_burger
world: {name: open_field}
task: {reward: {goal: 20, collision: -500, timeout: 0, self_intersection: -50}}
"""
"""Nothing that moves by chance fares better here than what stands."""


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
    assert 0 < again.guided_share < last.guided_share <= 1
    assert again.guidance > 0


def test_a_base_policy_that_was_drawn_to_the_guide_to_the_end_says_so(tiny_base):
    config = replace(base_config("open_field", seed=1), n_envs=8, buffer_size=5_000)
    training = base.BaseTraining(config)
    assert training.policy().held == base.LAST_GUIDANCE
    training.agent.updates = config.updates + config.smoothing_updates
    assert training.guidance() == base.LAST_GUIDANCE
    assert tiny_base.policy.held == 0


def test_a_training_that_drives_is_left_alone():
    config = replace(base_config("open_field", seed=1), updates=300, checkpoints=1, selection_scenes=50, **QUICK)
    assert train_base(config).restarts == []


def test_a_clone_of_the_guide_drives_before_a_critic_judges():
    config = replace(base_config("study_room", seed=2), n_envs=64, random_transitions=6_400, buffer_size=20_000)
    training = base.BaseTraining(config)
    while training.transitions < config.random_transitions:
        assert training.vector_step() == 0
    assert training.cloning_updates == 100 * config.cloned
    scenes = scene_set("study_room", 200, purpose=Purpose.SELECT, seed=0)
    assert success_rate(evaluate(training.policy().act, training.setup, scenes).outcome) > 0.7


def test_settings_without_a_guide_are_stored_as_before_there_was_one():
    assert "guided_share" not in BaseConfig("open_field").as_dict()
    assert base_config("open_field").as_dict()["guided_share"] == base.GUIDED_SHARE
    assert np.isclose(base_config("adaptable").guided_share, base.GUIDED_SHARE)
