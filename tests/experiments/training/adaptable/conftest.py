"""Small real parts that tests of adaptable policies share: a clone of the demonstration and a reward from it."""

from __future__ import annotations

import pytest

from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.ranked_rollouts import RankedRewardModel
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath_experiments.training.adaptable.cloning import CloningConfig, clone_policy
from desirepath_experiments.training.adaptable.demonstrator import demonstrate_in
from desirepath_experiments.training.adaptable.ranking import RankedConfig, fit_ranked, rank_by_noise

ADAPTABLE = get_setup("adaptable")


@pytest.fixture(scope="session")
def free_scenes() -> list[Scene]:
    """Scenes in which the demonstration touches nothing."""
    return [one.scene for one in demonstrate_in(draw_scenes(ADAPTABLE, range(80)))]


@pytest.fixture(scope="session")
def clone(free_scenes: list[Scene]) -> Policy:
    return clone_policy(demonstrate_in(free_scenes[:30], disturbed=0.15), CloningConfig(updates=1_500, heads=(64, 64)))


@pytest.fixture(scope="session")
def reward(clone: Policy, free_scenes: list[Scene]) -> RankedRewardModel:
    ranked = rank_by_noise(clone.act, free_scenes[:20], seed=0)
    return fit_ranked(ranked, RankedConfig(updates=500, pairs=16, heads=(64, 64)))
