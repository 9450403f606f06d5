"""Simulated people: who answers by a coin or by the letter is said nothing about, who has a taste mostly is."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig
from desirepath.learning.preferences.predictive_check import PredictiveCheck
from desirepath.learning.preferences.predictive_power import better_than_chance, odds_against_chance
from desirepath.learning.queries.choosing import STRATEGIES, Candidates
from desirepath.learning.queries.queries import QuerySet

ANSWERS = 15
CONFIG = PosteriorConfig(particles=3_000)
TASTES = ("min-human-distance", "closer", "person-on-left", "clearance", "shortest", "slow-near-person", "fastest")


@pytest.fixture(scope="module")
def seen(study_queries: QuerySet) -> np.ndarray:
    pairs = [(query.trajectory_a, query.trajectory_b) for query in study_queries.queries]
    return PairDifferences.of("study_room", pairs).seen


def odds_of(seen: np.ndarray, answers, seed: int) -> float:
    """Of a simulated person who is asked the pairs that tell most. answers(query, swapped): is the first chosen?"""
    random, posterior = np.random.default_rng([seed, 31]), Posterior.prior("study_room", CONFIG)
    left, given = list(range(len(seen))), []
    for _ in range(ANSWERS):
        k = left.pop(STRATEGIES["information"].ask_next(posterior, Candidates(seen, left), random).index)
        first = bool(answers(k, bool(random.integers(2))))
        probable = float(posterior.predict(seen[[k]])[0])
        given.append(probable if first else 1 - probable)
        posterior = posterior.updated(seen[k], first)
    return odds_against_chance(np.array(given))


def test_always_a_always_b_and_coins_are_hardly_ever_predicted(seen: np.ndarray) -> None:
    """Simulated. 200 of each: experiments/notebook."""
    for kind in ("a", "b", "coin"):
        said = 0
        for seed in range(12):
            coin = np.random.default_rng([seed, 7])
            clicks = {"a": lambda _, swapped: not swapped, "b": lambda _, swapped: swapped}
            answers = clicks.get(kind, lambda *_: coin.random() < 0.5)  # noqa: B023  called in this turn
            said += better_than_chance(odds_of(seen, answers, seed))
        assert said <= 1, kind


def test_who_has_a_taste_is_mostly_predicted(seen: np.ndarray, study_queries: QuerySet) -> None:
    """Simulated, each with one taste and one answer in twenty wrong."""
    said = []
    for seed, name in enumerate(TASTES):
        wrong = np.random.default_rng([seed, 8]).random(len(seen)) < 0.05
        firsts = np.equal(make_oracle(name, seed=seed).choices(study_queries.queries), 0) ^ wrong
        said.append(better_than_chance(odds_of(seen, lambda k, _, firsts=firsts: firsts[k], seed)))
    assert np.mean(said) > 0.7


def test_odds_are_those_of_the_answers_and_have_a_float_however_many_there_are() -> None:
    assert odds_against_chance(np.array([0.75, 0.25])) == pytest.approx(1.5 * 0.5)
    assert odds_against_chance(np.zeros(0)) == 1.0
    assert np.isfinite(odds_against_chance(np.full(5_000, 1.0)))
    assert not better_than_chance(odds_against_chance(np.zeros(3)))


def test_the_check_that_is_stored_says_it_by_the_same_rule() -> None:
    told = PredictiveCheck(15, 8, 9.6, 0.28, -0.67, 0.91, {"jerk": -1.0}, {"jerk": 9}, odds=1.4)
    assert told.as_dict()["better_than_chance"] is False
    assert told.as_dict()["agreeing"] == {"jerk": 9}
