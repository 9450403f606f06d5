"""The engine as a multi-objective environment, as `mo-gymnasium` defines one: a vector of rewards per step.

Reward 0 is the setup's core reward (arrive, do not collide), the others are the objectives' step terms in the order of
`objectives.py`, unscaled. What weights are worth beside the core reward: `Objective.scale`.
"""

from __future__ import annotations

from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from desirepath.learning.preferences.objectives import NAMES, names_of, step_terms_of
from desirepath.simulation.environments import NavigationEnv, TimeLimit

Floats = NDArray[np.float32]
REWARDS = ("task", *NAMES)


class MultiObjectiveNavigationEnv(gymnasium.Env[Floats, Floats]):
    """`NavigationEnv` on the fast engine whose `step` returns rewards (1 + objectives,) float32 instead of a number.

    `reward_space` says their bounds; `rewards` their names. setup: one that has the nine objectives.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, setup: str, *, seed: int = 0, time_limit: TimeLimit = "truncated") -> None:
        self._env = NavigationEnv(setup, seed=seed, time_limit=time_limit)
        self.setup = self._env.setup
        self.observation_space, self.action_space = self._env.observation_space, self._env.action_space
        self.rewards = ("task", *names_of(setup))
        low, high = np.full(len(self.rewards), -1.0, np.float32), np.zeros(len(self.rewards), np.float32)
        low[0], high[0] = -np.inf, np.inf
        self.reward_space = cast(spaces.Space[Floats], spaces.Box(low, high, dtype=np.float32))
        self.reward_dim = len(self.rewards)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """As `NavigationEnv.reset`."""
        super().reset(seed=seed)
        return self._env.reset(seed=seed, options=options)

    def step(self, action: Floats) -> tuple[Floats, Floats, bool, bool, dict[str, Any]]:
        """One control step (0.2 s); the objectives price the state that the action led to."""
        observation, task, terminated, truncated, info = self._env.step(action)
        terms = step_terms_of(np.asarray(action, np.float32)[None], observation[None], self.setup)[0]
        return observation, np.concatenate([[task], terms]).astype(np.float32), terminated, truncated, info
