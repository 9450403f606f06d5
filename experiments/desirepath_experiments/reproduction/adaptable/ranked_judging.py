"""How good a reward from ranked rollouts is, on rollouts in other scenes: does it rank them, does it know the way?

Per noise level: accuracy against level 0, and rank correlation with the true distance to the demonstration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from desirepath.analysis.frechet import frechet_distance
from desirepath.learning.rewards.ranked_rollouts import RankedRewardModel
from desirepath_experiments.training.adaptable.ranking import RankedRollouts


@dataclass(frozen=True)
class LevelJudged:
    """One noise level. accuracy: of pairs with a noise-free rollout in the same scene, how many are ranked so;
    None at level 0. reward: mean R per step. frechet_m: mean distance to the demonstration. correlation: Spearman of
    reward and minus that distance within the level; None where either does not vary.
    """

    level: float
    rollouts: int
    accuracy: float | None
    reward: float
    frechet_m: float
    correlation: float | None


@dataclass(frozen=True)
class RankedJudged:
    """accuracy: over all pairs of rollouts of different noise; of pairs in the same scene. correlation: over all."""

    accuracy: float
    accuracy_same_scene: float
    correlation: float | None
    levels: tuple[LevelJudged, ...]

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def judged(
    model: RankedRewardModel, ranked: RankedRollouts, demonstrated: Sequence[NDArray[np.float64]]
) -> RankedJudged:
    """Of rollouts that the model was not fitted to. demonstrated: per scene, the way of the demonstration (k, 2) m;
    rollouts are level after level over the same scenes, as `noise_ranked` gives them.
    """
    n = len(demonstrated)
    rewards = np.array([model.trajectory_reward(trajectory) for trajectory in ranked.trajectories])
    apart = np.array(
        [
            frechet_distance(trajectory.poses[:, :2].astype(float), demonstrated[k % n], exact_m=1e-3)
            for k, trajectory in enumerate(ranked.trajectories)
        ]
    )
    levels = ranked.levels
    less = levels[:, None] < levels[None, :]
    above = _above(rewards[:, None], rewards[None, :])
    same = (np.arange(len(levels)) % n)[:, None] == (np.arange(len(levels)) % n)[None, :]
    shares = []
    for number, level in enumerate(sorted(set(levels.tolist()))):
        of = slice(number * n, (number + 1) * n)
        shares.append(
            LevelJudged(
                round(level, 6),
                n,
                None if number == 0 else float(_above(rewards[:n], rewards[of]).mean()),
                float(rewards[of].mean()),
                float(apart[of].mean()),
                _spearman(rewards[of], -apart[of]),
            )
        )
    return RankedJudged(
        float(above[less].mean()), float(above[less & same].mean()), _spearman(rewards, -apart), tuple(shares)
    )


def _above(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 where the first is larger, half where equal."""
    above: NDArray[np.float64] = (first > second) + 0.5 * (first == second)
    return above


def _spearman(first: NDArray[np.float64], second: NDArray[np.float64]) -> float | None:
    if len(set(first.tolist())) < 2 or len(set(second.tolist())) < 2:
        return None
    return float(spearmanr(first, second).statistic)
