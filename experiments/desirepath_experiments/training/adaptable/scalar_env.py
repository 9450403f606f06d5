"""The parameterised scalar reward of section 5.4.4: each episode draws a preference, which joins the observation.

For learners of other libraries, which know one reward: many environments for Stable-Baselines3 here, one with a vector
of rewards for `mo-gymnasium` in `vector_env.py`.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from desirepath.learning.adaptable.objectives import (
    PROGRESS_PER_M,
    REWARDS,
    SIZE,
    DemonstrationReward,
    objective_rewards,
    sample_preferences,
    scalarise,
)
from desirepath.simulation.environments import action_space
from desirepath.simulation.fast import make_engine
from desirepath.simulation.observation_bounds import observation_bounds
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome

ADAPTABLE = get_setup("adaptable")

Floats = NDArray[np.float32]


def conditioned_observation_space() -> spaces.Space[Floats]:
    """What the setup observes, then the preference (3,)."""
    low, high = observation_bounds(ADAPTABLE)
    lowest = np.concatenate([low, np.zeros(SIZE, dtype=np.float32)])
    highest = np.concatenate([high, np.ones(SIZE, dtype=np.float32)])
    return cast(spaces.Space[Floats], spaces.Box(lowest, highest))


class ScalarVecEnv(VecEnv):
    """The fast engine as a Stable-Baselines3 VecEnv whose reward is core + preference . objectives, times `scale`."""

    def __init__(self, demonstration: DemonstrationReward, n_envs: int, *, seed: int, scale: float = 0.01) -> None:
        self.engine = make_engine(ADAPTABLE, n_envs, seed=seed, progress_weight=PROGRESS_PER_M)
        self.render_mode = None
        self._demonstration, self._scale = demonstration, scale
        self._random = np.random.default_rng([seed, 56])
        self._preferences = sample_preferences(n_envs, self._random)
        self._actions: Floats = np.zeros((n_envs, 2), dtype=np.float32)
        super().__init__(n_envs, conditioned_observation_space(), action_space())

    def _observe(self, observations: Floats) -> Floats:
        return np.concatenate([observations, self._preferences], axis=1)

    def reset(self) -> Floats:
        return self._observe(self.engine.reset())

    def step_async(self, actions: Floats) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Floats, Floats, NDArray[np.bool_], list[dict[str, Any]]]:
        engine, actions = self.engine, np.clip(self._actions, -1, 1)
        before = engine.observations.copy()
        engine.step(actions)
        rewards = np.empty((len(actions), len(REWARDS)), dtype=np.float32)
        rewards[:, 0] = engine.rewards
        rewards[:, 1:] = objective_rewards(before, actions, engine.next_observations, self._demonstration)
        scalar = scalarise(rewards, self._preferences) * np.float32(self._scale)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(engine.dones)
        for i in ended:
            terminal = np.concatenate([engine.next_observations[i], self._preferences[i]])
            outcome = Outcome(int(engine.outcomes[i])).name.lower()
            infos[i] = {"terminal_observation": terminal, "TimeLimit.truncated": False, "outcome": outcome}
        if len(ended):
            self._preferences[ended] = sample_preferences(len(ended), self._random)
        return self._observe(engine.observations), scalar, engine.dones.copy(), infos

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of this VecEnv, once per index: the environments share everything."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: no environment of the batch can differ from the others."""
        raise NotImplementedError(f"set_attr({attr_name!r}): the environments share one engine")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: there are no single environments to call."""
        raise NotImplementedError(f"env_method({method_name!r}): the environments share one engine")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
