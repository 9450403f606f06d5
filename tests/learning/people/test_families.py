"""Simulated people outside the list: the card, what each family means, and that they answer like anybody else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.steps import SeenSteps, reference
from desirepath.learning.people.card import FAMILIES, member, members, parse_person, people_card, response_models
from desirepath.learning.people.families.changing import ChangingMember
from desirepath.learning.people.families.network import NetworkMember
from desirepath.learning.people.families.thresholds import ThresholdsMember
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.preferences.spans import moments, seen_in
from desirepath.learning.queries.queries import Query, QuerySet


@pytest.fixture(scope="module")
def some(study_queries: QuerySet) -> tuple[Query, ...]:
    return study_queries.queries[:80]


def test_two_families_are_held_out_by_name() -> None:
    card = people_card()
    assert set(card.held_out) == {"deep_network", "context"}
    assert set(card.families) == set(FAMILIES)
    assert set(card.tuning) | set(card.held_out) == set(FAMILIES)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("setup", ["study_room", "open_field"])
def test_a_member_is_the_same_every_time_and_differs_from_the_next(family: str, setup: str) -> None:
    trajectories = reference(setup).trajectories[:40]
    first, second = members(family, 2, setup).values()
    member.cache_clear()
    assert np.array_equal(member(f"{family}:0", setup).scores(trajectories), first.scores(trajectories))
    assert not np.array_equal(first.scores(trajectories), second.scores(trajectories))
    assert first.score(trajectories[3]) == pytest.approx(first.scores(trajectories)[3])


@pytest.mark.parametrize("family", ["network", "deep_network"])
def test_no_group_of_inputs_decides_alone(family: str) -> None:
    trajectories = reference("study_room").trajectories
    for number in range(5):
        drawn = member(f"{family}:{number}", "study_room")
        groups = frozenset(drawn.first if isinstance(drawn, NetworkMember) else drawn.scale)  # type: ignore[attr-defined]
        scores = drawn.scores(trajectories)
        for group in groups:
            alone = replace(drawn, muted=groups - {group}).scores(trajectories)  # type: ignore[type-var]
            agreement = np.mean((alone[0::2] > alone[1::2]) == (scores[0::2] > scores[1::2]))
            assert 0.15 <= agreement <= 0.85


def test_beyond_a_threshold_nothing_counts(some: tuple[Query, ...]) -> None:
    keeps_away = ThresholdsMember({"person_m": (1.2, 1.0)}, tie_breaker=0.0)
    trajectories = [one for query in some for one in (query.trajectory_a, query.trajectory_b)]
    steps = SeenSteps.of_trajectories(trajectories)
    nearest = steps.lowest(steps.words["person_m"])
    scores = keeps_away.scores(trajectories)
    assert (scores[nearest >= 1.2] == 0).all()
    assert (scores[nearest < 1.2] < 0).all()


def test_a_mind_changes_after_so_many_answers(some: tuple[Query, ...]) -> None:
    drawn = member("changing:1", "study_room")
    assert isinstance(drawn, ChangingMember)
    oracle = make_oracle("changing:1")
    before = [oracle.choose(query) for query in some[: drawn.change]]
    after = [oracle.choose(query) for query in some]
    assert before == oracle_of(drawn.at_first, some[: drawn.change])
    assert after == oracle_of(drawn.then, some)
    assert after != oracle_of(drawn.at_first, some)


def oracle_of(person: object, queries: tuple[Query, ...]) -> list[int]:
    a, b = (person.scores([getattr(q, side) for q in queries]) for side in ("trajectory_a", "trajectory_b"))  # type: ignore[attr-defined]
    return [int(x) for x in b > a]


def test_peak_and_end_are_judged_instead_of_the_whole(some: tuple[Query, ...]) -> None:
    pieces = moments(some[0].trajectory_a, 1.0)
    assert sum(len(piece.actions) for piece in pieces) == len(some[0].trajectory_a.actions)
    assert np.array_equal(pieces[1].poses[0], pieces[0].poses[-1])
    whole, remembered = make_oracle("network:1"), make_oracle("network:1", peak_end=True)
    agreement = np.mean(np.equal(whole.choices(some), remembered.choices(some)))
    assert 0.5 < agreement < 1.0


def test_every_response_model_of_the_card_answers(some: tuple[Query, ...]) -> None:
    for settings in response_models().values():
        for answer in make_oracle("deep_network:2", **settings).answer(some[:5]):
            assert answer.source == "oracle:deep_network:2"  # marked as simulated


def test_the_nine_objectives_cannot_say_what_a_network_prefers(study_queries: QuerySet) -> None:
    """What the families are for: the posterior over the nine says little of most of them."""
    queries = study_queries.queries
    differences = seen_in(queries)
    agreement = []
    for number in range(4):
        chosen = np.equal(make_oracle(f"network:{number}").choices(queries), 0)
        posterior = Posterior.from_answers("study_room", differences[:15], chosen[:15].tolist())
        predicted = posterior.sample(2_000).predict(differences[40:]) > 0.5
        agreement.append(np.mean(predicted == chosen[40:]))
    assert np.mean(agreement) < 0.8


@pytest.mark.parametrize("name", ["tallest", "network:x", "network:-1", "network:99999"])
def test_nobody_else_is_known(name: str) -> None:
    with pytest.raises(LearningError, match="network"):
        make_oracle(name)


def test_a_setup_without_preferences_is_refused() -> None:
    with pytest.raises(LearningError, match="study_room"):
        member("thresholds:0", "corridor").unit("corridor")
    assert parse_person("context") == ("context", 0)
