"""What a simulated participant draws where it has preference weights: the way that it likes best of those it can
imagine, with a hand's wobble. Who draws in a style of their own are the programmed demonstrators (`demonstrations`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.stroke import SLOWEST_M_S, Stroke
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.preferences.measures import measures, typical_differences
from desirepath.learning.preferences.objectives import gains, preference_weights
from desirepath.learning.preferences.posterior import Posterior, weights_of_shares
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

IMAGINED = 24  # rollouts of other weights, ours
WOBBLE_M = 0.05  # ours; `desirepath benchmark telling` has 0.08
KNOTS = 6


def imagine_stroke(scene: Scene, weights: Mapping[str, float], random: np.random.Generator, tried: int) -> Stroke:
    """The best imagined way that was not tried yet, drawn. tried: how many were refused before."""
    ways = [way for way in _imagine(scene) if way.outcome == Outcome.SUCCESS]
    shares = np.asarray(preference_weights(weights), np.float64)
    worth = gains(measures(ways) / typical_differences(scene.setup)) @ shares
    way = ways[int(np.argsort(-worth)[min(tried, len(ways) - 1)])]
    points = way.poses[:, :2].astype(np.float64)
    points += _wobble(len(points), random)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    speeds = np.maximum(np.append(steps, steps[-1]) / CONTROL_DT_S, SLOWEST_M_S)
    return Stroke.of(points, speeds, np.arange(len(points)) * CONTROL_DT_S)


@lru_cache(maxsize=8)
def _imagine(scene: Scene) -> list[Trajectory]:
    conditioned = load_conditioned(f"{scene.setup}/conditioned")
    shares = Posterior.prior(scene.setup).sample(IMAGINED).weights
    policies = [conditioned.at(weights_of_shares(share)) for share in shares]
    return [rollout(get_setup(scene.setup), policy.rollout_policy, [scene])[0] for policy in policies]


def _wobble(n: int, random: np.random.Generator) -> NDArray[np.float64]:
    """(n, 2) smooth and slow, nothing at both ends."""
    knots = random.normal(0, WOBBLE_M, (KNOTS, 2))
    knots[[0, -1]] = 0
    at = np.linspace(0, KNOTS - 1, n)
    return np.column_stack([np.interp(at, np.arange(KNOTS), knots[:, k]) for k in range(2)])
