"""Oracles: each answers by its preference, and strays from it only as its response model says."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.measures import MEASURES, measures
from desirepath.learning.preferences.objectives import NAMES, OBJECTIVES
from desirepath.learning.preferences.oracles import HELD_OUT, ORACLE_PREFERENCES, TUNING, make_oracle
from desirepath.learning.preferences.spans import beginning
from desirepath.learning.queries.queries import Query, QuerySet


@pytest.fixture(scope="module")
def some(study_queries: QuerySet) -> tuple[Query, ...]:
    return study_queries.queries[:80]


def test_tuning_and_held_out_tastes_are_kept_apart() -> None:
    assert len(TUNING) >= 8
    assert not set(TUNING) & set(HELD_OUT)
    assert {"min-human-distance", "shortest"} <= set(TUNING)
    assert {name for preference in ORACLE_PREFERENCES.values() for name in preference.objectives} == set(NAMES)


@pytest.mark.parametrize("name", [name for name, one in ORACLE_PREFERENCES.items() if len(one.objectives) == 1])
def test_a_single_taste_chooses_more_of_its_measure(some: tuple[Query, ...], name: str) -> None:
    objective = next(o for o in OBJECTIVES if o.name == ORACLE_PREFERENCES[name].objectives[0])
    for answer in make_oracle(name).answer(some):
        chosen, rejected = measures([answer.chosen, answer.rejected])[:, objective.measure] * objective.sign
        assert chosen >= rejected


def test_keep_away_else_short(some: tuple[Query, ...]) -> None:
    distance, length = MEASURES.index("min_human_distance_m"), MEASURES.index("path_length_m")
    for answer in make_oracle("keep-away-else-short").answer(some):
        chosen, rejected = measures([answer.chosen, answer.rejected])
        if chosen[distance] >= 1.5 and rejected[distance] >= 1.5:
            assert chosen[length] <= rejected[length]
        else:
            assert chosen[distance] >= min(rejected[distance], 1.5)


def test_small_differences_are_answered_by_a_coin(some: tuple[Query, ...]) -> None:
    blind = [make_oracle("shortest", indifference=1e6, seed=k).choices(some) for k in range(2)]
    assert blind[0] != blind[1]
    assert 0.3 < np.mean(blind) < 0.7
    clear, sure = (make_oracle("shortest", indifference=i, seed=3) for i in (0.5, 0.0))
    agree = np.mean(np.equal(clear.choices(some), sure.choices(some)))
    assert 0.5 < agree < 1.0


def test_a_myopic_oracle_judges_the_beginning_only(some: tuple[Query, ...]) -> None:
    query = some[0]
    cut = beginning(query.trajectory_a, 1.0)
    assert len(cut.actions) == 5
    assert len(cut.poses) == 6
    assert np.array_equal(cut.poses, query.trajectory_a.poses[:6])
    assert beginning(query.trajectory_a, 1e3) is query.trajectory_a
    assert make_oracle("smoothest", myopia_s=1e3).choices(some) == make_oracle("smoothest").choices(some)
    assert make_oracle("smoothest", myopia_s=1.0).choices(some) != make_oracle("smoothest").choices(some)


def test_impossible_response_models_are_refused() -> None:
    with pytest.raises(LearningError, match="indifference"):
        make_oracle("shortest", indifference=-1)
    with pytest.raises(LearningError, match="myopia"):
        make_oracle("shortest", myopia_s=0)
