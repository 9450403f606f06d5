"""The two sides of a pair, and which trajectory a side names. Which trajectory is shown on which side is the plan's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeGuard

Side = Literal["a", "b"]
"""a is shown first, b second."""
SIDES: tuple[Side, Side] = ("a", "b")


def is_side(value: object) -> TypeGuard[Side]:
    return value in SIDES


def other_side(side: Side) -> Side:
    return "b" if side == "a" else "a"


def shown_on(side: Side, trajectory_a: str, trajectory_b: str) -> str:
    """The trajectory of a pair that is shown on that side."""
    return trajectory_a if side == "a" else trajectory_b


def chosen_and_rejected(choice: Side, trajectory_a: str, trajectory_b: str) -> tuple[str, str]:
    """The trajectories of a pair, the one that a choice names first."""
    return shown_on(choice, trajectory_a, trajectory_b), shown_on(other_side(choice), trajectory_a, trajectory_b)


def is_answer_to_several(value: Mapping[str, Any], count: int) -> bool:
    """Whether a stored answer puts so many trajectories, numbered from 1, in order or into piles, or picks the best;
    what was imported may say anything."""
    ask = value.get("ask")
    if ask not in ("order", "best", "groups"):
        return False
    field = "groups" if ask == "groups" else "order"
    if value.keys() & {"groups", "order"} != {field}:
        return False
    piles = value[field] if ask == "groups" else [value[field]]
    if not isinstance(piles, list) or not all(isinstance(pile, list) for pile in piles):
        return False
    said = [number for pile in piles for number in pile]
    if not all(type(number) is int for number in said):  # True is an int, too
        return False
    return len(said) == len(set(said)) == (1 if ask == "best" else count) and set(said) <= set(range(1, count + 1))


def is_tie(value: Mapping[str, Any]) -> bool:
    """Whether a stored answer to a pair says that the two do not differ."""
    return value.get("degree") == "no_difference" and not is_side(value.get("choice"))


def is_answer_to_pair(value: Mapping[str, Any]) -> bool:
    """Whether a stored answer says which of two, or that neither, in one of the ways that it says were possible; what
    was imported may say anything."""
    possible = value.get("possible", 2)
    if possible not in (2, 3, 4, 5):
        return False
    if is_tie(value):
        return bool(possible % 2)
    graded = value.get("degree") in ("slight", "clear") if possible >= 4 else value.get("degree") is None
    return is_side(value.get("choice")) and graded
