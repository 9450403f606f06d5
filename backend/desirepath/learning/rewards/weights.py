"""The reward model of the objectives: what a posterior over preference weights says of steps and of whole trajectories.

The posterior itself lives in `posterior.py`, the linear and the neural models in `linear.py` and `mlp.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.preferences.evidence.graded_pair import GradedPair
from desirepath.learning.preferences.measures import measures, typical_differences
from desirepath.learning.preferences.objectives import gains, names_of, step_terms_of
from desirepath.learning.preferences.posterior import (
    Posterior,
    PosteriorConfig,
    choice_probabilities,
    weights_of_shares,
)
from desirepath.learning.preferences.preferences import Preference, usable
from desirepath.learning.preferences.spans import seen_differences, seen_measures
from desirepath.learning.rewards.reward_model import FitSettings, Fitting, Reduction, RewardModel
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
KEPT_PARTICLES = 500


@dataclass(frozen=True)
class WeightsRewardModel(RewardModel):
    """All float32. shares: (9,) expected share of each objective in the preference, in the order of NAMES.

    weights: (particles, 9), rationality, lapse_rate: (particles,): a sample of the posterior, what predicts an answer.
    """

    kind: ClassVar[str] = "weights"

    setup: str
    shares: Floats
    weights: Floats
    rationality: Floats
    lapse_rate: Floats
    reduction: Reduction = "sum"

    @classmethod
    def of(cls, posterior: Posterior) -> WeightsRewardModel:
        few = posterior.sample(KEPT_PARTICLES)
        shares = posterior.shares().astype(np.float32)
        return cls(posterior.setup, shares, few.weights, few.rationality, few.lapse_rate)

    def preference_weights(self) -> Floats:
        """(9,) in [0, 1], for a conditioned policy."""
        return weights_of_shares(self.shares)

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        del observations  # terms are read from the states that the steps led to
        terms = step_terms_of(actions, next_observations, get_setup(self.setup))
        values: Floats = terms @ self.preference_weights()
        return values

    def trajectory_reward(self, trajectory: Trajectory) -> float:
        """What is thought of a whole trajectory, by its measures, in typical differences."""
        value = gains(measures([trajectory]) / typical_differences(self.setup))[0] @ self.shares
        return float(value)

    def log_odds(self, a: Trajectory, b: Trajectory) -> float:
        """log of how much likelier A is chosen than B: the particles' mean prediction."""
        judged = measures([a, b]) / typical_differences(self.setup)
        better = gains(judged[:1] - judged[1:]).astype(np.float32)
        probability = float(choice_probabilities(self.weights, self.rationality, self.lapse_rate, better).mean())
        return math.log(probability / (1 - probability))

    def importance(self) -> dict[str, float]:
        """Share of each objective, by name: what the answers were about."""
        return {name: float(share) for name, share in zip(names_of(self.setup), self.shares, strict=True)}

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        meta: dict[str, object] = {"kind": self.kind, "setup": self.setup, "reduction": self.reduction}
        return meta, {
            "shares": self.shares,
            "weights": self.weights,
            "rationality": self.rationality,
            "lapse_rate": self.lapse_rate,
        }

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> WeightsRewardModel:
        return cls(meta["setup"], arrays["shares"], arrays["weights"], arrays["rationality"], arrays["lapse_rate"])


def answers_of(preferences: Sequence[Preference]) -> tuple[str, Doubles]:
    """The setup, and (n, spans, 7) measures of each chosen trajectory minus those of the rejected one.

    Raises LearningError for fewer than two usable answers, SetupError for mixed setups.
    """
    setup, kept = usable(preferences)
    return setup.name, seen_differences([(p.chosen, p.rejected) for p in kept])


def fit_weights(preferences: Sequence[Preference], config: PosteriorConfig | None = None) -> WeightsRewardModel:
    """The model of the posterior after these answers, how clear they were and ties among them.

    Raises LearningError for fewer than two usable answers, SetupError for mixed setups.
    """
    setup, kept = usable(preferences, ties=True)
    seen = seen_measures([trajectory for p in kept for trajectory in (p.chosen, p.rejected)])
    posterior = Posterior.prior(setup.name, config)
    for p, better, worse in zip(kept, seen[0::2], seen[1::2], strict=True):
        if p.possible == 2:
            posterior = posterior.updated(better - worse, True)
        else:
            graded = GradedPair(np.stack([better, worse]), 0 if p.is_tie else 1, p.degree, p.possible)
            posterior = posterior.observed(graded)
    return WeightsRewardModel.of(posterior)


def _fit(preferences: Sequence[Preference], asked: FitSettings) -> WeightsRewardModel:
    config = PosteriorConfig(left_right_symmetry=asked.left_right_symmetry, particles=asked.particles)
    return fit_weights(preferences, config)


MODEL = WeightsRewardModel
FITTING = Fitting(_fit, takes_long=False)
