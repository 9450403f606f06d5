"""Fixtures that tests of this room share; they are made in `analyst_`, `lab_` and `participant_services.py`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from argon2 import PasswordHasher

from desirepath.web.core import auth
from tests.packed_once import packed_once
from tests.web.analyst_services import worked_data
from tests.web.lab_services import (
    as_role,
    colleague,
    fresh_data,
    lab,
    lab_services,
    two_studies,
    two_studies_data,
    visitor,
    walked,
    walked_services,
)
from tests.web.participant_services import client, furnished, link, services, token
from tests.web.robot_services import robot_data, robot_lab, turtle

__all__ = [
    "as_role",
    "client",
    "colleague",
    "fresh_data",
    "furnished",
    "lab",
    "lab_services",
    "link",
    "packed_once",
    "robot_data",
    "robot_lab",
    "services",
    "token",
    "turtle",
    "two_studies",
    "two_studies_data",
    "visitor",
    "walked",
    "walked_services",
    "worked_data",
]


@pytest.fixture(scope="package", autouse=True)
def cheap_passwords() -> Iterator[PasswordHasher]:
    """Real argon2id at the least cost: hundreds of tests sign in, a fifth of a second of a core each. Yields the
    product's own hasher, which servers in processes of their own use, too."""
    of_the_product = auth._hasher
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(auth, "_hasher", PasswordHasher(time_cost=1, memory_cost=8, parallelism=1))
        yield of_the_product
