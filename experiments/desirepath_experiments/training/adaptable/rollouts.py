"""Rollouts under preferences, judged by everything chapter 5 measures: outcome, time, distances, vector of returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.frechet import frechet_distance
from desirepath.learning.adaptable.objectives import PROGRESS_PER_M, REWARDS, DemonstrationReward, objective_rewards
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Outcome

Floats = NDArray[np.float32]
PreferenceAct = Callable[[Floats, Floats], Floats]
"""(observations (n, obs), preferences (n, 3)) -> actions (n, 2) in [-1, 1]."""


@dataclass(frozen=True)
class PreferenceRollouts:
    """One rollout per row. preferences (n, 3); outcome (n,) int8; time_s, human_m, obstacle_m (n,): duration, least
    distance to the person (centres), to a box (surfaces); returns (n, 4): undiscounted, of REWARDS; start_m (n,):
    straight way; paths: (steps + 1, 2) m each.
    """

    preferences: Floats
    outcome: NDArray[np.int8]
    time_s: Floats
    human_m: Floats
    obstacle_m: Floats
    returns: Floats
    start_m: Floats
    paths: list[NDArray[np.float64]]

    @property
    def success(self) -> NDArray[np.bool_]:
        return np.asarray(self.outcome == Outcome.SUCCESS)

    def frechet_m(self, demonstrated: Sequence[NDArray[np.float64]]) -> Floats:
        """(n,) distance of each path to the demonstration's of its scene, given once per rollout."""
        distances = [frechet_distance(a, b, exact_m=1e-3) for a, b in zip(self.paths, demonstrated, strict=True)]
        return np.array(distances, dtype=np.float32)


def roll_out_preferences(
    act: PreferenceAct, scenes: Sequence[Scene], preferences: Floats, demonstration: DemonstrationReward
) -> PreferenceRollouts:
    """One rollout per scene, each under its preference (n, 3). Returns are worth what an end by time leaves of them."""
    setup = get_setup(scenes[0].setup)
    engine = make_engine(setup, len(scenes), auto_reset=False, scenes=scenes, progress_weight=PROGRESS_PER_M)
    start_m = engine.observations[:, 0] * setup.distance_scale_m
    returns = np.zeros((len(scenes), len(REWARDS)), dtype=np.float32)
    actions = np.zeros((len(scenes), 2), dtype=np.float32)
    while not engine.dones.all():
        running = np.flatnonzero(~engine.dones)
        before = engine.observations[running]
        actions[running] = np.clip(act(before, preferences[running]), -1, 1)
        engine.step(actions)
        returns[running, 0] += engine.rewards[running]
        returns[running, 1:] += objective_rewards(
            before, actions[running], engine.next_observations[running], demonstration, setup
        )
    return PreferenceRollouts(
        preferences,
        engine.outcomes.copy(),
        (engine.steps * CONTROL_DT_S).astype(np.float32),
        engine.min_human_distance.copy(),
        engine.min_clearance.copy(),
        returns,
        start_m.astype(np.float32),
        [engine.path(i) for i in range(len(scenes))],
    )
