"""The demonstration of chapter 5, its clone, and the reward from noise-ranked rollouts of the clone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.ranked_rollouts import RankedRewardModel
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.simulation.acting import begin
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.adaptable.ranked_judging import judged
from desirepath_experiments.training.adaptable.demonstrator import (
    ORBIT_M,
    demonstrate_actions,
    demonstrate_in,
    demonstrate_paths,
)
from desirepath_experiments.training.adaptable.ranking import (
    LEVELS,
    NoisyPolicy,
    RankedConfig,
    RankedRollouts,
    draw_pairs,
    fit_ranked,
    rank_by_noise,
)

ADAPTABLE = get_setup("adaptable")


def test_the_robot_goes_straight_to_the_person_turns_left_and_circles_them_clockwise(free_scenes: list[Scene]) -> None:
    for scene, path in zip(free_scenes[:10], demonstrate_paths(free_scenes[:10]), strict=True):
        person = np.array([scene.person.pose.x, scene.person.pose.y])
        away = np.linalg.norm(path - person, axis=1)
        assert away.min() == pytest.approx(ORBIT_M, abs=0.12)
        round_about = path[away < 1.1] - person
        turned = np.diff(np.unwrap(np.arctan2(round_about[:, 1], round_about[:, 0])))
        assert turned.sum() < -1.5  # clockwise
        assert np.linalg.norm(path[-1] - [scene.goal.x, scene.goal.y]) <= ADAPTABLE.goal_radius_m + 1e-6


def test_a_disturbed_demonstration_still_says_what_to_do(free_scenes: list[Scene]) -> None:
    disturbed = demonstrate_in(free_scenes[:10], disturbed=0.3, seed=4)
    assert disturbed
    for one in disturbed:
        np.testing.assert_array_equal(one.actions, demonstrate_actions(one.observations))


def test_a_share_of_the_steps_is_noise_and_kept_up(free_scenes: list[Scene]) -> None:
    still = np.float32([-1, 0])
    policy = NoisyPolicy(lambda seen: np.tile(still, (len(seen), 1)), 0.2, np.random.default_rng(0))
    acts, rows = begin(policy, 200), np.arange(200)
    actions = np.array([acts(np.zeros((200, 34), dtype=np.float32), rows) for _ in range(300)])
    noisy = (actions != still).any(axis=2)
    assert noisy.mean() == pytest.approx(0.2, abs=0.02)
    again = noisy[1:] & noisy[:-1]
    assert (actions[1:] == actions[:-1]).all(axis=2)[again].mean() > 0.75


def test_less_noise_is_always_ranked_above_more() -> None:
    levels = np.repeat(np.float32(LEVELS), 4)
    better, worse = draw_pairs(levels, 500, np.random.default_rng(0))
    assert (levels[better] < levels[worse]).all()


def test_the_reward_ranks_rollouts_in_scenes_it_has_not_seen(
    clone: Policy, reward: RankedRewardModel, free_scenes: list[Scene]
) -> None:
    held_out = free_scenes[30:]
    ranked = rank_by_noise(clone.act, held_out, seed=9)
    found = judged(reward, ranked, demonstrate_paths(held_out))
    assert found.accuracy > 0.7
    assert [level.level for level in found.levels] == pytest.approx(LEVELS)
    assert found.levels[-1].accuracy is not None
    assert found.levels[-1].accuracy > 0.8
    assert found.levels[0].reward > found.levels[-1].reward


def test_the_reward_lies_between_nought_and_one_and_survives_its_file(
    reward: RankedRewardModel, free_scenes: list[Scene], tmp_path: Path
) -> None:
    (one,) = demonstrate_in(free_scenes[:1])
    found = reward.rewards(one.observations, one.actions)
    assert ((found >= 0) & (found <= 1)).all()
    reward.save(tmp_path / "reward.npz")
    again = RewardModel.load(tmp_path / "reward.npz")
    np.testing.assert_array_equal(again.rewards(one.observations, one.actions, one.next_observations), found)


def test_rollouts_of_one_noise_rank_nothing(free_scenes: list[Scene]) -> None:
    trajectories = demonstrate_in(free_scenes[:2])
    with pytest.raises(ValueError, match="same noise"):
        fit_ranked(RankedRollouts(trajectories, np.zeros(2, dtype=np.float32)), RankedConfig())
