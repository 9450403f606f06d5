"""The posterior beyond the nine: says what they cannot, stays with them where they can, and knows how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.named import NAMES, named_measures
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.policies.mirroring import mirror_of
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.queries.queries import QuerySet
from desirepath.simulation.setups import get_setup

CONFIG = FreeConfig(posterior=PosteriorConfig(particles=3_000))


@pytest.fixture(scope="module")
def differences(study_queries: QuerySet) -> PairDifferences:
    pairs = [(q.trajectory_a, q.trajectory_b) for q in study_queries.queries]
    return PairDifferences.of("study_room", pairs)


def chosen_by(name: str, queries: QuerySet) -> np.ndarray:
    return np.equal(make_oracle(name).choices(queries.queries), 0)


def accuracy(posterior: FreePosterior, differences: PairDifferences, chosen: np.ndarray, first: int) -> float:
    return float(((posterior.predict(differences[first:]) > 0.5) == chosen[first:]).mean())


def test_who_is_outside_the_list_is_predicted_better_and_the_posterior_says_so(
    study_queries: QuerySet, differences: PairDifferences
) -> None:
    gained = []
    for number in range(3):
        chosen = chosen_by(f"network:{number}", study_queries)
        posterior = FreePosterior.from_answers(differences[:40], chosen[:40], CONFIG)
        nine = (posterior.objectives.predict(differences.seen[40:]) > 0.5) == chosen[40:]
        gained.append(accuracy(posterior, differences, chosen, 40) - nine.mean())
    assert np.mean(gained) > 0


def test_who_is_in_the_list_is_still_found(study_queries: QuerySet, differences: PairDifferences) -> None:
    chosen = chosen_by("min-human-distance", study_queries)
    posterior = FreePosterior.from_answers(differences[:15], chosen[:15], CONFIG)
    assert posterior.something_else() < 0.5
    assert posterior.objectives.dominant() == "farther"
    assert accuracy(posterior, differences, chosen, 15) > 0.85


def test_before_any_answer_nothing_is_claimed(differences: PairDifferences) -> None:
    prior = FreePosterior.prior("study_room", CONFIG)
    assert prior.predict(differences[:5]) == pytest.approx(0.5, abs=0.2)
    assert prior.probability_better(differences[:50]) == pytest.approx(0.5, abs=0.2)
    assert prior.something_else() == pytest.approx(0.5)
    assert prior.named_weights() == {}


def test_a_pair_turned_around_is_answered_the_other_way(study_queries: QuerySet, differences: PairDifferences) -> None:
    chosen = chosen_by("network:1", study_queries)
    posterior = FreePosterior.from_answers(differences[:10], chosen[:10], CONFIG)
    turned = PairDifferences("study_room", -differences.seen, -differences.named, -differences.embedding)
    assert posterior.predict(differences) + posterior.predict(turned) == pytest.approx(1.0, abs=1e-3)


def test_what_was_preferred_is_most_probably_better(study_queries: QuerySet, differences: PairDifferences) -> None:
    chosen = chosen_by("network:0", study_queries)
    posterior = FreePosterior.from_answers(differences[:60], chosen[:60], CONFIG)
    rest = np.arange(60, len(chosen))
    assert posterior.probability_better(differences[rest[chosen[60:]]]) > 0.9
    assert posterior.probability_better(differences[rest[~chosen[60:]]]) < 0.1
    assert posterior.probability_better(differences[[]]) == 0.5
    liked = differences[rest[chosen[60:]]]
    by_much = [posterior.probability_better(liked, by) for by in (0.0, 0.2, 1.0, 5.0)]
    assert by_much == sorted(by_much, reverse=True), "better by much is less probable than better at all"
    assert by_much[-1] < 0.1 < 0.9 < by_much[0], "on average nothing is better by five typical differences"


def test_who_prefers_no_side_would_answer_the_mirrored_pair_alike(study_queries: QuerySet) -> None:
    pairs = [(q.trajectory_a, q.trajectory_b) for q in study_queries.queries[:3]]
    mirror = mirror_of(get_setup("study_room"))
    turned = [(mirror.seen_in(a), mirror.seen_in(b)) for a, b in pairs]
    one, other = (PairDifferences.of("study_room", some, left_right_symmetry=True) for some in (pairs, turned))
    np.testing.assert_allclose(one.named, other.named, atol=1e-5)
    np.testing.assert_allclose(one.embedding, other.embedding, atol=1e-5)
    assert np.abs(one.named[:, NAMES.index("turning_left")]).max() < 1e-6
    assert np.abs(PairDifferences.of("study_room", pairs).named[:, NAMES.index("turning_left")]).max() > 0.01


def test_an_answer_that_is_known_tells_nothing_more(study_queries: QuerySet, differences: PairDifferences) -> None:
    chosen = chosen_by("network:0", study_queries)
    posterior = FreePosterior.from_answers(differences[:20], chosen[:20], CONFIG)
    bits = posterior.information_bits(differences)
    assert ((bits >= 0) & (bits <= 1)).all()
    assert bits[:20].mean() < bits[20:].mean()


def test_a_question_tells_about_what_is_to_be_predicted_and_not_about_all_there_is(
    study_queries: QuerySet, differences: PairDifferences
) -> None:
    """A pair asked again tells most about itself; none tells about a pair whose answer is a coin's."""
    chosen = chosen_by("network:0", study_queries)
    posterior = FreePosterior.from_answers(differences[:6], chosen[:6], CONFIG)
    bits = posterior.bits_about(differences[6:30], differences[[12]])
    assert bits.shape == (24,)
    assert (bits >= 0).all()
    assert bits.argmax() == 12 - 6
    assert bits.max() <= 1
    of_all = posterior.bits_about(differences[6:30], differences.thinned(8))
    assert of_all.max() < bits.max(), "one answer says less of many pairs than of itself"
    np.testing.assert_array_equal(of_all, posterior.bits_about(differences[6:30], differences.thinned(8)))
    assert len(differences.thinned(8)) == 8


def test_measures_have_names_and_are_numbers(study_queries: QuerySet) -> None:
    trajectories = [query.trajectory_a for query in study_queries.queries[:20]]
    values = named_measures(trajectories)
    assert values.shape == (20, len(NAMES))
    assert np.isfinite(values).all()
    personal = values[:, NAMES.index("personal_space_time")]
    assert ((personal > 0) == (values[:, NAMES.index("nearest_person")] < 1.2)).all()


def test_answers_and_pairs_have_to_agree(differences: PairDifferences) -> None:
    with pytest.raises(LearningError, match="3 pairs"):
        FreePosterior.from_answers(differences[:3], [True])
