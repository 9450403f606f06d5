"""Choosing queries: what tells most is asked first, nothing twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import NAMES, OPPOSITES
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig
from desirepath.learning.queries.choosing import (
    STRATEGIES,
    Candidates,
    StoppingRule,
    information_bits,
)
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.queries.varied_queries import balance, describe_differences, draw_weights
from desirepath.registries import RegistryError

QUICK = PosteriorConfig(particles=4_000)
PRIOR = Posterior.prior("study_room", QUICK)


def pairs(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, len(MEASURES))) * typical_differences("study_room")


@pytest.mark.parametrize("strategy", ["disagreement", "information"])
def test_of_alike_drives_and_different_ones_the_different_ones_are_shown(strategy: str) -> None:
    candidates = pairs(30) * 0.001
    candidates[17] = pairs(1)[0] * 2
    asked = Candidates(candidates, range(len(candidates)))
    chosen = STRATEGIES[strategy].ask_next(PRIOR, asked, np.random.default_rng(0))
    assert chosen.index == 17
    assert 0.2 < chosen.bits <= 1
    assert STRATEGIES[strategy].best_bits(PRIOR, asked) == pytest.approx(chosen.bits)


def test_what_is_known_already_tells_little() -> None:
    only_distance = np.zeros((40, len(MEASURES)))
    only_distance[:, 0] = np.linspace(0.5, 2, 40)
    posterior = Posterior.from_answers("study_room", only_distance[:20], [True] * 20, QUICK)
    before, after = (information_bits(p, only_distance[30:31])[0] for p in (PRIOR, posterior))
    assert after < 0.2 * before


def test_which_want_is_the_foremost_is_asked_before_how_much_each_counts() -> None:
    two = [NAMES.index("farther"), NAMES.index("smoother")]
    shares = np.zeros((PRIOR.weights.shape[0], len(NAMES)), dtype=np.float32)
    shares[:, two[0]] = np.linspace(0.3, 0.9, len(shares))
    shares[:, two[1]] = 1 - shares[:, two[0]]
    sure = np.full(len(shares), 50, np.float32)
    known = replace(PRIOR, weights=shares, rationality=sure, log_mass=np.zeros(len(shares)))
    typical = typical_differences("study_room")

    def told_apart_at(share: float) -> np.ndarray:
        difference = np.zeros(len(MEASURES))
        difference[0], difference[4] = (1 - share) * typical[0], share * typical[4]
        return difference

    middle, even = told_apart_at(0.6), told_apart_at(0.5)  # half of the particles each way; the even one is foremost
    candidates = np.stack([middle, even])
    assert information_bits(known, candidates).argmax() == 0
    asked = Candidates(candidates, (0, 1))
    assert STRATEGIES["information"].ask_next(known, asked, np.random.default_rng(0)).index == 1


@pytest.mark.parametrize("strategy", ["disagreement", "information", "random"])
def test_only_what_is_left_is_asked(strategy: str) -> None:
    candidates = pairs(30)
    first = STRATEGIES[strategy].ask_next(PRIOR, Candidates(candidates, range(30)), np.random.default_rng(7))
    left = [k for k in range(30) if k != first.index]
    second = STRATEGIES[strategy].ask_next(PRIOR, Candidates(candidates, left), np.random.default_rng(7))
    assert left[second.index] != first.index
    assert STRATEGIES[strategy].ask_next(PRIOR, Candidates(candidates, left), np.random.default_rng(7)) == second


def test_a_strategy_that_nobody_has_is_refused() -> None:
    with pytest.raises(RegistryError, match="no 'best'; known are disagreement, information, "):
        STRATEGIES["best"]


def test_stopping_waits_for_several_poor_queries_in_a_row() -> None:
    rule = StoppingRule(below_bits=0.1, in_a_row=3, at_least=5)
    assert not rule.met([0.05] * 4)
    assert rule.met([0.05] * 5)
    assert not rule.met([0.05, 0.05, 0.05, 0.3, 0.05, 0.05])
    assert rule.met([0.9, 0.9, 0.05, 0.05, 0.05])


def test_what_pairs_differ_in_is_described(study_queries: QuerySet) -> None:
    described = describe_differences(study_queries)
    assert set(described["measures"]) == set(MEASURES)
    correlations = np.array(described["correlations"])
    assert np.allclose(np.diag(correlations), 1)
    i, j = (MEASURES.index(name) for name in described["largest_correlation"]["between"])
    assert correlations[i, j] == described["largest_correlation"]["value"]


def test_balancing_takes_apart_what_goes_together() -> None:
    random = np.random.default_rng(0)
    differences = random.normal(size=(600, len(MEASURES)))
    differences[:, 6] = differences[:, 3] + 0.5 * random.normal(size=600)  # longer is later, mostly
    places = np.repeat(np.arange(200), 3)
    chosen = balance(differences, places.tolist(), 60)
    assert len(set(places[chosen])) == 60
    before = np.corrcoef(differences.T)[3, 6]
    after = np.corrcoef(differences[chosen].T)[3, 6]
    assert before > 0.8
    assert abs(after) < 0.55


def test_drawn_wants_are_possible_and_cover_every_objective() -> None:
    wants = np.array(draw_weights(14, seed=0))
    assert wants.shape == (14, 9)
    assert (wants.max(axis=0) > 0).all()
    assert not any((wants[:, a] * wants[:, b]).any() for a, b in OPPOSITES)
