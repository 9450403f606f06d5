"""Refinement from the conditioned policy: one person's wants only, and it takes over only where it is better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.learning.conditioned import ConditionedPolicy
from backend.learning.conditioned_training import STAKES, ConditionedConfig, train_conditioned
from backend.learning.errors import LearningError
from backend.learning.movement import Drives
from backend.learning.policy import Policy
from backend.learning.refine import (
    FAILURE_COST,
    LENGTH_WEIGHT,
    SearchConfig,
    WantsReward,
    advantages,
    best_told,
    refine,
    refine_config,
    weights_within,
)
from backend.learning.replay import collect
from backend.learning.shipped import load_policy
from backend.learning.vocabulary import MEASURES, check_weights, preference_weights, step_terms, typical_differences
from backend.simulation.setups import STUDY_ROOM, SetupError
from backend.simulation.trajectory import Outcome

TINY = replace(
    refine_config("study_room"),
    updates=60,
    checkpoints=2,
    replay_transitions=1_000,
    selection_scenes=15,
    gate_scenes=20,
)
FARTHER = preference_weights({"farther": 1.0})


@pytest.fixture(scope="module")
def base() -> Policy:
    return load_policy("study_room/base")


@pytest.fixture(scope="module")
def conditioned(base: Policy) -> ConditionedPolicy:
    config = ConditionedConfig(
        "study_room",
        updates=16,
        base_transitions=1_000,
        buffer_size=4_000,
        n_envs=32,
        checkpoints=1,
        selection_scenes=5,
    )
    return train_conditioned(base, config).policy


def test_the_reward_is_that_of_the_conditioned_training_for_one_person(base: Policy) -> None:
    batch = collect(base, 1_000, noise=(0.05, 0.3), seed=1).filled()
    scales = np.array(STAKES["study_room"].scales, dtype=np.float32)
    wants = preference_weights({"farther": 1.0, "smoother": 0.5})
    reward = WantsReward(STUDY_ROOM, scales * wants, replace(TINY, preference_weight=0.5, time_cost=0.2))
    terms = step_terms(batch.actions.numpy(), batch.next_observations.numpy(), STUDY_ROOM)
    expected = batch.rewards.numpy() + 0.5 * (scales[0] * terms[:, 0] + 0.5 * scales[6] * terms[:, 6]) - 0.2
    np.testing.assert_allclose(reward.combined(batch.rewards, reward.preference(batch)).numpy(), expected, atol=1e-4)
    reward.adapt(0.1, 0.99)
    assert reward.weight == 0.5


def drives(human_m: list[float], length_m: list[float], succeeded: list[bool]) -> Drives:
    measured = np.zeros((len(human_m), len(MEASURES)))
    measured[:, MEASURES.index("min_human_distance_m")] = human_m
    measured[:, MEASURES.index("path_length_m")] = length_m
    outcome = np.where(succeeded, Outcome.SUCCESS, Outcome.TIMEOUT).astype(np.int8)
    return Drives(outcome, measured, np.zeros(len(human_m), dtype=np.int32))


def test_the_score_counts_wants_some_length_and_failures() -> None:
    first = drives([2.0, 2.0, 2.0, 2.0], [5.0, 5.0, 5.0, 5.0], [True, True, True, False])
    other = drives([1.0, 2.0, 1.0, 1.0], [5.0, 6.0, 5.0, 5.0], [True, True, False, True])
    unit = typical_differences("study_room")
    better = advantages(first, other, FARTHER, "study_room")
    expected = [1 / unit[0], LENGTH_WEIGHT / unit[MEASURES.index("path_length_m")], FAILURE_COST, -FAILURE_COST]
    np.testing.assert_allclose(better, expected)
    np.testing.assert_allclose(advantages(other, first, FARTHER, "study_room"), -better)
    assert FARTHER[MEASURES.index("path_length_m")] == 0  # what was asked with is not written to


def test_a_refinement_says_whether_it_takes_over(base: Policy, conditioned: ConditionedPolicy) -> None:
    seen: list[float] = []
    result = refine(conditioned, FARTHER, base, TINY, lambda fraction, _: seen.append(fraction))
    assert seen == pytest.approx([0.4, 0.7, 1.0])
    assert not result.policy.critic
    assert result.policy.shape == base.shape
    assert result.takes_over == (result.gate.passed and result.score.low > 0)
    scores = [entry["score"] for entry in result.history]
    assert scores[result.chosen] == max(scores)
    assert scores[0] >= 0  # what the search found to tell is no worse than telling the wants
    again = refine(conditioned, FARTHER, base, TINY)
    assert again.policy.digest() == result.policy.digest()
    assert again.replay_sha256 == result.replay_sha256


def test_the_search_finds_what_to_tell() -> None:
    best = preference_weights({"farther": 0.8, "shorter": 0.3})

    def score(told: np.ndarray) -> float:
        return float(np.abs(FARTHER - best).sum() - np.abs(told - best).sum())

    told = best_told(FARTHER, score, SearchConfig(rounds=8, copies=20), seed=1)
    assert score(told) > 0.5 * score(best)
    assert best_told(FARTHER, lambda _: -1.0).tolist() == FARTHER.tolist()


def test_what_is_told_is_never_two_opposites() -> None:
    random = np.random.default_rng(2)
    for _ in range(50):
        check_weights(weights_within(random.normal(0.3, 1.0, 9)))


def test_what_cannot_be_is_refused(base: Policy, conditioned: ConditionedPolicy) -> None:
    with pytest.raises(SetupError, match="open_field"):
        refine(conditioned, FARTHER, load_policy("open_field/base"), TINY)
    with pytest.raises(LearningError, match="opposites"):
        refine(conditioned, np.ones(9, dtype=np.float32), base, TINY)
    with pytest.raises(LearningError, match="critic"):
        refine(replace(conditioned, critic=()), FARTHER, base, TINY)
