"""The posterior over wants: known answers give known wants, the same answers always the same, doubt where it is due."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import NAMES, OBJECTIVES, OPPOSITES
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig, supports, weights_of_shares
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.preferences.spans import SPANS_S
from desirepath.learning.rewards.held_out import accuracy
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.rewards.weights import WeightsRewardModel, fit_weights

QUICK = PosteriorConfig(particles=4_000)


def pairs(n: int, setup: str = "study_room", seed: int = 0) -> np.ndarray:
    """(n, 7) differences of independent measures, a typical difference each."""
    return np.random.default_rng(seed).normal(size=(n, len(MEASURES))) * typical_differences(setup)


def test_every_want_is_known_after_fifteen_clear_answers() -> None:
    differences = pairs(15)
    for objective in OBJECTIVES:
        choices = differences[:, objective.measure] * objective.sign > 0
        posterior = Posterior.from_answers("study_room", differences, choices.tolist(), QUICK)
        assert posterior.dominant() == objective.name
        assert posterior.mean_weights()[NAMES.index(objective.name)] == 1
        fresh = pairs(200, seed=1)
        right = (posterior.predict(fresh) > 0.5) == (fresh[:, objective.measure] * objective.sign > 0)
        assert right.mean() > 0.9


def test_two_wants_are_both_found() -> None:
    differences = pairs(60)
    scaled = differences / typical_differences("study_room")
    choices = 0.6 * scaled[:, 0] - 0.4 * scaled[:, 4] > 0  # farther, and smoother
    posterior = Posterior.from_answers("study_room", differences, choices.tolist(), QUICK)
    weights = posterior.mean_weights()
    assert {NAMES[k] for k in np.flatnonzero(weights > 0.3)} == {"farther", "smoother"}
    assert weights[NAMES.index("smoother")] == pytest.approx(0.4 / 0.6, abs=0.25)


def test_wrong_answers_are_survived_and_told() -> None:
    differences = pairs(40)
    choices = differences[:, 0] > 0
    choices[::10] = ~choices[::10]
    clean = Posterior.from_answers("study_room", differences, (differences[:, 0] > 0).tolist(), QUICK)
    wrong = Posterior.from_answers("study_room", differences, choices.tolist(), QUICK)
    assert wrong.dominant() == "farther"
    assert wrong.masses() @ wrong.lapse_rate > clean.masses() @ clean.lapse_rate
    far = np.zeros((1, len(MEASURES)))
    far[0, 0] = 3 * typical_differences("study_room")[0]
    assert 0.5 < wrong.predict(far)[0] < clean.predict(far)[0]


def test_answer_by_answer_and_all_at_once_are_the_same_posterior() -> None:
    differences, config = pairs(30), QUICK
    choices = (differences[:, 3] < 0).tolist()
    posterior = Posterior.prior("study_room", config)
    for difference, choice in zip(differences, choices, strict=True):
        posterior = posterior.updated(difference, choice)
    again = Posterior.from_answers("study_room", differences, choices, config)
    assert np.array_equal(posterior.weights, again.weights)
    assert np.array_equal(posterior.log_mass, again.log_mass)
    assert posterior.draws > 0  # the particles were drawn anew on the way, and are still enough
    assert posterior.effective_particles() >= config.least_effective * len(posterior.weights)


def test_naming_the_drives_the_other_way_round_changes_nothing() -> None:
    differences = pairs(12)
    choices = differences[:, 2] > 0
    one = Posterior.from_answers("study_room", differences, choices.tolist(), QUICK)
    other = Posterior.from_answers("study_room", -differences, (~choices).tolist(), QUICK)
    assert np.allclose(one.shares(), other.shares(), atol=1e-5)
    fresh = pairs(5, seed=2)
    assert np.allclose(one.predict(fresh), 1 - one.predict(-fresh), atol=1e-5)


def test_before_any_answer_nothing_is_known() -> None:
    prior = Posterior.prior("open_field", QUICK)
    assert len(prior.weights) >= 0.9 * QUICK.particles
    with_opposites = pairs(50, "open_field") * [1, 1, 0, 0, 0, 0, 0]  # of these as many want more as less
    assert prior.predict(with_opposites) == pytest.approx(0.5, abs=0.05)
    assert prior.entropy_bits() > 3.0
    after = Posterior.from_answers("open_field", *_farther("open_field", 15), QUICK)
    assert after.entropy_bits() < 1.0


def test_the_foremost_want_is_the_probable_one_not_the_largest_mean() -> None:
    shares = np.zeros((3, len(NAMES)), dtype=np.float32)
    shares[:2, 0], shares[:2, 4], shares[2, 0] = 0.4, 0.6, 1.0
    few = Posterior.prior("study_room", QUICK).sample(3)
    doubtful = replace(few, weights=shares)
    assert NAMES[int(doubtful.shares().argmax())] == NAMES[0]
    assert doubtful.dominant() == NAMES[4]
    assert doubtful.foremost() == pytest.approx([1 / 3, 0, 0, 0, 2 / 3, 0, 0, 0, 0])


def test_somebody_who_looks_at_the_beginning_only_is_understood() -> None:
    differences = np.stack([pairs(25, seed=k) for k in range(len(SPANS_S))], axis=1)  # beginnings tell otherwise
    choices = (differences[:, 1, 2] > 0).tolist()  # clearance, of the first four seconds
    posterior = Posterior.from_answers("study_room", differences, choices, QUICK)
    assert posterior.dominant() == "clearance"
    by_span = np.bincount(posterior.span, weights=posterior.masses(), minlength=len(SPANS_S))
    assert by_span[1] > 0.8
    fresh = np.stack([pairs(200, seed=10 + k) for k in range(len(SPANS_S))], axis=1)
    assert ((posterior.predict(fresh) > 0.5) == (fresh[:, 1, 2] > 0)).mean() > 0.9  # what will be answered
    assert ((posterior.predict(fresh[:, 0]) > 0.5) == (fresh[:, 0, 2] > 0)).mean() > 0.9  # what is wanted
    whole = Posterior.from_answers("study_room", differences[:, 0], choices, QUICK)
    assert np.bincount(whole.span, weights=whole.masses())[0] == pytest.approx(0.8, abs=0.08)


def _farther(setup: str, n: int) -> tuple[np.ndarray, list[bool]]:
    differences = pairs(n, setup)
    return differences, (differences[:, 0] > 0).tolist()


def test_particles_stay_possible_through_all_moves() -> None:
    posterior = Posterior.from_answers("study_room", *_farther("study_room", 80), QUICK)
    assert posterior.weights.min() >= 0
    assert posterior.weights.sum(axis=1) == pytest.approx(1, abs=1e-3)
    assert (posterior.weights > 0).sum(axis=1).max() <= 3
    for a, b in OPPOSITES:
        assert not ((posterior.weights[:, a] > 0) & (posterior.weights[:, b] > 0)).any()
    low, high = QUICK.rationality
    assert low * 0.999 <= posterior.rationality.min()
    assert posterior.rationality.max() <= high * 1.001
    assert posterior.lapse_rate.min() >= 0
    assert posterior.lapse_rate.max() <= QUICK.highest_lapse_rate


def test_with_left_right_symmetry_nobody_wants_a_side() -> None:
    config = PosteriorConfig(particles=4_000, left_right_symmetry=True)
    differences = pairs(40)
    choices = (differences[:, 1] > 0).tolist()  # answers that are about the side all the same
    posterior = Posterior.from_answers("study_room", differences, choices, config)
    assert posterior.importance()["person_on_left"] == posterior.importance()["person_on_right"] == 0
    assert len(supports(left_right_symmetry=True)) < len(supports())


def test_preference_weights_are_what_a_conditioned_policy_takes() -> None:
    shares = np.array([0.5, 0.1, 0.0, 0.0, 0.3, 0.05, 0.05, 0.0, 0.0])
    weights = weights_of_shares(shares)
    assert weights.dtype == np.float32
    assert weights[0] == 1
    assert weights[1] == 0  # the opposite, taken off
    assert weights[4] == pytest.approx(0.75)
    assert (weights[5:7] == 0).all()  # too small
    assert not weights_of_shares(np.zeros(9)).any()


def test_a_choice_too_few_is_refused() -> None:
    with pytest.raises(LearningError, match="choices = 1"):
        Posterior.from_answers("study_room", pairs(2), [True], QUICK)


def test_the_reward_model_predicts_stores_and_says_what_matters(distance_answers: list[Preference]) -> None:
    model = fit_weights(distance_answers[:15], QUICK)
    assert accuracy(model, distance_answers[15:]) > 0.9
    assert max(model.importance(), key=model.importance().__getitem__) == "farther"
    again = RewardModel.from_bytes(model.to_bytes())
    assert isinstance(again, WeightsRewardModel)
    pair = distance_answers[20]
    assert again.log_odds(pair.chosen, pair.rejected) == model.log_odds(pair.chosen, pair.rejected)
    assert again.trajectory_reward(pair.chosen) > again.trajectory_reward(pair.rejected)
    trajectory = pair.chosen
    steps = again.rewards(trajectory.observations, trajectory.actions, trajectory.next_observations)
    assert steps.shape == (len(trajectory.actions),)
    assert (steps <= 0).all()
