"""A library of policies made before anybody came: somebody whom the nine objectives do not describe has theirs at once,
and never has to wait for a training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.alignment.policy_library import (
    FORMAT_WITHOUT_MIXES,
    TIME,
    PolicyLibrary,
    best_of,
    expected_gains,
    mix_policies,
)
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.people.card import member
from desirepath.learning.policies.shipped import (
    load_conditioned,
    load_policy,
    load_policy_library,
    load_shipped,
    load_step_basis,
)
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.npz import from_npz, to_npz
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.shipping.policy_libraries import draw_directions, library_settings, measure_against

SETUPS = ("study_room", "open_field")


@pytest.fixture(scope="module", params=SETUPS)
def library(request: pytest.FixtureRequest) -> PolicyLibrary:
    found = load_policy_library(request.param)
    assert found is not None
    return found


def test_the_shipped_library_is_what_its_card_says(library: PolicyLibrary) -> None:
    assert isinstance(load_shipped(f"{library.setup}/policy_library"), PolicyLibrary)
    assert len(library.actors) >= 10
    assert len(library) == len(library.measures.steps)
    assert library.allowed[len(library.settings) :].all()
    assert load_policy_library("corridor") is None


def test_nobody_is_given_a_policy_that_dawdles_or_gets_lost(library: PolicyLibrary) -> None:
    measures, place = library.measures, len(library) - 1
    assert 2 <= library.longest_s <= 12
    assert library.allowed.sum() >= 60
    # somebody whose every answer speaks for what this one does
    answers = [True] * 15
    believed = FreePosterior.from_answers(measures.pairs[[place] * 15], answers)
    steps = StepPosterior.from_answers(np.repeat(measures.steps[[place]], 15, axis=0), answers)
    expected = expected_gains(measures, believed, steps)
    assert best_of(library, believed, steps) == np.where(library.allowed, expected, -np.inf).argmax()
    first = best_of(library, believed, steps)
    slower = measures.pairs.seen.copy()
    slower[first, 0, TIME] = library.longest_s + 1
    lost = measures.success.copy()
    lost[first] = 0.9
    for spoiled in (
        replace(measures, pairs=replace(measures.pairs, seen=slower)),
        replace(measures, success=lost),
    ):
        without = replace(library, measures=spoiled)
        assert best_of(without, believed, steps) != first
        assert len(without.without_what_is_not_allowed()) == len(library) - (first >= len(library.settings))


def test_what_is_stored_of_a_policy_is_what_it_does(library: PolicyLibrary) -> None:
    setup = library.setup
    base, conditioned, basis = (
        load_policy(f"{setup}/base"),
        load_conditioned(f"{setup}/conditioned"),
        load_step_basis(setup),
    )
    assert basis is not None
    places = np.array([3, len(library) - 1])
    scenes = scene_set(setup, 80, purpose=Purpose.ALIGN_SELECT, seed=7_100)
    again = measure_against(base, [library.policy(int(k), conditioned, base) for k in places], basis, scenes)
    stored = library.measures[places]
    np.testing.assert_allclose(again.pairs.named, stored.pairs.named, atol=2e-3)
    np.testing.assert_allclose(again.mirrored.embedding, stored.mirrored.embedding, atol=2e-3)
    np.testing.assert_allclose(again.steps, stored.steps, atol=2e-3)
    np.testing.assert_allclose(again.success, stored.success, atol=0.02)


def test_fifteen_answers_find_a_policy_that_somebody_outside_the_nine_prefers(study_queries: QuerySet) -> None:
    pairs = [(query.trajectory_a, query.trajectory_b) for query in study_queries.queries[:15]]
    library, basis = load_policy_library("study_room"), load_step_basis("study_room")
    base, conditioned = load_policy("study_room/base"), load_conditioned("study_room/conditioned")
    assert library is not None
    assert basis is not None
    scenes = scene_set("study_room", 60, purpose=Purpose.REPORT, seed=71)
    usual = rollout(get_setup("study_room"), base.rollout_policy, scenes)
    raised = []
    for name in ("network:1003", "network:1005", "thresholds:1000", "mixture:1001"):
        person = member(name, "study_room")
        chosen = np.array([person.score(a) > person.score(b) for a, b in pairs])
        believed = FreePosterior.from_answers(PairDifferences.of("study_room", pairs), chosen)
        place = best_of(library, believed, StepPosterior.from_answers(step_differences(basis, pairs), chosen))
        own = rollout(get_setup("study_room"), library.policy(place, conditioned, base).rollout_policy, scenes)
        both = [k for k in range(60) if own[k].outcome == usual[k].outcome == Outcome.SUCCESS]
        raised.append((person.scores([own[k] for k in both]) - person.scores([usual[k] for k in both])).mean() > 0)
        assert len(both) >= 55
    assert sum(raised) >= 3


def test_before_any_answer_nobody_is_expected_to_gain_from_a_library(library: PolicyLibrary) -> None:
    nobody = StepPosterior.from_answers(library.measures.steps[:0], [])
    expected, deviation = nobody.advantages(library.measures.steps)
    np.testing.assert_allclose(expected, 0)
    assert (deviation > 0).all()
    assert np.isfinite(expected_gains(library.measures, FreePosterior.prior(library.setup), nobody)).all()


def test_a_damaged_library_is_named(tmp_path: Path) -> None:
    (tmp_path / "policy_library.npz").write_bytes(b"no library")
    with pytest.raises(LearningError, match=r"policy_library\.npz: not a desirepath policy library"):
        PolicyLibrary.load(tmp_path / "policy_library.npz")
    with pytest.raises(LearningError, match="cannot read policy library"):
        PolicyLibrary.load(tmp_path / "none.npz")


def test_directions_are_opposite_and_orthogonal() -> None:
    found = draw_directions(24, 48)
    np.testing.assert_allclose(found[0::2], -found[1::2])
    np.testing.assert_allclose(found[0::2] @ found[0::2].T, 24 * np.eye(24), atol=1e-3)
    assert len(library_settings(51)) == 69


def test_a_library_of_before_mixes_is_read_and_each_trained_policy_is_its_own(tmp_path: Path) -> None:
    library = load_policy_library("open_field")
    assert library is not None
    few = PolicyLibrary(
        library.setup,
        library.settings[:2],
        library.weights[:2],
        library.actors[:2],
        np.eye(2, dtype=np.float32),
        library.measures[np.arange(4)],
    )
    meta, arrays = from_npz(few.to_bytes())
    arrays.pop("mixes")
    (tmp_path / "old.npz").write_bytes(to_npz(meta | {"format": FORMAT_WITHOUT_MIXES}, arrays))
    again = PolicyLibrary.load(tmp_path / "old.npz")
    assert len(again) == 4
    np.testing.assert_array_equal(again.mixes, np.eye(2))
    base, conditioned = load_policy("open_field/base"), load_conditioned("open_field/conditioned")
    for layer, stored in zip(again.policy(3, conditioned, base).actor, library.actors[1], strict=True):
        np.testing.assert_array_equal(layer, stored.astype(np.float32))
    halfway = mix_policies(base, few.actors, np.array([0.0, 0.5], dtype=np.float32))
    np.testing.assert_allclose(halfway.actor[0], (base.actor[0] + few.actors[1][0]) / 2, atol=1e-5)
