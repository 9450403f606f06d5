"""The engine as a multi-objective environment, opened and wrapped by `mo-gymnasium`."""

from __future__ import annotations

import warnings

import gymnasium
import mo_gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import desirepath.gymnasium_envs
from desirepath.learning.preferences.multi_objective_env import REWARDS
from desirepath.learning.preferences.objectives import NAMES
from desirepath.simulation.scenes import draw_scene

IDS = [id for id in gymnasium.registry if id.startswith("desirepath/")]


def test_every_registered_environment_passes_the_libraries_own_check() -> None:
    assert desirepath.gymnasium_envs
    assert len(IDS) == 16
    for name in IDS:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            warnings.filterwarnings("ignore", message=".*(render|spec|reward).*")
            if "mo-" not in name:
                check_env(gymnasium.make(name).unwrapped, skip_render_check=True)
                continue
            many = mo_gymnasium.make(name).unwrapped
            assert many.reward_space.shape == (many.reward_dim,) == (len(many.rewards),)
            # Not mo-gymnasium's LinearReward: it gives the same weights out at every step, which the check refuses.
            weighed = gymnasium.wrappers.TransformReward(many, lambda vector: float(vector.sum()))
            check_env(weighed, skip_render_check=True)


@pytest.mark.parametrize("setup", ["open_field", "study_room"])
def test_the_task_stands_first_and_every_objective_is_priced(setup: str) -> None:
    single = gymnasium.make(f"desirepath/{setup}-v0")
    many = mo_gymnasium.make(f"desirepath/mo-{setup}-v0")
    scene, action, ended = draw_scene(setup, 3), np.array([1.0, 0.4], np.float32), False
    assert np.array_equal(single.reset(options={"scene": scene})[0], many.reset(options={"scene": scene})[0])
    while not ended:
        observation, reward, terminated, truncated, _ = many.step(action)
        ended = terminated or truncated
        assert reward.shape == (1 + len(NAMES),)
        assert many.unwrapped.reward_space.contains(reward)
        again, task, *_ = single.step(action)
        assert np.array_equal(observation, again)
        assert reward[0] == pytest.approx(task)
        assert reward[REWARDS.index("smoother")] == pytest.approx(-0.4)


def test_the_library_runs_many_of_them_at_once_and_counts_their_episodes() -> None:
    makers = [lambda: mo_gymnasium.make("desirepath/mo-adaptable-v0")] * 3
    envs = mo_gymnasium.wrappers.vector.MORecordEpisodeStatistics(mo_gymnasium.wrappers.vector.MOSyncVectorEnv(makers))
    envs.reset(seed=0)
    ahead = np.tile(np.float32([1, 0]), (3, 1))
    ends: list[np.ndarray] = []
    for _ in range(310):
        _, rewards, terminated, truncated, info = envs.step(ahead)
        assert rewards.shape == (3, 4)
        if "episode" in info:
            ends.append(info["episode"]["r"][terminated | truncated])
    assert (np.concatenate(ends)[:, 3] <= -10).all()  # every step costs 10


def test_a_wrapper_of_the_library_weighs_the_rewards() -> None:
    weights = np.eye(len(REWARDS), dtype=np.float32)[REWARDS.index("faster")]
    env = mo_gymnasium.wrappers.LinearReward(mo_gymnasium.make("desirepath/mo-study_room-v0"), weight=weights)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.array([0.0, 0.0], np.float32))
    assert reward == pytest.approx(float(info["vector_reward"][REWARDS.index("faster")]))
    assert reward <= 0
