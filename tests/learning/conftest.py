"""Small real parts that several learning tests share: a shortly trained policy, a few queries and their answers."""

from __future__ import annotations

import pytest

from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.td3.base import BaseConfig, BaseResult, train_base

TINY_BASE = BaseConfig(
    setup="open_field",
    seed=3,
    updates=180,
    smoothing_updates=60,
    n_envs=32,
    random_transitions=512,
    buffer_size=20_000,
    checkpoints=2,
    selection_scenes=20,
)


@pytest.fixture(scope="session")
def tiny_config() -> BaseConfig:
    return TINY_BASE


@pytest.fixture(scope="session")
def tiny_base() -> BaseResult:
    """A base policy after two hundred updates: real, and still bad."""
    return train_base(TINY_BASE)


@pytest.fixture(scope="session")
def study_queries() -> QuerySet:
    whole = load_queries("study_room/queries_500")
    return QuerySet(whole.setup, whole.queries[:200], whole.filtered)


@pytest.fixture(scope="session")
def distance_answers(study_queries: QuerySet) -> list[Preference]:
    """What somebody who wants the robot far away answers to all shipped queries."""
    return make_oracle("min-human-distance").answer(study_queries.queries)
