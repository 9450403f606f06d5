"""Base training really learns, and the same seed learns the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from desirepath.analysis.metrics import success_rate, timeout_rate
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import BaseConfig, BaseResult, BaseTraining, smoothness_penalty_gradient, train_base
from desirepath.learning.td3.replay import collect
from desirepath.simulation.disturbed import DisturbedEngine
from desirepath.simulation.fast import evaluate


def test_a_short_training_changes_the_weights_and_says_what_it_did(
    tiny_base: BaseResult, tiny_config: BaseConfig
) -> None:
    untrained = BaseTraining(tiny_config).policy()
    assert any(not np.array_equal(a, b) for a, b in zip(untrained.actor, tiny_base.policy.actor, strict=True))
    assert tiny_base.policy.critic
    assert len(tiny_base.history) == 2 * tiny_config.checkpoints  # as it is, and averaged
    assert tiny_base.selection_success == max(entry["success_rate"] for entry in tiny_base.history)


def test_the_same_seed_gives_the_same_policy_bit_by_bit(tiny_base: BaseResult, tiny_config: BaseConfig) -> None:
    assert train_base(tiny_config).policy.digest() == tiny_base.policy.digest()
    assert train_base(replace(tiny_config, seed=4)).policy.digest() != tiny_base.policy.digest()


def test_with_randomise_it_learns_among_disturbed_robots_and_its_card_says_so(tiny_config: BaseConfig) -> None:
    config = replace(tiny_config, randomise=True)
    training = BaseTraining(config)
    for _ in range(3):
        training.vector_step()
    assert isinstance(training.collector.engine, DisturbedEngine)
    plain = BaseTraining(tiny_config)
    plain.vector_step()
    assert not isinstance(plain.collector.engine, DisturbedEngine)
    assert config.as_dict() == tiny_config.as_dict() | {"randomise": True}
    assert "randomise" not in tiny_config.as_dict()  # of policies trained before there was any, no card changes


def test_the_progress_term_enters_base_training_only(tiny_base: BaseResult, tiny_config: BaseConfig) -> None:
    """Core rewards of the open field are sparse: a regenerated buffer holds no reward per metre."""
    training = BaseTraining(replace(tiny_config, progress_weight=1.0))
    training.vector_step()
    assert (training.buffer.filled().rewards != 0).float().mean() > 0.9
    regenerated = collect(tiny_base.policy, 2_000, noise=(0.05, 0.5), seed=1)
    assert (regenerated.filled().rewards != 0).float().mean() < 0.1


def test_a_seed_that_stood_still_with_a_short_random_phase_drives() -> None:
    """Seed 1 learned never to drive, when replay held no ended episode before the first updates."""
    training = BaseTraining(BaseConfig(setup="open_field", seed=1, buffer_size=100_000))
    while training.agent.updates < 1_500:
        training.vector_step()
    scenes = scene_set("open_field", 100, purpose=Purpose.SELECT, seed=0)
    table = evaluate(training.policy().act, training.setup, scenes)
    assert success_rate(table.outcome) > 0.1
    assert timeout_rate(table.outcome) < 0.9


def test_a_regenerated_buffer_is_the_same_for_the_same_seed(tiny_base: BaseResult) -> None:
    digests = [collect(tiny_base.policy, 1_000, noise=(0.05, 0.5), seed=seed).digest() for seed in (1, 1, 2)]
    assert digests[0] == digests[1] != digests[2]


def test_turning_costs_only_in_the_smoothing_updates() -> None:
    training = BaseTraining(BaseConfig(setup="open_field", n_envs=4, updates=100, smoothing_updates=40))
    weights = []
    for updates in (0, 100, 110, 120, 140):
        training.agent.updates = updates
        weights.append(training.smoothness_penalty())
    assert weights[:2] == [0, 0]
    assert 0 < weights[2] < weights[3] == weights[4] == training.config.smoothness_penalty
    actions = torch.tensor([[0.3, -1.0], [-1.0, 0.5]]).requires_grad_(True)
    torch.autograd.backward(0.2 * (actions[:, 1] ** 2).mean())
    assert actions.grad is not None
    assert smoothness_penalty_gradient(actions.detach().numpy(), 0.2).tolist() == actions.grad.tolist()


def test_the_learning_rate_falls_in_the_second_half_and_again_in_the_smoothing_updates() -> None:
    training = BaseTraining(BaseConfig(setup="open_field", n_envs=4, updates=100, smoothing_updates=40))
    rates = []
    for updates in (0, 50, 75, 100):
        training.agent.updates = updates
        rates.append(training.learning_rate())
    assert rates[0] == rates[1] == training.config.learning_rate
    assert rates[1] > rates[2] > rates[3]
    assert np.isclose(rates[3], training.config.final_learning_rate)
    training.agent.updates = 101
    assert training.learning_rate() == pytest.approx(training.config.smoothing_learning_rate, rel=0.03)
    training.agent.updates = 140
    assert training.learning_rate() == pytest.approx(training.config.final_learning_rate)
