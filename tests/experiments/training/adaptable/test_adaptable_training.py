"""Training, policy file and environments of chapter 5, with tiny budgets and real parts."""

from __future__ import annotations

import gymnasium
import mo_gymnasium
import numpy as np
import pytest

import desirepath.gymnasium_envs
from desirepath.learning.adaptable.objectives import NAMES, check_preference, objective_rewards, thesis_vectors
from desirepath.learning.adaptable.vector_env import AdaptableEnv
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.adaptable import AdaptablePolicy, parse_preference
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.ranked_rollouts import RankedRewardModel
from desirepath.simulation.scenes import draw_scene, draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath_experiments.training.adaptable import training
from desirepath_experiments.training.adaptable.rollouts import roll_out_preferences
from desirepath_experiments.training.adaptable.scalar_env import ScalarVecEnv
from desirepath_experiments.training.adaptable.training import (
    AdaptableConfig,
    AdaptableResult,
    train_adaptable,
    without_person,
)

ADAPTABLE = get_setup("adaptable")

TINY = AdaptableConfig(
    seed=2,
    heads=(32, 32),
    updates=48,
    n_envs=12,
    random_transitions=240,
    cloned_transitions=120,
    buffer_size=2_000,
    solutions_every=24,
    solution_scenes=2,
    selection_scenes=2,
    checkpoints=2,
)


@pytest.fixture(scope="module")
def trained(reward: RankedRewardModel, clone: Policy) -> AdaptableResult:
    return train_adaptable(TINY, reward.rewards, clone.act)


def test_the_same_seed_trains_the_same_policy(
    trained: AdaptableResult, reward: RankedRewardModel, clone: Policy
) -> None:
    again = train_adaptable(TINY, reward.rewards, clone.act)
    assert again.policy.to_bytes() == trained.policy.to_bytes()
    assert (trained.solutions <= 0).all()
    assert trained.transitions == pytest.approx(240 + 120 + 48 // 8 * 12, abs=12)


def test_a_training_whose_robots_stand_still_begins_again_with_other_networks(
    trained: AdaptableResult, reward: RankedRewardModel, clone: Policy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "STANDS_STILL_AFTER", 8)  # this tiny one has two dozen updates until its first look
    monkeypatch.setattr(training, "STANDS_STILL", 2.0)
    monkeypatch.setattr(training, "ATTEMPTS", 2)
    second = train_adaptable(TINY, reward.rewards, clone.act)
    assert len(second.history) == len(trained.history) + 1  # the first attempt's one point stays to be seen
    assert second.history[0] == trained.history[0]
    assert second.policy.to_bytes() != trained.policy.to_bytes()
    assert train_adaptable(TINY, reward.rewards, clone.act).policy.to_bytes() == second.policy.to_bytes()


def test_a_preference_folds_into_an_ordinary_policy(trained: AdaptableResult) -> None:
    seen = np.random.default_rng(0).random((9, 34), dtype=np.float32)
    preference = np.float32([0.2, 0.5, 0.3])
    ordinary = trained.policy.at(preference)
    np.testing.assert_allclose(ordinary.act(seen), trained.policy.act(seen, np.tile(preference, (9, 1))), atol=1e-5)
    again = AdaptablePolicy.from_bytes(trained.policy.to_bytes())
    assert again.at(preference).to_bytes() == ordinary.to_bytes()


@pytest.mark.parametrize("wrong", [[0.5, 0.6, 0.1], [-0.1, 0.6, 0.5], [1, 0], [float("nan"), 1, 0]])
def test_what_is_no_preference_is_refused(wrong: list[float]) -> None:
    with pytest.raises(LearningError, match="preference"):
        check_preference(wrong)


def test_preferences_are_read_as_people_write_them() -> None:
    np.testing.assert_allclose(parse_preference("distance=0.5,efficiency=0.5"), [0, 0.5, 0.5])
    np.testing.assert_allclose(parse_preference(""), 1 / 3)
    with pytest.raises(LearningError, match="speed"):
        parse_preference("speed=1")


def test_the_distance_objective_is_equation_5_2() -> None:
    following = np.zeros((4, 34), dtype=np.float32)
    following[:, 2] = np.array([2.5, 2.0, 1.15, 0.3]) / ADAPTABLE.distance_scale_m
    found = objective_rewards(following, np.zeros((4, 2), np.float32), following, lambda s, a: np.full(len(s), 0.25))
    np.testing.assert_allclose(found[:, 1], [0, 0, -10 * (0.85 / 1.7) ** 2, -10], atol=1e-4)
    np.testing.assert_allclose(found[:, 0], -7.5)
    np.testing.assert_allclose(found[:, 2], -10)


def test_returns_add_up_to_progress_and_penalties(trained: AdaptableResult, reward: RankedRewardModel) -> None:
    scenes, vectors = draw_scenes(ADAPTABLE, range(6)), thesis_vectors()[:6]
    found = roll_out_preferences(trained.policy.act, scenes, vectors, reward.rewards)
    np.testing.assert_allclose(found.returns[:, 3], -10 * found.time_s / 0.2, rtol=1e-4)
    for k, path in enumerate(found.paths):
        goal = np.array([scenes[k].goal.x, scenes[k].goal.y])
        progress = np.linalg.norm(path[0] - goal) - np.linalg.norm(path[-1] - goal)
        assert found.returns[k, 0] == pytest.approx(125 * progress - 1000 * (found.outcome[k] == 2), abs=0.5)


def test_who_may_not_know_the_person_does_not_react_to_them(reward: RankedRewardModel) -> None:
    blind = train_adaptable(
        AdaptableConfig(**{**TINY.as_dict(), "heads": (32, 32), "exploration": (0.05, 0.4), "without_person": True}),
        lambda seen, actions: reward.rewards(without_person(seen), actions),
    )
    seen = np.random.default_rng(1).random((5, 34), dtype=np.float32)
    preferences = np.full((5, 3), 1 / 3, dtype=np.float32)
    np.testing.assert_array_equal(
        blind.policy.act(seen, preferences), blind.policy.act(without_person(seen), preferences)
    )


def test_other_libraries_get_one_reward_or_four(reward: RankedRewardModel) -> None:
    many = AdaptableEnv(demonstration=reward.rewards)
    one = gymnasium.make("desirepath/adaptable-v0")
    scene, action = draw_scene(ADAPTABLE, 3), np.array([1.0, 0.2], np.float32)
    many.reset(options={"scene": scene})
    one.reset(options={"scene": scene})
    for _ in range(10):
        _, vector, *_ = many.step(action)
        _, core, *_ = one.step(action)
        assert vector[0] == pytest.approx(core)
        assert many.reward_space.contains(vector)
    assert many.rewards == ("core", *NAMES)
    weighed = mo_gymnasium.wrappers.LinearReward(many, weight=np.float32([1, 0, 0, 1]))
    _, both, _, _, info = weighed.step(action)
    assert both == pytest.approx(info["vector_reward"][0] - 10, rel=1e-5)
    assert desirepath.gymnasium_envs
    env = ScalarVecEnv(reward.rewards, 4, seed=0)
    observed = env.reset()
    assert observed.shape == (4, 37)
    _, rewards, _, _ = env.step(np.tile(action, (4, 1)))
    assert rewards.shape == (4,)
