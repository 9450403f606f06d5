"""Simulated people outside the list: the card, what each family means, and that they answer like anybody else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.steps import SeenSteps, reference
from desirepath.learning.people.card import FAMILIES, member, members, parse_person, people_card, response_models
from desirepath.learning.people.families.changing import ChangingMember
from desirepath.learning.people.families.look import looks
from desirepath.learning.people.families.network import NetworkMember
from desirepath.learning.people.families.thresholds import ThresholdsMember
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.preferences.spans import moments, seen_in
from desirepath.learning.queries.queries import Query, QuerySet


@pytest.fixture(scope="module")
def some(study_queries: QuerySet) -> tuple[Query, ...]:
    return study_queries.queries[:80]


def test_five_families_are_kept_from_all_tuning_by_name() -> None:
    card = people_card()
    assert set(card.held_out) == {"deep_network", "context"}
    assert set(card.unseen) == {"saturated", "look", "last_third"}
    assert set(card.families) == set(FAMILIES)
    assert set(card.tuning) == set(FAMILIES) - set(card.held_out) - set(card.unseen)


def test_to_the_saturated_nearly_every_step_is_wholly_good_or_wholly_bad() -> None:
    steps = reference("study_room").steps
    sides = []
    for drawn in members("saturated", 6, "study_room").values():
        scores = drawn.step_scores(steps)  # type: ignore[attr-defined]
        assert np.mean(np.abs(scores) > 0.9) > 0.7
        sides.append(np.mean(scores > 0))
    assert min(sides) < 0.25
    assert max(sides) > 0.75


def test_a_look_is_of_the_path_alone() -> None:
    straight, detour = np.zeros((21, 3), dtype=np.float32), np.zeros((21, 3), dtype=np.float32)
    straight[:, 0] = detour[:, 0] = np.linspace(0, 4, 21)
    detour[:, 1] = np.where(detour[:, 0] < 2, np.sin(detour[:, 0] * np.pi / 2), 0)
    first = reference("study_room").trajectories[0]
    drawn = looks([replace(first, poses=straight), replace(first, poses=detour), replace(first, poses=detour[::-1])])
    assert drawn[0] == pytest.approx(np.zeros(4), abs=1e-6)
    assert (drawn[1] > 0.1).all()
    assert drawn[1] == pytest.approx(drawn[2], rel=0.05)  # to and fro it looks the same


def test_what_comes_before_the_last_third_counts_nothing() -> None:
    drive, other = reference("study_room").trajectories[:2]
    from_here = math.ceil((len(drive.actions) - 1) * 2 / 3)
    mixed = {
        name: np.concatenate([getattr(other, name)[:1].repeat(from_here, 0), getattr(drive, name)[from_here:]])
        for name in ("observations", "next_observations")
    }
    drawn = member("last_third:0", "study_room")
    assert drawn.score(replace(drive, **mixed)) == pytest.approx(drawn.score(drive))
    assert drawn.whole.score(replace(drive, **mixed)) != pytest.approx(drawn.whole.score(drive))  # type: ignore[attr-defined]


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
