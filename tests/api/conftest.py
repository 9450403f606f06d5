"""Fixtures that tests of this room share; they are made in `lab_house.py` and `participant_house.py`."""

from tests.api.lab_house import as_role, lab, lab_house, new_house, visitor, walked, walked_house
from tests.api.participant_house import client, furnished, house, link, token

__all__ = [
    "as_role",
    "client",
    "furnished",
    "house",
    "lab",
    "lab_house",
    "link",
    "new_house",
    "token",
    "visitor",
    "walked",
    "walked_house",
]
