"""The diversity term is equation 6.2, and it drives the members apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from desirepath.learning.errors import LearningError
from desirepath.learning.td3 import ensemble
from desirepath.learning.td3.base import BaseResult
from desirepath.learning.td3.ensemble import (
    PolicyEnsembleConfig,
    choose_candidates,
    diversity_gradient,
    goal_modulation,
    train_ensemble,
)

TINY = PolicyEnsembleConfig(
    members=3, steps=120, n_envs=10, base_transitions=2_000, selection_scenes=5, kappa=1.0, learning_rate=2e-3
)


def test_goal_modulation_has_the_values_of_table_6_1() -> None:
    assert goal_modulation(np.array([0.0, 2.0, 8.0], dtype=np.float32)).tolist() == [0.25, 0.5, 1.25]


@pytest.mark.parametrize("n", [5, 128])
def test_the_gradient_is_that_of_equation_6_2_written_out(n: int) -> None:
    random = np.random.default_rng(n)
    own = random.uniform(-1, 1, (n, 2)).astype(np.float32)
    others = [random.uniform(-1, 1, (n, 2)).astype(np.float32) for _ in range(3)]
    goal_distance = random.uniform(0, 10, n).astype(np.float32)
    varied = torch.from_numpy(own).double().requires_grad_(True)
    loss = torch.zeros((), dtype=torch.float64)
    for row in range(n):
        apart = sum(((varied[row] - torch.from_numpy(other[row])) ** 2).sum() for other in others)
        loss = loss - (0.0625 / 2**2) * (goal_distance[row] / 8 + 0.25) * apart / n
    torch.autograd.backward(loss)
    assert varied.grad is not None
    expected = varied.grad.numpy()
    gradient = diversity_gradient(own, others, goal_distance, 0.0625)
    np.testing.assert_allclose(gradient, expected, atol=1e-6 * np.abs(expected).max(), rtol=1e-5)


def test_members_differ_more_with_the_term_than_without(tiny_base: BaseResult, monkeypatch: pytest.MonkeyPatch) -> None:
    freely = replace(TINY, min_success=0.0)  # a tiny base policy succeeds nowhere: choose by difference alone
    with_term = train_ensemble(tiny_base.policy, freely)
    without = train_ensemble(tiny_base.policy, replace(freely, kappa=0.0))
    assert len(with_term.members) == len(with_term.success_rates) == 3
    assert with_term.diversity > 1.5 * without.diversity
    assert with_term.base_buffer_sha256 == without.base_buffer_sha256
    monkeypatch.setattr(ensemble, "HELD_LOOSELY", 4.0)
    held = train_ensemble(replace(tiny_base.policy, held=4.0), freely)
    assert 0 < held.diversity < with_term.diversity


def test_members_that_learn_at_the_same_time_become_what_they_become_one_after_the_other(tiny_base: BaseResult) -> None:
    short = replace(TINY, steps=30, checkpoints=1)
    one_by_one, at_once = (train_ensemble(tiny_base.policy, short, threads=threads) for threads in (1, 3))
    for one, other in zip(one_by_one.members, at_once.members, strict=True):
        for weights, same in zip(one.actor, other.actor, strict=True):
            np.testing.assert_array_equal(weights, same)
    assert one_by_one.diversity == at_once.diversity > 0


def test_candidates_are_chosen_by_success_first_and_difference_second() -> None:
    success = np.array([[0.95, 0.5, 0.99], [0.97, 0.8, 0.50], [0.99, 0.7, 0.96]])
    actions = np.zeros((3, 3, 1, 2), dtype=np.float32)
    actions[:, 0, 0, 0] = [-1.0, 0.0, 0.5]  # the first member differs most at its first checkpoint
    actions[:, 2, 0, 0] = [0.2, 9.0, 1.0]  # the third at its second, but that one fails half the time
    assert choose_candidates(success, actions, 0.9) == [0, 1, 2]  # the second never reaches 0.9: its best
    assert choose_candidates(success, actions, 0.0)[2] == 1


def test_an_actor_alone_cannot_start_an_ensemble(tiny_base: BaseResult) -> None:
    with pytest.raises(LearningError, match="no critic"):
        train_ensemble(tiny_base.policy.without_critic(), TINY)


def test_one_member_is_no_ensemble(tiny_base: BaseResult) -> None:
    with pytest.raises(LearningError, match="at least 2"):
        train_ensemble(tiny_base.policy, replace(TINY, members=1))
