"""Who codes an open question as whom, also after an erasure took all codings of one coder with it."""

from __future__ import annotations

import pytest

from desirepath.study.coding import role_for


@pytest.mark.parametrize(
    ("coders", "name", "role"),
    [
        ({}, "ada", "first"),
        ({"first": "ada"}, "ada", "first"),
        ({"first": "ada"}, "bo", "second"),
        ({"first": "ada", "second": "bo"}, "cy", None),
        ({"second": "bo"}, "bo", "second"),  # never both: bo would agree with bo
        ({"second": "bo"}, "cy", "first"),
    ],
)
def test_nobody_codes_an_answer_twice(coders: dict[str, str], name: str, role: str | None) -> None:
    assert role_for(coders, name) == role
