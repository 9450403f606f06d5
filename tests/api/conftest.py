"""Fixtures that the tests of the signed-in pages share; they are made in `lab_house.py`."""

from tests.api.lab_house import lab, lab_house, new_house, visitor, walked, walked_house

__all__ = ["lab", "lab_house", "new_house", "visitor", "walked", "walked_house"]
