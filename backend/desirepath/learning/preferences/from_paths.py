"""Which preference weights would have driven like these paths: a posterior over weights from drawn paths.

Paths are compared with rollouts of a policy conditioned on many weights, by what both measure. What is learned from
answers is `posterior.py`'s; no policy is known here, only what its rollouts measured. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.preferences.measures import measures, typical_differences
from desirepath.learning.preferences.objectives import names_of
from desirepath.learning.preferences.posterior import weights_of_shares
from desirepath.learning.shipped_files import resolve
from desirepath.npz import Arrays
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
ALTERNATIVES = 12
"""Other rollouts of a scene that a path is a choice among. Ours: with 40 it told less (experiments/notebook/asking.md).
"""
NOISE = 0.5
"""Of a measure, in typical differences: how far a hand's path is from the rollout it stands for. Ours."""


@dataclass(frozen=True)
class WeightsOfPaths(StoredArrays):
    """shares: (n, 9) candidates, each summing to 1; measured: (n, scenes, 7) what the policy conditioned on each
    measures in each scene; mass: (n,) how probable each is before any path.
    """

    setup: str
    shares: Doubles
    measured: Doubles
    mass: Doubles

    noun, file_format = "set of path weights", "desirepath-path-weights-1"

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        arrays = {name: getattr(self, name).astype(np.float32) for name in ("shares", "measured", "mass")}
        return {"setup": self.setup}, arrays

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> WeightsOfPaths:
        parts = {name: arrays[name].astype(np.float64) for name in ("shares", "measured", "mass")}
        return cls(str(header["setup"]), **parts)

    def alternatives(self, scene: int) -> Doubles:
        """(ALTERNATIVES, 7) of what the policy does there at weights drawn from the prior, the same for everybody."""
        likely = self.mass / self.mass.sum()
        rows = np.random.default_rng([scene, 81]).choice(len(likely), ALTERNATIVES, replace=False, p=likely)
        measured: Doubles = self.measured[rows, scene]
        return measured

    def given(self, scenes: NDArray[np.int64], drawn: Doubles) -> Doubles:
        """(n,) probabilities after paths that measure `drawn` (paths, 7) in these scenes:

            log p(w | paths) = log p(w) - sum_paths |(m(path) - m(rollout of w)) / typical|^2 / (2 noise^2)

        typical: a measure's typical difference within a pair, so that measures of unlike units count alike.
        """
        off = (self.measured[:, scenes] - drawn) / typical_differences(self.setup)
        scores = np.log(self.mass) - np.square(off).sum(axis=(1, 2)) / (2 * NOISE**2)
        shares: Doubles = np.exp(scores - scores.max())
        shares /= shares.sum()
        return shares


@lru_cache(maxsize=2)
def shipped_weights_of_paths(setup: str) -> WeightsOfPaths:
    """The candidates that come with a setup, in the scenes that its paths are drawn in. Raises LearningError: none."""
    return WeightsOfPaths.load(resolve(f"{setup}/path_weights"))


def weights_of_drawn(setup: str, drawn: Sequence[tuple[int, Trajectory]]) -> dict[str, float]:
    """objective -> weight above 0 of paths (scene, rollout of the path) drawn in the setup's scenes; {} for none."""
    if not drawn:
        return {}
    candidates = shipped_weights_of_paths(setup)
    scenes = np.array([scene for scene, _ in drawn])
    mass = candidates.given(scenes, measures([rollout for _, rollout in drawn]))
    weights = weights_of_shares(mass @ candidates.shares)
    return {name: round(float(weight), 3) for name, weight in zip(names_of(setup), weights, strict=True) if weight > 0}
