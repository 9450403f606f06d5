"""What a choice per scene (`learning/policies/choosing.py`) drives in scenes in which many people are measured: the
library is rolled out there once, and everybody's answers choose among these rollouts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.alignment.each_scene import favourites
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.policies.choosing import Answers, RolloutDifferences
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.benchmarks.people import RobotOfLibrary

BASE = -1
"""Instead of a place in the library: the base policy drives."""


@dataclass(frozen=True)
class SceneCandidates:
    """What each of n policies does in the same scenes. trajectories: policy by policy, scene by scene; differences:
    from what the base policy does."""

    robot: RobotOfLibrary
    usual: list[Trajectory]
    trajectories: list[list[Trajectory]]
    differences: RolloutDifferences

    @classmethod
    def of(
        cls, robot: RobotOfLibrary, usual: list[Trajectory], own: list[list[Trajectory]], symmetry: bool
    ) -> SceneCandidates:
        """usual, own: rollouts of the base policy and of the whole library, in the same scenes."""
        differences = RolloutDifferences.of(robot.basis, usual, own, left_right_symmetry=symmetry)
        return cls(robot, usual, own, differences)

    def places(self, answers: Answers, scales: Doubles, kept: int) -> NDArray[np.int64]:
        """(scenes,) which policy drives in each, of the `kept` that the answers let expect most of on average; BASE
        where they expect nothing of all."""
        among = favourites(self.robot.library, answers, kept)
        return self._best(self.differences.expected(answers, scales), among)

    def true_best(self, scores: Doubles) -> NDArray[np.int64]:
        """The yardstick: the best rollout of each scene by scores ((n + 1) * scenes,), of the base policy first."""
        by_policy = scores.reshape(-1, len(self.usual))
        usable = self.differences.usable & self.robot.library.allowed[:, None]
        return self._best(np.where(usable, by_policy[1:] - by_policy[0], -np.inf), np.arange(len(usable)))

    def driven(self, places: NDArray[np.int64]) -> list[Trajectory]:
        """What the policies of these places do, scene by scene."""
        return [
            self.usual[scene] if place == BASE else self.trajectories[place][scene]
            for scene, place in enumerate(places)
        ]

    def rows(self, places: NDArray[np.int64], scenes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the differences of these scenes' policies from the base policy stand in `differences`."""
        found: NDArray[np.int64] = places[scenes] * len(self.usual) + scenes
        return found

    def _best(self, gains: Doubles, among: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(gains[among].max(0) > 0, among[gains[among].argmax(0)], BASE)
