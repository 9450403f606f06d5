"""Chance does not pass unnoticed: predictions of unseen answers stand beside chance and majority."""

from __future__ import annotations

import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.rewards.held_out import Prediction, majority_share, predictions
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.rewards.weights import fit_weights


def quick(preferences: list[Preference]) -> RewardModel:
    return fit_weights(preferences, PosteriorConfig(particles=3_000))


@pytest.mark.parametrize(("oracle", "verdict"), [("shortest", "better"), ("random", "no_better_than_chance")])
def test_a_preference_is_predicted_and_coin_tosses_are_not(study_queries: QuerySet, oracle: str, verdict: str) -> None:
    answers = make_oracle(oracle, seed=3).answer(study_queries.queries[:40])
    found = predictions(answers, quick, majority=0.5, people=1, folds=5, seed=0)
    assert found.verdict == verdict
    assert found.low is not None
    assert found.accuracy is not None
    assert found.low < found.accuracy
    assert (found.n, found.chance) == (40, 0.5)


def test_who_always_takes_the_same_side_is_predicted_by_that_alone() -> None:
    assert majority_share(["a"] * 9 + ["b"], [f"c{k}" for k in range(10)], [f"r{k}" for k in range(10)]) == 0.9
    assert (
        Prediction(100, "5_folds", majority=0.9, accuracy=0.85, low=0.77, high=0.9).verdict == "no_better_than_majority"
    )


def test_what_most_others_chose_of_the_same_pair_is_the_majority_of_several_people() -> None:
    """Three people, two pairs: all agree on the first, two of three on the second."""
    chosen, rejected = ["x", "x", "x", "u", "u", "v"], ["y", "y", "y", "v", "v", "u"]
    assert majority_share(["a", "b"] * 3, chosen, rejected) == pytest.approx((3 + 0.5 + 0.5 + 0) / 6)


def test_two_answers_are_too_few_to_tell(study_queries: QuerySet) -> None:
    answers = make_oracle("shortest").answer(study_queries.queries[:2])
    found = predictions(answers, quick, majority=0.5, people=1, folds=5, seed=0)
    assert (found.verdict, found.accuracy) == ("too_few_answers", None)
    with pytest.raises(LearningError, match="none given"):
        majority_share([], [], [])
