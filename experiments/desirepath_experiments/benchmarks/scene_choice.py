"""A choice per scene instead of one policy per person: every policy of the library rolls out in the scene, the
posterior of the answers says which of these rollouts is liked most; where that is not sure the base policy drives.

What a robot knows of such a scene: its map, where the person stands, its goal. Nobody who walks is foreseen here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.pairs import PairDifferences, measured
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.benchmarks.people import RobotOfLibrary, arrived

CAUTION = 0.4
"""Standard deviations that are taken off what a rollout is expected to gain. Chosen on tuning families: of 24 people
none was harmed by more than 0.00 with it, and it gained nearly as much as 0.1."""


BASE = -1
"""Instead of a place in the library: the base policy drives."""


@dataclass(frozen=True)
class SceneCandidates:
    """What each of n policies does in the same scenes. trajectories: policy by policy, scene by scene; usable (n,
    scenes): allowed, and arrives where the base policy does; steps, pairs: how each differs from the base policy."""

    usual: list[Trajectory]
    trajectories: list[list[Trajectory]]
    usable: NDArray[np.bool_]
    steps: Doubles
    pairs: PairDifferences

    @classmethod
    def of(
        cls, robot: RobotOfLibrary, usual: list[Trajectory], own: list[list[Trajectory]], symmetry: bool
    ) -> SceneCandidates:
        """usual, own: rollouts of the base policy and of the whole library, in the same scenes."""
        usable = np.array([arrived(trajectories) for trajectories in own]) & arrived(usual)
        usable &= robot.library.allowed[:, None]
        together = [(mine, other) for trajectories in own for mine, other in zip(trajectories, usual, strict=True)]
        of_usual = measured(robot.setup, usual, left_right_symmetry=symmetry)
        again = np.tile(np.arange(len(usual)), len(own))
        of_own = measured(robot.setup, [mine for mine, _ in together], left_right_symmetry=symmetry)
        pairs = PairDifferences.between(robot.setup, together, of_own, (of_usual[0][again], of_usual[1][again]))
        return cls(usual, own, usable, step_differences(robot.basis, together), pairs)

    def places(self, believed: FreePosterior, steps: StepPosterior, caution: float = CAUTION) -> NDArray[np.int64]:
        """(scenes,) which policy drives in each: that from whose rollout both posteriors together expect most, each in
        the largest that it expects of any; BASE where they expect nothing of all."""
        expected = np.zeros(self.usable.size)
        for mean, deviation in (believed.advantages(self.pairs), steps.advantages(self.steps)):
            expected += (mean - caution * deviation) / max(float(np.abs(mean).max()), 1e-9)
        return self._best(expected.reshape(self.usable.shape))

    def true_best(self, scores: Doubles) -> NDArray[np.int64]:
        """The yardstick: the best rollout of each scene by scores ((n + 1) * scenes,), of the base policy first."""
        by_policy = scores.reshape(-1, len(self.usual))
        return self._best(by_policy[1:] - by_policy[0])

    def driven(self, places: NDArray[np.int64]) -> list[Trajectory]:
        """What the policies of these places do, scene by scene."""
        return [
            self.usual[scene] if place == BASE else self.trajectories[place][scene]
            for scene, place in enumerate(places)
        ]

    def rows(self, places: NDArray[np.int64], scenes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the differences of these scenes' policies from the base policy stand in `steps` and `pairs`."""
        found: NDArray[np.int64] = places[scenes] * len(self.usual) + scenes
        return found

    def _best(self, gains: Doubles) -> NDArray[np.int64]:
        gains = np.where(self.usable, gains, -np.inf)
        return np.where(gains.max(0) > 0, gains.argmax(0), BASE)
