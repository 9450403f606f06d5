"""People in general as a prior: who is like them is predicted with fewer answers, who is not is not misled for long."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.alignment.each_scene import answers_of
from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.measures.steps import reference
from desirepath.learning.people.asked_people import Rater, people_of
from desirepath.learning.policies.choosing import Before
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.measures import measures
from desirepath.learning.preferences.people_in_general import FILE, comfort, people_in_general, rater_weights
from desirepath.learning.preferences.population_prior import IN_GENERAL, WeightPrior
from desirepath.learning.preferences.posterior import PosteriorConfig
from tests.answers import prefers_distance

CONFIG = FreeConfig(posterior=PosteriorConfig(particles=2_000))


def test_the_card_names_raters_source_and_terms() -> None:
    card = Card.load(card_path(FILE))
    assert card.sha256 == file_sha256(FILE)
    assert list(card.results["scenes"]) == list(rater_weights())
    assert "SocNav1" in card.notes[0]
    assert "CC BY 4.0" in card.notes[0]


@pytest.mark.parametrize("setup", ["study_room", "open_field"])
def test_whoever_stays_farther_from_the_person_is_more_comfortable(setup: str) -> None:
    driven = list(reference(setup).trajectories)
    nearest = measures(driven)[:, 0]
    differences = PairDifferences.of(setup, list(zip(driven[0::2], driven[1::2], strict=True)))
    expected, spread = people_in_general(setup).seen(differences)
    assert np.corrcoef(expected, nearest[0::2] - nearest[1::2])[0, 1] > 0.5
    assert spread.shape == (len(expected), len(rater_weights()))
    of_raters = comfort(np.stack(list(rater_weights().values())), driven)
    together = of_raters.mean(0)
    assert np.corrcoef(expected, together[0::2] - together[1::2])[0, 1] > 0.9


def test_of_crowds_nothing_is_said() -> None:
    with pytest.raises(LearningError, match="not about crowds"):
        people_in_general("crowd_hall")


def test_who_is_like_them_is_predicted_with_fewer_answers_and_who_is_not_is_not_misled_for_long() -> None:
    queries = load_queries("study_room/queries_varied_200").queries
    pairs = [(query.trajectory_a, query.trajectory_b) for query in queries]
    differences = PairDifferences.of("study_room", pairs)
    driven = [trajectory for pair in pairs for trajectory in pair]
    asked, rest = np.arange(40, 55), np.arange(60, 200)

    def believed(chosen: np.ndarray, count: int, before: WeightPrior | None) -> FreePosterior:
        rows = asked[:count]
        return FreePosterior.from_answers(differences[rows], chosen[rows], CONFIG, before)

    def right(chosen: np.ndarray, count: int, before: WeightPrior | None) -> float:
        predicted = believed(chosen, count, before).predict(differences[rest]) > 0.5
        return float((predicted == chosen[rest]).mean())

    gained, lost = [], []
    for rater in ("b", "c", "d"):
        scores = Rater(rater).scores(driven)
        likes, others = scores[0::2] > scores[1::2], people_in_general("study_room", without=rater)
        gained.append(right(likes, 8, others) - right(likes, 8, None))
        lost.append(right(~likes, 8, None) - right(~likes, 8, others))
    assert np.mean(gained) > 0.05
    assert np.mean(lost) < 0.03
    contrary = believed(~likes, 8, others).ways()
    assert sum(contrary.values()) == pytest.approx(1)
    assert contrary[IN_GENERAL] < 0.01 < 0.05 < FreePosterior.prior("study_room", CONFIG, others).ways()[IN_GENERAL]


def test_what_they_weigh_goes_with_the_robot_that_was_chosen_by_their_light() -> None:
    before = Before(people_in_general("study_room"))
    again = Before.from_arrays(before.to_arrays())
    assert (again.free.name, again.steps) == (IN_GENERAL, None)
    answers = answers_of(prefers_distance(4))
    pairs = answers.pairs
    expected = [replace(answers, before=one).believed[0].advantages(pairs)[0] for one in (before, again)]
    np.testing.assert_allclose(*expected)
    assert np.abs(expected[0] - answers.believed[0].advantages(pairs)[0]).max() > 1e-3


def test_raters_are_people_to_be_asked() -> None:
    assert [getattr(one, "name", "") for one in people_of("raters", 3, "study_room", 5).values()] == ["f", "a", "b"]
