"""Refinement of the instant policy: what else to tell it, and where; it takes over only where it is better."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.alignment.conditioning_search import (
    AIM,
    CROSSING_COST,
    FAILURE_COST,
    LENGTH_WEIGHT,
    ConditioningSearchConfig,
    compare_policies,
    condition_by_place,
    length_weight_of,
    search_conditioning,
)
from desirepath.learning.alignment.gate import TOLERANCE, GateRule
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import MeasuredRollouts
from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import SIZE, preference_weights
from desirepath.learning.preferences.setup_settings import middle
from desirepath.simulation.setups import SETUPS, SetupError, preference_setups
from desirepath.simulation.trajectory import Outcome

PREFERENCE_SETUPS = preference_setups()

TINY = ConditioningSearchConfig(tried=16, copies=8, survivors=3, selection_scenes=40, gate=GateRule(scenes=60))
FARTHER = preference_weights({"farther": 1.0})


@pytest.fixture(scope="module")
def conditioned() -> ConditionedPolicy:
    return load_conditioned("open_field/conditioned")


def trajectories(
    human_m: list[float], length_m: list[float], succeeded: list[bool], crossings: list[int]
) -> MeasuredRollouts:
    measured = np.zeros((len(human_m), len(MEASURES)))
    measured[:, MEASURES.index("min_human_distance_m")] = human_m
    measured[:, MEASURES.index("path_length_m")] = length_m
    outcome = np.where(succeeded, Outcome.SUCCESS, Outcome.TIMEOUT).astype(np.int8)
    return MeasuredRollouts(outcome, measured, np.array(crossings, dtype=np.int32))


def test_the_score_counts_preferences_length_crossings_and_failures() -> None:
    first = trajectories([2.0, 2.0, 2.0, 2.0, 2.0], [5.0] * 5, [True, True, True, False, True], [0, 0, 0, 0, 3])
    other = trajectories([1.0, 2.0, 1.0, 1.0, 2.0], [5.0, 6.0, 5.0, 5.0, 5.0], [True, True, False, True, True], [0] * 5)
    unit = typical_differences("study_room")
    better = compare_policies(first, other, FARTHER, "study_room")
    length = 1 / unit[MEASURES.index("path_length_m")]
    np.testing.assert_allclose(better.preferred, [1 / unit[0], 0, 0])
    expected = [1 / unit[0], LENGTH_WEIGHT * length, FAILURE_COST, -FAILURE_COST, -CROSSING_COST]
    np.testing.assert_allclose(better.scores(LENGTH_WEIGHT), expected)
    back = compare_policies(other, first, FARTHER, "study_room")
    np.testing.assert_allclose(back.scores(LENGTH_WEIGHT), -better.scores(LENGTH_WEIGHT))


@pytest.mark.parametrize("setup", PREFERENCE_SETUPS)
def test_what_it_is_conditioned_on_depends_on_where_the_robot_is(setup: str) -> None:
    """Told by place is the conditioned policy, told in each state what belongs there."""
    policy = load_conditioned(f"{setup}/conditioned")
    told = np.random.default_rng(1).normal(0, 0.3, (3, SIZE))
    states = np.random.default_rng(2).uniform(0, 0.6, (20, SETUPS[setup].observation_size)).astype(np.float32)
    change = middle(setup)
    far = (states[:, [0, 2]] * SETUPS[setup].distance_scale_m - change.at_m) / change.unit_m
    weights = FARTHER + told[0] + far @ told[1:]
    polar = SETUPS[setup].polar_size
    seen = np.concatenate([states[:, :polar], weights.astype(np.float32), states[:, polar:]], axis=1)
    branches = []
    for first, x in ((0, seen[:, : polar + SIZE]), (4, seen[:, polar + SIZE :])):
        for k in (first, first + 2):
            x = np.maximum(x @ policy.actor[k] + policy.actor[k + 1], 0)
        branches.append(x)
    x = np.concatenate(branches, axis=1)
    for k in (8, 10):
        x = np.maximum(x @ policy.actor[k] + policy.actor[k + 1], 0)
    expected = np.tanh(x @ policy.actor[12] + policy.actor[13])
    np.testing.assert_allclose(condition_by_place(policy, FARTHER, told).act(states), expected, atol=1e-4)


def test_a_search_says_whether_it_takes_over(conditioned: ConditionedPolicy) -> None:
    base = load_policy("open_field/base")
    seen: list[float] = []
    result = search_conditioning(conditioned, FARTHER, base, TINY, lambda fraction, _: seen.append(fraction))
    assert seen == pytest.approx([0.475, 0.95])
    assert len(result.history) == 3
    assert not result.policy.critic
    assert result.policy.shape == base.shape
    better = result.preferred.low > -TOLERANCE and result.score.low > 0
    assert result.takes_over == (result.gate.passed and better)
    chosen = result.history[result.chosen]
    assert chosen["preferred"] >= AIM
    assert chosen["score"] >= 0  # that of the instant policy
    again = search_conditioning(conditioned, FARTHER, base, TINY)
    assert again.policy.digest() == result.policy.digest()
    assert condition_by_place(conditioned, FARTHER, result.offsets).digest() == result.policy.digest()


def test_who_wants_short_ways_has_no_other_weight_of_length() -> None:
    weighed = [
        length_weight_of(preference_weights({"farther": 1.0, "shorter": share}), "study_room")
        for share in (0.0, 0.25, 1.0)
    ]
    assert weighed == pytest.approx([LENGTH_WEIGHT, LENGTH_WEIGHT - 0.25, 0.0])


def test_what_cannot_be_is_refused(conditioned: ConditionedPolicy) -> None:
    with pytest.raises(SetupError, match="study_room"):
        search_conditioning(conditioned, FARTHER, load_policy("study_room/base"), TINY)
    with pytest.raises(LearningError, match="opposites"):
        search_conditioning(conditioned, np.ones(9, dtype=np.float32), load_policy("open_field/base"), TINY)
