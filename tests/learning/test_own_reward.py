"""Somebody whom the nine objectives do not describe: their reward is learned from answers, and a policy is trained on
it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from backend.experiments.benchmarks.people_policies import PeoplePoliciesConfig, TrueReward, known_persons
from backend.learning.alignment.gate import GateRule
from backend.learning.alignment.own_policy import fine_tuned
from backend.learning.alignment.own_reward import OwnRewardConfig, means_of, tune_to_reward
from backend.learning.alignment.policy_library import best_of
from backend.learning.errors import LearningError
from backend.learning.measures.pairs import PairDifferences
from backend.learning.measures.step_basis import StepBasis
from backend.learning.people.card import member
from backend.learning.people.families.base import StepFamilyMember
from backend.learning.policies.shipped import (
    load_conditioned,
    load_policy,
    load_policy_library,
    load_shipped,
    load_step_basis,
)
from backend.learning.preferences.free_posterior import FreePosterior
from backend.learning.preferences.preferences import Preference
from backend.learning.preferences.step_posterior import StepPosterior
from backend.learning.queries.queries import QuerySet
from backend.learning.rewards.step_weights import StepWeightsRewardModel, fit_step_weights, step_differences
from backend.learning.rewards.storage import reward_model_from_bytes, reward_model_to_bytes
from backend.learning.scene_sets import Purpose, scene_set
from backend.simulation.fast import rollout
from backend.simulation.setups import get_setup
from backend.simulation.trajectory import Outcome, Trajectory

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
    model = fit_step_weights(preferences, basis)
    again = reward_model_from_bytes(reward_model_to_bytes(model))
    assert isinstance(again, StepWeightsRewardModel)
    trajectories = [pair[0] for pair in pairs[:5]]
    np.testing.assert_array_equal(means_of(again, trajectories), means_of(model, trajectories))
    np.testing.assert_allclose(means_of(model, trajectories), model.scores(trajectories), rtol=1e-3, atol=1e-4)


def test_training_on_somebodys_reward_raises_it_and_the_robot_arrives() -> None:
    person, base = member("network:0", "study_room"), load_policy("study_room/base")
    assert isinstance(person, StepFamilyMember)
    config = OwnRewardConfig(updates=700, checkpoints=1, selection_scenes=60, gate=GateRule(scenes=50))
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


def test_a_training_that_spoiled_the_policy_does_not_take_over(basis: StepBasis, pairs: Pairs) -> None:
    base, library = load_policy("study_room/base"), load_policy_library("study_room")
    assert library is not None
    chosen = answered("network:0", pairs[:10])
    believed = FreePosterior.from_answers(PairDifferences.of("study_room", pairs[:10]), chosen)
    steps = StepPosterior.from_answers(step_differences(basis, pairs[:10]), chosen)
    start = library.policy(best_of(library, believed, steps), load_conditioned("study_room/conditioned"), base)
    config = OwnRewardConfig(
        updates=30,
        checkpoints=1,
        selection_scenes=20,
        replay_transitions=2_000,
        learning_rate=0.3,
        final_learning_rate=0.3,
        gate=GateRule(scenes=20),
    )
    own = fine_tuned(library, start, base, basis, (believed, steps), config)
    assert own.tuned.history[-1]["success_rate"] < 0.9
    assert own.chosen == "start"
    assert own.policy.digest() == start.without_critic().digest()


def test_a_stopped_benchmark_goes_on_where_it_was(tmp_path: Path) -> None:
    config = PeoplePoliciesConfig(families=("network",), people=2)
    nobody = known_persons(tmp_path / "out.json", "study_room", config)
    assert nobody == []
    persons = [{"person": "network:0", "gain_at_once": 0.2}]
    (tmp_path / "out.json").write_text(
        json.dumps({"setup": "study_room", "config": asdict(config), "persons": persons})
    )
    assert known_persons(tmp_path / "out.json", "study_room", config) == persons
    assert known_persons(tmp_path / "out.json", "open_field", config) == []
    assert known_persons(tmp_path / "out.json", "study_room", replace(config, seed=1)) == []
