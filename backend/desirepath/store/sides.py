"""The two sides of a pair, and which trajectory a side names. Which trajectory is shown on which side is the plan's."""

from __future__ import annotations

from typing import Literal, TypeGuard

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
