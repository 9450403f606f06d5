"""Fixtures that tests of this room share; they are made in `analyst_`, `lab_` and `participant_services.py`."""

from tests.api.analyst_services import worked_data
from tests.api.lab_services import (
    as_role,
    colleague,
    fresh_data,
    lab,
    lab_services,
    two_studies,
    visitor,
    walked,
    walked_services,
)
from tests.api.participant_services import client, furnished, link, services, token

__all__ = [
    "as_role",
    "client",
    "colleague",
    "fresh_data",
    "furnished",
    "lab",
    "lab_services",
    "link",
    "services",
    "token",
    "two_studies",
    "visitor",
    "walked",
    "walked_services",
    "worked_data",
]
