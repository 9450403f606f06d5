"""Chapter 7's reward model: one network for many people's answers."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.held_out import accuracy
from desirepath.learning.rewards.interface import InterfaceConfig, InterfaceRewardModel, fit_interface
from desirepath.learning.rewards.reward_model import RewardModel

BRIEF = InterfaceConfig(epochs=60)


@pytest.fixture(scope="module")
def answers() -> list[Preference]:
    return make_oracle("shortest").answer(load_queries("study_room/queries_500").queries[:200])


@pytest.fixture(scope="module")
def model(answers: list[Preference]) -> InterfaceRewardModel:
    return fit_interface(answers[:150], BRIEF)


def test_it_learns_what_the_answers_say(model: InterfaceRewardModel, answers: list[Preference]) -> None:
    """Chapter 7 had 775 answers per view; from 150 it learns about what three quarters of answers say."""
    assert accuracy(model, answers[:150]) > 0.65
    assert accuracy(model, answers[150:]) > 0.65


def test_its_rewards_lie_between_minus_one_and_one(model: InterfaceRewardModel, answers: list[Preference]) -> None:
    trajectory = answers[0].chosen
    rewards = model.rewards(trajectory.observations, trajectory.actions, trajectory.next_observations)
    assert rewards.shape == (len(trajectory.actions),)
    assert np.abs(rewards).max() < 1
    assert [layer.shape for layer in model.layers[:2]] == [(256, 68), (256,)]  # spec 07: 68 inputs, 256 wide


def test_it_is_stored_and_read_back(model: InterfaceRewardModel, answers: list[Preference]) -> None:
    again = RewardModel.from_bytes(model.to_bytes())
    trajectory = answers[1].rejected
    steps = trajectory.observations, trajectory.actions, trajectory.next_observations
    np.testing.assert_array_equal(again.rewards(*steps), model.rewards(*steps))
    assert again.reduction == "mean"


def test_the_same_seed_learns_the_same(answers: list[Preference]) -> None:
    two = [fit_interface(answers[:30], InterfaceConfig(epochs=2, seed=3)) for _ in range(2)]
    np.testing.assert_array_equal(two[0].layers[0], two[1].layers[0])


def test_too_few_answers_are_refused(answers: list[Preference]) -> None:
    with pytest.raises(LearningError, match="answers"):
        fit_interface(answers[:1])
