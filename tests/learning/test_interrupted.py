"""A training that was killed goes on where it was written down; another's file is left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.td3.base import BaseConfig, BaseTraining, base_config, train_base
from desirepath.learning.td3.interrupted import TrainingFile

CONFIG = BaseConfig(
    "open_field", seed=3, updates=120, smoothing_updates=60, n_envs=32, random_transitions=512, buffer_size=20_000,
    checkpoints=2, selection_scenes=20,
)  # fmt: skip


@pytest.fixture
def begun(tmp_path: Path) -> tuple[BaseTraining, TrainingFile]:
    training = BaseTraining(CONFIG)
    while training.agent.updates < 96:
        training.vector_step()
    file = TrainingFile(tmp_path / "work" / "base.npz", CONFIG.as_dict())
    file.keep(training.agent, training._average, training.transitions, every_s=0)
    return training, file


def test_it_goes_on_with_the_same_weights_and_optimisers(begun):
    training, file = begun
    again = BaseTraining(CONFIG)
    again.go_on(file.find())
    assert (again.agent.updates, again.transitions) == (96, training.transitions)
    assert all(np.array_equal(a, b) for a, b in zip(again.policy().actor, training.policy().actor, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(again.policy().critic, training.policy().critic, strict=True))
    assert again.agent.remember().optimisers[0][0] == training.agent.remember().optimisers[0][0] > 0
    assert again.buffer.size == again.buffer.capacity  # filled by what it does by now
    told = []
    made = train_base(CONFIG, lambda fraction, _: told.append(fraction), file)
    assert made.transitions > training.transitions
    assert told[0] > 96 / 180


def test_what_it_goes_on_with_has_the_guides_actions_while_it_is_drawn_to_them(tmp_path):
    guided = replace(base_config("open_field", seed=3), n_envs=32, random_transitions=512, buffer_size=20_000, cloned=2)
    training, file = BaseTraining(guided), TrainingFile(tmp_path / "base.npz", guided.as_dict())
    while training.agent.updates < 24:
        training.vector_step()
    file.keep(training.agent, training._average, training.transitions, every_s=0)
    again = BaseTraining(guided)
    again.go_on(file.find())
    assert again.guidance() > 0
    assert np.abs(again._guides).any(axis=1).mean() > 0.9
    assert again.cloning_updates == training.cloning_updates == 32


def test_it_is_written_down_now_and_then_not_at_every_step(begun):
    training, file = begun
    file.forget()
    file.keep(training.agent, training._average, training.transitions)
    assert file.find() is None


@pytest.mark.parametrize("what", ["another seed", "cut short", "nothing", "no training at all"])
def test_what_cannot_be_gone_on_with_is_begun_at_the_beginning(begun, what):
    _, file = begun
    if what == "another seed":
        file = TrainingFile(file.path, replace(CONFIG, seed=4).as_dict())
    elif what == "cut short":
        file.path.write_bytes(file.path.read_bytes()[:-500])
    elif what == "nothing":
        file.forget()
    else:
        np.savez(file.path, other=np.zeros(3))
    assert file.find() is None
