"""What acts in a rollout: a function of what is observed, or a policy that remembers its episodes; getting unstuck.

The engines ask every policy the same active (`begin`). Networks and files live in `desirepath.learning`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.steering import Progress, Recovery, stand
from desirepath.simulation.setups import CONTROL_DT_S, Setup, SetupError, require_lidar

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]
ActFunction = Callable[[Floats], Floats]
"""(n, obs) float32 observations -> (n, 2) float32 actions in [-1, 1]. Called with the rows still running."""
EpisodeActs = Callable[[Floats, Rows], Floats]
"""(observations of the episodes still running, which of them these are) -> their actions; asked once per step."""


class ActionError(ValueError):
    """Actions of the wrong shape, or not numbers."""


class EpisodicPolicy(ABC):
    """A policy with a memory of each episode."""

    @abstractmethod
    def act(self, observations: Floats) -> Floats:
        """As an ActFunction: what is done in such a state where nothing is remembered."""

    @abstractmethod
    def begin(self, episodes: int) -> EpisodeActs:
        """Act in so many new episodes, side by side."""


class SensingPolicy(EpisodicPolicy):
    """A policy with sensors of its own: it reads the engine that it drives in, not the setup's observation."""

    @abstractmethod
    def begin_in(self, engine: Any) -> EpisodeActs:
        """Act in the episodes that this `FastEngine` has just begun. Raises ActionError where it cannot sense there."""

    def act(self, observations: Floats) -> Floats:
        raise ActionError("this policy has sensors of its own: roll it out on the fast engine")

    def begin(self, episodes: int) -> EpisodeActs:
        raise ActionError("this policy has sensors of its own: roll it out on the fast engine")


def begin(policy: ActFunction | EpisodicPolicy, episodes: int, engine: object = None) -> EpisodeActs:
    """Act in so many new episodes, those of the engine where one is given. Actions are checked for shape; raises
    ActionError where they are wrong."""
    if isinstance(policy, SensingPolicy) and engine is not None:
        return policy.begin_in(engine)
    if isinstance(policy, EpisodicPolicy):
        return policy.begin(episodes)
    return lambda observations, _: act_on(policy, observations)


def act_on(policy: ActFunction | EpisodicPolicy, observations: Floats) -> Floats:
    """The actions in these states, without memory, checked for shape. Raises ActionError."""
    act = policy.act if isinstance(policy, EpisodicPolicy) else policy
    actions = np.asarray(act(observations), dtype=np.float32)
    if actions.shape != (len(observations), 2):
        raise ActionError(f"the policy gave actions of shape {actions.shape} for {len(observations)} observations")
    return actions


class RecoveringPolicy(EpisodicPolicy):
    """Acts as usual until the robot is stuck, then by one recovery policy after the other until it is free; at last it
    stands (`deploy.steering.Progress`)."""

    def __init__(
        self,
        setup: Setup,
        usual: ActFunction,
        recovery_policies: Sequence[ActFunction],
        recovery: Recovery | None = None,
    ) -> None:
        """recovery_policies: the first is tried first. Raises SetupError where the goal's distance is not observed
        first, or where the robot cannot stand.
        """
        require_lidar(setup)
        if setup.robot.limits.v_min > 0:
            raise SetupError(
                f"setup {setup.name}: v_min = {setup.robot.limits.v_min}; a robot that cannot stand cannot stop"
            )
        self._scale = setup.distance_scale_m
        self._policies = (usual, *recovery_policies, stand)
        self.recovery = recovery or Recovery()

    def act(self, observations: Floats) -> Floats:
        return self._policies[0](observations)

    def begin(self, episodes: int) -> EpisodeActs:
        progress = Progress(episodes, len(self._policies) - 1, CONTROL_DT_S, self.recovery)

        def steer(observations: Floats, rows: Rows) -> Floats:
            drivers = progress.drivers(observations[:, 0].astype(np.float64) * self._scale, rows)
            actions = act_on(self._policies[0], observations)
            for number in np.unique(drivers[drivers > 0]):
                these = drivers == number
                actions[these] = act_on(self._policies[number], observations[these])
            return actions

        return steer
