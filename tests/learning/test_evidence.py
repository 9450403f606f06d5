"""Answers that are more than a choice of two: each likelihood by itself, and what the one posterior makes of them."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest

from desirepath.learning.preferences.evidence.evidence import Evidence, Habits
from desirepath.learning.preferences.evidence.graded_pair import GradedPair
from desirepath.learning.preferences.evidence.ranking import Ranking
from desirepath.learning.preferences.evidence.rating import Rating
from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import NAMES, gains
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig
from desirepath.learning.preferences.spans import SPANS_S

QUICK = PosteriorConfig(particles=4_000)
ROOM = "study_room"
WORTH = np.array([[0.3, -0.4, 1.2], [2.0, 0.0, -2.0]])
HABITS = Habits(np.array([0.0, 0.1]), np.array([[0.2, 0.9], [0.5, 2.0]]))
NOBODY = np.zeros((3, len(SPANS_S), len(MEASURES)))
GRADED = [(1, "clear"), (1, "slight"), (0, "no_difference"), (-1, "slight"), (-1, "clear")]


def measured(n: int, k: int, seed: int = 0) -> np.ndarray:
    """(n, k, spans, 7) of independent measures, a typical difference each, that all spans see alike."""
    drawn = np.random.default_rng(seed).normal(size=(n, k, 1, len(MEASURES))) * typical_differences(ROOM)
    return np.repeat(drawn, len(SPANS_S), axis=2)


def worth(alternatives: np.ndarray, **weights: float) -> np.ndarray:
    """(k,) of alternatives, in typical differences, to somebody of these weights."""
    row = np.array([weights.get(name, 0.0) for name in NAMES])
    return gains(alternatives[:, 0] / typical_differences(ROOM)) @ row


def after(answers: list[Evidence]) -> Posterior:
    posterior = Posterior.prior(ROOM, QUICK)
    for answer in answers:
        posterior = posterior.observed(answer)
    return posterior


@pytest.mark.parametrize(
    "possible",
    [
        [GradedPair(NOBODY[:2], 1, None, 2), GradedPair(NOBODY[:2], -1, None, 2)],
        [GradedPair(NOBODY[:2], b, "no_difference" if b == 0 else None, 3) for b in (-1, 0, 1)],
        [GradedPair(NOBODY[:2], *said, 4) for said in GRADED if said[0]],
        [GradedPair(NOBODY[:2], *said, 5) for said in GRADED],
        [Rating(NOBODY, rating, 5) for rating in range(1, 6)],
    ],
    ids=["pair", "ties", "degrees", "both", "rating"],
)
def test_what_could_be_answered_is_certain_together(possible: list[Evidence]) -> None:
    columns = 3 if isinstance(possible[0], Rating) else 2
    together = sum(np.exp(answer.log_likelihood(WORTH[:, :columns], HABITS)) for answer in possible)
    assert together == pytest.approx([1.0, 1.0])


def test_all_orders_of_three_are_certain_together_and_the_best_of_them_too() -> None:
    orders = [np.exp(Ranking(NOBODY, 3).log_likelihood(WORTH[:, order], HABITS)) for order in permutations(range(3))]
    assert sum(orders) == pytest.approx([1.0, 1.0])
    best = [np.exp(Ranking(NOBODY, 1).log_likelihood(WORTH[:, [k, *{0, 1, 2} - {k}]], HABITS)) for k in range(3)]
    assert sum(best) == pytest.approx([1.0, 1.0])
    assert best[2][0] == pytest.approx(math.exp(1.2) / np.exp(WORTH[0]).sum())


def test_pairs_are_those_of_bradley_and_terry_and_ties_those_of_rao_and_kupper() -> None:
    advantage, ratio = WORTH[0, 0] - WORTH[0, 1], math.exp(HABITS.criteria[0, 0])
    a, b = np.exp(WORTH[0, :2])
    pair = GradedPair(NOBODY[:2], 1, None, 2).log_likelihood(WORTH[:, :2], HABITS)
    assert np.exp(pair[0]) == pytest.approx(1 / (1 + math.exp(-advantage)))
    tie = GradedPair(NOBODY[:2], 0, "no_difference", 3).log_likelihood(WORTH[:, :2], HABITS)
    assert np.exp(tie[0]) == pytest.approx((ratio**2 - 1) * a * b / ((a + ratio * b) * (ratio * a + b)))
    two = Ranking(NOBODY[:2], 2).log_likelihood(WORTH[:, :2], HABITS)
    assert two == pytest.approx(pair), "an order of two is a pair"


def test_an_answer_that_was_not_possible_is_none() -> None:
    for better, degree, possible in ((0, "no_difference", 4), (1, "clear", 3), (1, None, 5), (1, "no_difference", 3)):
        with pytest.raises(ValueError, match="not among"):
            GradedPair(NOBODY[:2], better, degree, possible)


def test_who_says_how_clearly_is_known_better_than_who_only_chooses() -> None:
    pairs, chosen, said = measured(14, 2), [], []
    for pair in pairs:
        first, second = worth(pair, farther=0.6, smoother=0.4)
        size = abs(first - second)
        better = 0 if size < 0.3 else 1 if first > second else -1
        degree = "no_difference" if better == 0 else "slight" if size < 1.0 else "clear"
        said.append(GradedPair(pair, better, degree, 5))
        chosen.append(bool(first > second))
    graded = after(said).shares()
    plain = Posterior.from_answers(ROOM, pairs[:, 0] - pairs[:, 1], chosen, QUICK).shares()
    true = np.array([{"farther": 0.6, "smoother": 0.4}.get(name, 0.0) for name in NAMES])
    assert np.abs(graded - true).sum() < np.abs(plain - true).sum()
    assert np.abs(graded - true).sum() < 0.4


def test_a_few_orders_of_five_tell_whose_they_are() -> None:
    answers = []
    for drives in measured(5, 5):
        order = np.argsort(-worth(drives, clearance=0.7, faster=0.3))
        answers.append(Ranking(drives[order], 5))
    posterior = after(answers)
    assert posterior.dominant() == "clearance"
    assert posterior.importance()["faster"] == pytest.approx(0.3, abs=0.15)


def test_ratings_tell_whose_they_are_and_the_first_one_nothing() -> None:
    drives = measured(1, 20)[0]
    value = worth(drives, shorter=1.0)
    answers = []
    for k in range(1, 21):
        place = (value[:k] < value[k - 1]).mean() + 0.5 / k
        answers.append(Rating(drives[:k], 1 + min(int(7 * place), 6), 7))
    assert after(answers[:1]).shares() == pytest.approx(Posterior.prior(ROOM, QUICK).shares())
    posterior = after(answers)
    assert posterior.dominant() == "shorter"
    assert posterior.importance()["shorter"] > 0.8


def test_answers_of_every_kind_are_believed_together_in_any_order() -> None:
    drives, pairs = measured(3, 4, seed=3), measured(6, 2, seed=4)
    orders: list[Evidence] = [Ranking(of[np.argsort(-worth(of, farther=1.0))], 4) for of in drives]
    choices = [bool(np.diff(worth(pair, farther=1.0))[0] < 0) for pair in pairs]

    def told(posterior: Posterior) -> Posterior:
        for answer in orders:
            posterior = posterior.observed(answer)
        return posterior

    first = told(Posterior.from_answers(ROOM, pairs[:, 0] - pairs[:, 1], choices, QUICK))
    then = told(Posterior.prior(ROOM, QUICK))
    for pair, choice in zip(pairs, choices, strict=True):
        then = then.updated(pair[0] - pair[1], choice)
    assert first.dominant() == then.dominant() == "farther"
    assert first.shares() == pytest.approx(then.shares(), abs=0.1)
    assert first.draws > 0, "the particles were drawn anew on the way, of all that was said"


def test_bits_of_an_answer_are_those_that_it_tells() -> None:
    (pair,) = measured(1, 2)
    prior = Posterior.prior(ROOM, QUICK)
    told = [prior.bits_of(GradedPair(pair, better, degree, 5)) for better, degree in GRADED]
    assert min(told) > 0
    assert prior.bits_of(Rating(pair[:1], 3, 5)) == pytest.approx(0.0, abs=1e-6), "a first rating tells nothing"
    assert max(told) > prior.bits_of(GradedPair(pair, 1, None, 2))
