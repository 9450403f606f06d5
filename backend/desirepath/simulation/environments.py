"""The engines behind the interfaces that reinforcement-learning libraries expect: Gymnasium and SB3's VecEnv.

Running out of steps is `truncated` in Gymnasium's environments, as its users expect, unless `time_limit="terminated"`
asks for what our own learners are given, `FastVecEnv`'s SB3 arms included: the core reward charges for it (ch. 6: -20,
ch. 7: -1), so the episode really ends there and a learner must not add the value of a state beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, cast, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from desirepath.simulation.fast import FastEngine, Floats, make_engine
from desirepath.simulation.observation_bounds import ACTION_SIZE, observation_bounds
from desirepath.simulation.reference import DriveMode, ReferenceEngine
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import LARGEST_SEED, ScenePool, row_to_scene
from desirepath.simulation.setups import Setup, get_setup
from desirepath.simulation.trajectory import Outcome

TimeLimit = Literal["truncated", "terminated"]
"""What an episode that ran out of steps was."""


def observation_space(setup: Setup) -> spaces.Space[Floats]:
    """The setup's observations as a finite box."""
    return cast(spaces.Space[Floats], spaces.Box(*observation_bounds(setup)))


def action_space() -> spaces.Space[Floats]:
    """Forward speed and turn rate, both scaled to [-1, 1]."""
    return cast(spaces.Space[Floats], spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32))


class NavigationEnv(gymnasium.Env[Floats, Floats]):
    """One robot as a Gymnasium environment, on the fast engine or on PyBullet.

    `reset(seed=...)` begins a new series of scenes, `reset(options={"scene": scene})` uses that very scene. time_limit:
    whether an episode that ran out of steps was truncated or terminated. `info`
    holds outcome (name), human_distance_m, obstacle_clearance_m and self_intersections.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        setup: str | Setup,
        *,
        engine: Literal["fast", "pybullet"] = "fast",
        drive_mode: DriveMode = "velocity",
        progress_weight: float = 0.0,
        seed: int = 0,
        time_limit: TimeLimit = "truncated",
    ) -> None:
        self.setup = get_setup(setup) if isinstance(setup, str) else setup
        if time_limit not in get_args(TimeLimit):
            raise ValueError(f"time_limit = {time_limit!r}: must be 'truncated' or 'terminated'")
        self._truncates = time_limit == "truncated"
        if engine not in ("fast", "pybullet"):
            raise ValueError(f"engine = {engine!r}: must be 'fast' or 'pybullet'")
        self.observation_space, self.action_space = observation_space(self.setup), action_space()
        self._pool = ScenePool(self.setup, seed)
        self._engine: FastEngine | ReferenceEngine
        if engine == "pybullet":
            self._engine = ReferenceEngine(self.setup, drive_mode=drive_mode, progress_weight=progress_weight)
        else:
            self._engine = make_engine(self.setup, 1, auto_reset=False, progress_weight=progress_weight, seed=seed)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Start an episode. Raises SceneError for a scene that cannot be run."""
        super().reset(seed=seed)
        if seed is not None:
            self._pool = ScenePool(self.setup, seed)
        scene = (options or {}).get("scene")
        if scene is None:
            rows, seeds = self._pool.take(1)
            scene = row_to_scene(self.setup, int(seeds[0]), rows[0])
        engine = self._engine
        if isinstance(engine, ReferenceEngine):
            return engine.reset(scene).copy(), self._info()
        return engine.reset([scene])[0].copy(), self._info()

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """One control step (0.2 s). Raises ActionError for actions that are not two finite numbers."""
        engine = self._engine
        if isinstance(engine, ReferenceEngine):
            engine.step(action)
            return engine.observation.copy(), engine.reward, *self._ends(engine.done), self._info()
        engine.step(np.asarray(action, dtype=np.float32).reshape(1, -1))
        observation, reward = engine.next_observations[0].copy(), float(engine.rewards[0])
        return observation, reward, *self._ends(bool(engine.dones[0])), self._info()

    def _ends(self, done: bool) -> tuple[bool, bool]:
        """(terminated, truncated) of an episode that is done or not."""
        engine = self._engine
        outcome = engine.outcome if isinstance(engine, ReferenceEngine) else engine.outcomes[0]
        truncated = done and self._truncates and int(outcome) == Outcome.TIMEOUT
        return done and not truncated, truncated

    def _info(self) -> dict[str, Any]:
        engine = self._engine
        if isinstance(engine, ReferenceEngine):
            outcome, crossings = engine.outcome, engine.self_intersections
            human, clearance = engine.human_distance, engine.obstacle_clearance
        else:
            outcome, crossings = Outcome(int(engine.outcomes[0])), int(engine.self_intersections[0])
            human, clearance = float(engine.human_distance[0]), float(engine.obstacle_clearance[0])
        return {
            "outcome": outcome.name.lower(),
            "human_distance_m": human,
            "obstacle_clearance_m": clearance,
            "self_intersections": crossings,
        }

    def close(self) -> None:
        if isinstance(self._engine, ReferenceEngine):
            self._engine.close()


class FastVecEnv(VecEnv):
    """The fast engine as a Stable-Baselines3 VecEnv of `n_envs` environments that restart by themselves.

    As VecEnv prescribes, the observation of an ended episode stands in `terminal_observation` of its info; beside it
    `episode` (r, l) for SB3's logs, `outcome` (name), and `TimeLimit.truncated`, which is always False (see above).
    """

    def __init__(
        self,
        setup: str | Setup,
        n_envs: int,
        *,
        seed: int = 0,
        progress_weight: float = 0.0,
        scenes: Sequence[Scene] | None = None,
    ) -> None:
        self.setup = get_setup(setup) if isinstance(setup, str) else setup
        self.engine = make_engine(self.setup, n_envs, seed=seed, progress_weight=progress_weight, scenes=scenes)
        self.render_mode = None
        self._returns = np.zeros(n_envs)
        self._actions: NDArray[np.float32] = np.zeros((n_envs, 2), dtype=np.float32)
        super().__init__(n_envs, observation_space(self.setup), action_space())

    def reset(self) -> Floats:
        """Start every environment; after `seed(s)` from a new series of scenes."""
        if self._seeds[0] is not None:
            self.engine.reseed(self._seeds[0] % LARGEST_SEED)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        return self.engine.reset().copy()

    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Floats, Floats, NDArray[np.bool_], list[dict[str, Any]]]:
        engine = self.engine
        engine.step(self._actions)
        self._returns += engine.rewards
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(engine.dones):
            infos[i] = {
                "terminal_observation": engine.next_observations[i].copy(),
                "TimeLimit.truncated": False,
                "outcome": Outcome(int(engine.outcomes[i])).name.lower(),
                "episode": {"r": float(self._returns[i]), "l": int(engine.steps[i])},
            }
            self._returns[i] = 0.0
        return engine.observations.copy(), engine.rewards.copy(), engine.dones.copy(), infos

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of this VecEnv, once per index: the environments share everything."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: no environment of the batch can differ from the others."""
        raise NotImplementedError(f"set_attr({attr_name!r}): the environments of FastVecEnv share one engine")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: there are no single environments to call."""
        raise NotImplementedError(f"env_method({method_name!r}): the environments of FastVecEnv share one engine")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
