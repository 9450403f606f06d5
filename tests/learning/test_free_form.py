"""Which kind of reward model some answers deserve, and that mirrored answers teach the mirrored world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.errors import TooFewAnswers
from desirepath.learning.policies.mirroring import ACTION_SIGNS, mirror_of
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.auto import choose_reward_model
from desirepath.learning.rewards.held_out import predict_in_new_scenes
from desirepath.learning.rewards.mlp import MlpConfig
from desirepath.learning.rewards.mlp_ensemble import RewardEnsembleConfig, fit_mlp_ensemble
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.rewards.weights import fit_weights
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

QUICK = RewardEnsembleConfig(members=1, member=MlpConfig(epochs=12, learning_rate=3e-3, pairs_per_step=16))
LEFT_SECTORS = slice(16, 26)  # of a study-room observation: lidar around straight left


def answers(oracle: str, n: int) -> list[Preference]:
    return make_oracle(oracle, seed=3).answer(load_queries("study_room/queries_varied_200").queries[:n])


def space_on_the_left() -> list[Preference]:
    """Answers by how much free space a drive has to its left on average: nothing of the vocabulary."""

    def worth(trajectory: Trajectory) -> float:
        return float(trajectory.observations[:, LEFT_SECTORS].mean())

    queries = load_queries("study_room/queries_varied_200").queries
    return [Preference.of(q, int(worth(q.trajectory_b) > worth(q.trajectory_a))) for q in queries]


def test_a_taste_that_the_vocabulary_has_no_word_for_goes_to_the_networks() -> None:
    given = space_on_the_left()
    chosen = choose_reward_model(given, folds=2, networks=QUICK)
    assert chosen.name == "mlp_ensemble_mean"
    assert chosen.log_likelihoods["mlp_ensemble_mean"] > chosen.log_likelihoods["weights"] + 0.2
    again = RewardModel.from_bytes(chosen.model.to_bytes())
    assert again.trajectory_reward(given[0].chosen) == pytest.approx(
        chosen.model.trajectory_reward(given[0].chosen), rel=1e-5
    )


def test_a_taste_of_the_vocabulary_stays_there() -> None:
    chosen = choose_reward_model(answers("clearance", 80), folds=2, networks=QUICK)
    assert chosen.name == "weights"
    assert len(chosen.log_likelihoods) == 3


def test_few_answers_are_not_given_to_networks() -> None:
    assert choose_reward_model(answers("faces-person", 20)).log_likelihoods == {}


def test_mirrored_answers_teach_the_mirrored_world() -> None:
    given = answers("person-on-left", 40)
    order, signs = mirror_of(get_setup("study_room"))
    trajectories = [trajectory for answer in given for trajectory in (answer.chosen, answer.rejected)]
    gaps = {}
    for symmetric in (False, True):
        model = fit_mlp_ensemble(given, QUICK, left_right_symmetry=symmetric)
        worth = [
            model.rewards(d.observations, d.actions, d.next_observations)
            - model.rewards(d.observations[:, order] * signs, d.actions * ACTION_SIGNS, d.next_observations)
            for d in trajectories
        ]
        gaps[symmetric] = float(np.abs(np.concatenate(worth)).mean())
    assert gaps[True] < 0.7 * gaps[False]


def test_answers_about_one_scene_are_held_out_together() -> None:
    """Everybody answers the same 20 queries; a model that only remembers drives knows none that it did not see."""
    seen: list[set[str]] = []

    def fit(given: Sequence[Preference]) -> RewardModel:
        seen.append({one.chosen.scene.digest() for one in given})
        return fit_weights(given, PosteriorConfig())

    everybody = [one for _ in range(3) for one in answers("min-human-distance", 20)]
    found = predict_in_new_scenes(everybody, fit, folds=4)
    assert (found.answers, found.scenes, found.folds) == (60, 20, 4)
    assert [len(scenes) for scenes in seen] == [15] * 4
    assert not set.intersection(*seen)
    assert found.accuracy > 0.8
    assert found.log_likelihood > math.log(0.5)
    # Of three people who gave the answers the interval is over the three, not over sixty: it cannot be as narrow.
    of_three = predict_in_new_scenes(
        [replace(one, person=f"P-{k % 3}") for k, one in enumerate(everybody)], fit, folds=4
    )
    assert of_three.accuracy == found.accuracy
    assert 0 <= of_three.low < of_three.accuracy <= of_three.high <= 1
    assert of_three.high - of_three.low > found.high - found.low
    one_alone = predict_in_new_scenes([replace(one, person="P-1") for one in everybody], fit, folds=4)
    assert (one_alone.low, one_alone.high) == (found.low, found.high)
    with pytest.raises(TooFewAnswers, match="20 scenes"):
        predict_in_new_scenes(everybody, fit, folds=21)
