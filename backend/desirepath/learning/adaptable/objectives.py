"""The three objectives of chapter 5, their reward vector per step, and preference vectors over them.

The nine objectives that answers are weighed by are another list (`preferences/objectives.py`). Where the reward of a
demonstration comes from lives in `ranked_reward.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from desirepath.learning.errors import LearningError
from desirepath.simulation.setups import Setup, get_setup

ADAPTABLE = get_setup("adaptable")

Floats = NDArray[np.float32]
DemonstrationReward = Callable[[Floats, Floats], Floats]
"""(observations (n, obs), actions (n, 2)) -> (n,) R_hat in [0, 1]: how like the demonstration that is."""

NAMES = ("demonstration", "distance", "efficiency")
SIZE = len(NAMES)
REWARDS = ("core", *NAMES)
PROGRESS_PER_M = 125.0  # section 5.3.4.1; the thesis prints the opposite sign
PENALTY = 10.0  # the penalties lie in [-10, 0]
CLOSE_M, CLOSEST_M = 2.0, 0.3  # equation 5.2
STEPS_PER_EDGE = 10  # section 5.4.2
SUMS_TO_ONE = 1e-3


def check_preference(preference: ArrayLike) -> Floats:
    """(3,) weights of demonstration, distance, efficiency. Raises LearningError unless >= 0 and summing to 1."""
    weights = np.asarray(preference, dtype=np.float32)
    if weights.shape != (SIZE,) or not np.isfinite(weights).all() or (weights < 0).any():
        raise LearningError(
            f"preference = {weights.tolist()}: must be three weights of at least 0 ({', '.join(NAMES)})"
        )
    if abs(float(weights.sum()) - 1) > SUMS_TO_ONE:
        raise LearningError(f"preference = {weights.tolist()}: sums to {weights.sum():.3f}, must sum to 1")
    return weights


def edge(of: int, to: int) -> Floats:
    """(11, 3) preferences from objective `to` alone to objective `of` alone, the third 0 (section 5.4.2)."""
    shares = np.arange(STEPS_PER_EDGE + 1, dtype=np.float32) / STEPS_PER_EDGE
    preferences = np.zeros((len(shares), SIZE), dtype=np.float32)
    preferences[:, of], preferences[:, to] = shares, 1 - shares
    return preferences


EDGES = ((1, 2), (0, 1), (2, 0))
"""Rows of figure 5.3: (objective whose weight rises, objective whose weight falls)."""


def thesis_vectors() -> Floats:
    """(33, 3) the test set of section 5.4.2: eleven along each edge, so the corners twice."""
    return np.concatenate([edge(*ends) for ends in EDGES])


KEY_PREFERENCES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]],
    dtype=np.float32,
)
"""Corners, middles of the edges, middle of the triangle: where checkpoints are judged."""


def sample_preferences(n: int, random: np.random.Generator) -> Floats:
    """(n, 3) preferences that are trained under: half uniform over the triangle, a third on its edges, a sixth at its
    corners. A uniform draw hardly ever comes near the edges, which is where people push a slider to."""
    weights = random.dirichlet(np.ones(SIZE), n).astype(np.float32)
    left = random.choice(SIZE, n, p=(1 / 6, 1 / 3, 1 / 2)) + 1  # of each, how many weights stay
    weights[np.argsort(np.argsort(-weights, axis=1), axis=1) >= left[:, None]] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


def part_of(preferences: Floats) -> NDArray[np.int64]:
    """(n,) which of the three parts of the triangle each preference lies in: that of its largest weight."""
    largest: NDArray[np.int64] = preferences.argmax(axis=1)
    return largest


def sample_preferences_in(parts: NDArray[np.int64], random: np.random.Generator) -> Floats:
    """(n, 3) preferences, each uniform over its part (n,) of the triangle.

    The parts are the triangle's three symmetric thirds: a uniform draw whose largest weight changes places.
    """
    weights = sample_preferences(len(parts), random)
    rows, largest = np.arange(len(parts)), part_of(weights)
    weights[rows, largest], weights[rows, parts] = weights[rows, parts], weights[rows, largest]
    return weights


def objective_rewards(
    observations: Floats,
    actions: Floats,
    next_observations: Floats,
    demonstration: DemonstrationReward,
    setup: Setup = ADAPTABLE,
) -> Floats:
    """(n, 3) of each step in [-10, 0]: 10 (R_hat - 1); equation 5.2 of where it led; -10."""
    rewards = np.empty((len(actions), SIZE), dtype=np.float32)
    rewards[:, 0] = PENALTY * (np.clip(demonstration(observations, actions), 0, 1) - 1)
    person_m = next_observations[:, 2] * setup.distance_scale_m
    inside = np.clip(CLOSE_M - person_m, 0, CLOSE_M - CLOSEST_M) / (CLOSE_M - CLOSEST_M)
    rewards[:, 1] = -PENALTY * inside * inside
    rewards[:, 2] = -PENALTY
    return rewards


def scalarise(rewards: Floats, preferences: Floats) -> Floats:
    """(n,) core + preference . objectives, of reward vectors (n, 4) and preferences (n, 3)."""
    scalars: Floats = rewards[:, 0] + (rewards[:, 1:] * preferences).sum(axis=1)
    return scalars
