"""Setup `adaptable` as a multi-objective environment, as `mo-gymnasium` defines one: core, demonstration, distance and
efficiency per step. With nine objectives, other setups: `preferences/multi_objective_env.py`.
"""

from __future__ import annotations

from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from desirepath.learning.adaptable.objectives import (
    PENALTY,
    PROGRESS_PER_M,
    REWARDS,
    SIZE,
    DemonstrationReward,
    objective_rewards,
)
from desirepath.simulation.environments import NavigationEnv, TimeLimit

Floats = NDArray[np.float32]


class AdaptableEnv(gymnasium.Env[Floats, Floats]):
    """`NavigationEnv` of `adaptable` whose `step` returns the four rewards (4,) float32, times `scale`.

    demonstration: R_hat of a demonstration; default: the shipped one of the programmed demonstration.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        *,
        seed: int = 0,
        demonstration: DemonstrationReward | None = None,
        scale: float = 1.0,
        time_limit: TimeLimit = "truncated",
    ) -> None:
        self._env = NavigationEnv("adaptable", seed=seed, progress_weight=PROGRESS_PER_M, time_limit=time_limit)
        self.setup = self._env.setup
        self._demonstration, self._scale = demonstration or shipped_demonstration(), np.float32(scale)
        self.observation_space, self.action_space = self._env.observation_space, self._env.action_space
        self.rewards, self.reward_dim = REWARDS, len(REWARDS)
        low = np.array([-np.inf, *[-PENALTY * scale] * SIZE], dtype=np.float32)
        high = np.array([np.inf, *[0.0] * SIZE], dtype=np.float32)
        self.reward_space = cast(spaces.Space[Floats], spaces.Box(low, high, dtype=np.float32))
        self._observation: Floats = np.zeros(self.setup.observation_size, dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """As `NavigationEnv.reset`."""
        super().reset(seed=seed)
        self._observation, info = self._env.reset(seed=seed, options=options)
        return self._observation, info

    def step(self, action: Floats) -> tuple[Floats, Floats, bool, bool, dict[str, Any]]:
        """One control step (0.2 s)."""
        done = np.clip(np.asarray(action, np.float32), -1, 1)[None]
        observation, core, terminated, truncated, info = self._env.step(action)
        terms = objective_rewards(self._observation[None], done, observation[None], self._demonstration)[0]
        self._observation = observation
        rewards = (np.concatenate([[core], terms]) * self._scale).astype(np.float32)
        return observation, rewards, terminated, truncated, info


def shipped_demonstration() -> DemonstrationReward:
    """R_hat of the shipped reward from the programmed demonstration. Raises LearningError where it is missing."""
    from desirepath.installed import DATASETS
    from desirepath.learning.rewards.reward_model import RewardModel

    model = RewardModel.load(DATASETS / "adaptable" / "demonstration_reward.npz")
    return lambda observations, actions: model.rewards(observations, actions, observations)
