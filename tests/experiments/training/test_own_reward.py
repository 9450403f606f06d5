"""Somebody whom the nine objectives do not describe: their reward is learned from answers, and a policy is trained on
it."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.alignment.own_reward import OwnRewardConfig, means_of, tune_to_reward
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.step_basis import StepBasis
from desirepath.learning.people.card import member
from desirepath.learning.people.families.base import StepFamilyMember
from desirepath.learning.policies.shipped import (
    load_policy,
    load_shipped,
    load_step_basis,
)
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.rewards.step_weights import StepWeightsRewardModel, step_differences, step_posterior_of
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.benchmarks.own_senses import TrueReward

Pairs = list[tuple[Trajectory, Trajectory]]


@pytest.fixture(scope="module")
def basis() -> StepBasis:
    found = load_step_basis("study_room")
    assert found is not None
    return found


@pytest.fixture(scope="module")
def pairs(study_queries: QuerySet) -> Pairs:
    return [(q.trajectory_a, q.trajectory_b) for q in study_queries.queries[:90]]


def answered(name: str, pairs: Pairs) -> np.ndarray:
    scores = member(name, "study_room").scores([one for pair in pairs for one in pair])
    return np.asarray(scores[0::2] > scores[1::2])


def test_fifteen_answers_say_what_a_network_prefers(
    basis: StepBasis, pairs: list[tuple[Trajectory, Trajectory]]
) -> None:
    right = []
    for name in ("network:0", "network:4", "network:5"):
        chosen = answered(name, pairs)
        seen = step_differences(basis, pairs)
        posterior = StepPosterior.from_answers(seen[:15], chosen[:15])
        right.append(((posterior.predict(seen[30:]) > 0.5) == chosen[30:]).mean())
    assert np.mean(right) > 0.7


def test_the_next_question_tells_less_the_more_is_known(
    basis: StepBasis, pairs: list[tuple[Trajectory, Trajectory]]
) -> None:
    seen, chosen = step_differences(basis, pairs), answered("network:0", pairs)
    few, many = (StepPosterior.from_answers(seen[:n], chosen[:n]) for n in (2, 30))
    assert many.information_bits(seen[40:]).mean() < few.information_bits(seen[40:]).mean()
    with pytest.raises(LearningError, match="choices = 1: 2 pairs"):
        StepPosterior.from_answers(seen[:2], [True])


def test_a_learned_reward_is_the_same_from_its_file(
    basis: StepBasis, pairs: list[tuple[Trajectory, Trajectory]]
) -> None:
    chosen = answered("network:5", pairs[:12])
    preferences = [Preference(*(pair if first else pair[::-1])) for pair, first in zip(pairs, chosen, strict=False)]
    believed = step_posterior_of(preferences, basis)
    model = StepWeightsRewardModel("study_room", basis, believed.mean.astype(np.float32))
    again = RewardModel.from_bytes(model.to_bytes())
    assert isinstance(again, StepWeightsRewardModel)
    trajectories = [pair[0] for pair in pairs[:5]]
    np.testing.assert_array_equal(means_of(again, trajectories), means_of(model, trajectories))
    np.testing.assert_allclose(means_of(model, trajectories), model.scores(trajectories), rtol=1e-3, atol=1e-4)


def test_training_on_somebodys_reward_raises_it_and_the_robot_arrives() -> None:
    person, base = member("network:0", "study_room"), load_policy("study_room/base")
    assert isinstance(person, StepFamilyMember)
    config = OwnRewardConfig(updates=700, checkpoints=1, selection_scenes=60)
    tuned = tune_to_reward(base, TrueReward("study_room", person), config)
    assert tuned.history[tuned.chosen]["success_rate"] >= 0.9
    scenes = scene_set("study_room", 80, purpose=Purpose.REPORT, seed=7)
    rolled_out = [rollout(get_setup("study_room"), p.rollout_policy, scenes) for p in (tuned.policy, base)]
    both = [pair for pair in zip(*rolled_out, strict=True) if all(one.outcome == Outcome.SUCCESS for one in pair)]
    own, usual = (person.scores([pair[k] for pair in both]) for k in (0, 1))
    assert (own - usual).mean() > 0.2 * person.unit("study_room")


def test_the_shipped_basis_is_what_its_card_says(basis: StepBasis) -> None:
    shipped = load_shipped("study_room/step_basis")
    assert isinstance(shipped, StepBasis)
    assert shipped.to_bytes() == basis.to_bytes()
    assert basis.size == 24
    assert load_step_basis("corridor") is None
