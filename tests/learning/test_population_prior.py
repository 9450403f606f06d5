"""What people weigh before anybody is asked: fitted to simulated people, and to earlier participants."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.people.card import people_card
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.population_prior import (
    EarlierPerson,
    columns_of,
    fit_prior,
    prior_of_earlier,
    shipped_priors,
    to_bytes,
)
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.queries.queries import QuerySet
from desirepath.npz import from_npz

CONFIG = FreeConfig(posterior=PosteriorConfig(particles=2_000))


@pytest.fixture(scope="module")
def differences(study_queries: QuerySet) -> PairDifferences:
    return PairDifferences.of("study_room", [(q.trajectory_a, q.trajectory_b) for q in study_queries.queries])


def test_shipped_priors_are_of_families_that_may_be_tuned_on() -> None:
    for setup in ("study_room", "open_field"):
        assert {prior.name for prior in shipped_priors(setup)} <= set(people_card().tuning)
        assert len(shipped_priors(setup)) == 4


def test_a_prior_knows_what_all_weigh_and_what_they_differ_by(differences: PairDifferences) -> None:
    random = np.random.default_rng(3)
    columns = columns_of(differences)
    common, own = random.normal(size=columns.shape[1]), random.normal(size=(40, columns.shape[1]))
    prior = fit_prior("made up", columns, (2 * common + 0.5 * own) @ columns.T, rank=10)
    expected, may_differ = prior.seen(differences)
    assert np.corrcoef(expected, columns @ common)[0, 1] > 0.95
    assert may_differ.shape == (len(differences), 10)
    header, arrays = from_npz(to_bytes("study_room", (prior,), {}))
    assert header["names"] == ["made up"]
    np.testing.assert_allclose(arrays["made up.mean"], prior.mean, atol=1e-2)


def test_those_before_help_whoever_is_like_them_and_mislead_nobody_for_long(
    study_queries: QuerySet, differences: PairDifferences
) -> None:
    def answers(name: str) -> np.ndarray:
        return np.equal(make_oracle(name).choices(study_queries.queries), 0)

    asked = np.random.default_rng(1).permutation(len(differences))
    earlier, rest = answers("network:0"), asked[100:]
    people = [
        EarlierPerson(differences[rows], earlier[rows])
        for rows in (asked[first : first + 12] for first in range(0, 96, 12))
    ]
    before = prior_of_earlier("study_room", people)
    assert before is not None

    def right(name: str, count: int, *, told: bool) -> float:
        chosen = answers(name)
        few = asked[96 : 96 + count]
        prior = before if told else None
        posterior = FreePosterior.from_answers(differences[few], chosen[few], CONFIG, prior)
        return float(((posterior.predict(differences[rest]) > 0.5) == chosen[rest]).mean())

    assert right("network:0", 2, told=True) > right("network:0", 2, told=False) + 0.05
    assert prior_of_earlier("study_room", []) is None
    told = FreePosterior.prior("study_room", CONFIG, before)
    assert sum(told.ways().values()) == pytest.approx(1.0)
    for k in asked[60:72]:  # somebody who wants the opposite: what those before want is given up
        told = told.updated(differences[[k]], not earlier[k])
    assert told.ways()["earlier_participants"] < 0.2
