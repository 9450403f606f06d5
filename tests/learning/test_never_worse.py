"""A policy is somebody's own only where it is better for them, by their own answers; answers that cannot be predicted
say so."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats

from desirepath.learning.alignment.gate import surely_better
from desirepath.learning.alignment.never_worse import better_for_person
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.objectives import preference_weights
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.predictive_check import PredictiveCheck, check_answers
from desirepath.learning.preferences.sureness import Sureness
from desirepath.learning.queries.queries import QuerySet

CONFIG = FreeConfig(posterior=PosteriorConfig(particles=3_000))


@pytest.fixture(scope="module")
def differences(study_queries: QuerySet) -> PairDifferences:
    return PairDifferences.of("study_room", [(q.trajectory_a, q.trajectory_b) for q in study_queries.queries[:40]])


def test_a_policy_is_shown_to_who_wants_it_and_to_nobody_else(
    study_queries: QuerySet, differences: PairDifferences
) -> None:
    base = load_policy("study_room/base")
    farther = load_conditioned("study_room/conditioned").at(preference_weights({"farther": 1.0})).without_critic()
    verdicts = {}
    for name in ("min-human-distance", "closer", "random"):
        chosen = np.equal(make_oracle(name, seed=3).choices(study_queries.queries[:40]), 0)
        posterior, _ = check_answers(differences[:15], chosen[:15], CONFIG)
        verdicts[name] = better_for_person(posterior, farther, base, seed=0, scenes=40)
    assert verdicts["min-human-distance"].passed
    assert verdicts["min-human-distance"].probability_better > 0.95
    assert not verdicts["closer"].passed
    assert verdicts["closer"].probability_better < 0.2
    assert not verdicts["random"].passed
    farther_for_them = verdicts["min-human-distance"]
    assert 0.85 <= farther_for_them.probability_clearly_better <= farther_for_them.probability_better
    assert (farther_for_them.as_dict()["least_gain"], farther_for_them.as_dict()["clearly_needed"]) == (0.05, 0.85)


def test_what_is_surely_better_by_next_to_nothing_is_not_shown() -> None:
    """Who was harmed, was harmed by such policies: 5 of 69 before."""
    assert surely_better(Sureness(0.97, 0.9))
    assert not surely_better(Sureness(0.97, 0.6)), "surely better, but perhaps by nothing"
    assert not surely_better(Sureness(0.88, 0.86)), "nine tenths are needed of being better at all"
    assert not surely_better(Sureness.of(FreePosterior.prior("study_room", CONFIG), None)), "the usual policy itself"


def test_the_usual_policy_is_not_better_than_itself(study_queries: QuerySet, differences: PairDifferences) -> None:
    base = load_policy("study_room/base")
    posterior, _ = check_answers(differences[:2], np.array([True, False]), CONFIG)
    verdict = better_for_person(posterior, base, base, seed=0, scenes=5)
    assert (verdict.passed, verdict.probability_better) == (False, 0.5)


def test_answers_that_can_be_predicted_come_true_as_claimed(
    study_queries: QuerySet, differences: PairDifferences
) -> None:
    chosen = np.equal(make_oracle("min-human-distance").choices(study_queries.queries[:15]), 0)
    _, check = check_answers(differences[:15], chosen, CONFIG)
    assert (check.answers, check.verdict) == (15, "as_claimed")
    assert check.correct >= 10
    assert check.log_score > np.log(0.5)
    assert check.something_else < 0.5
    _, few = check_answers(differences[:2], chosen[:2], CONFIG)
    assert few.verdict == "too_few_answers"


def test_who_answers_otherwise_than_claimed_is_told() -> None:
    told = PredictiveCheck(20, 8, 17.0, float(stats.binom.cdf(8, 20, 0.85)), -1.2, 0.7, {"jerk": -1.0})
    assert told.p_value < 0.001
    assert told.as_dict()["verdict"] == "overclaimed"


def test_the_chance_of_so_few_predicted_is_summed_over_all_that_could_have_come_true(
    differences: PairDifferences,
) -> None:
    """What is claimed of each answer follows from the checks of ever more of them; of 2^5 outcomes those count in which
    no more came true."""
    chosen = np.array([True, False, False, True, False])
    checks = [check_answers(differences[:n], chosen[:n], CONFIG)[1] for n in range(1, 6)]
    sure = np.diff([0.0, *(check.claimed for check in checks)])
    assert ((sure >= 0.5) & (sure < 1)).all()
    for n, check in enumerate(checks, 1):
        chance = sum(
            np.prod(np.where(came_true, sure[:n], 1 - sure[:n]))
            for came_true in product((True, False), repeat=n)
            if sum(came_true) <= check.correct
        )
        assert check.p_value == pytest.approx(chance)
