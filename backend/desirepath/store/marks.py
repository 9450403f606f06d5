"""The moments that a stored answer marks in a trajectory: what they may be, and reading them of what was stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

Why = Literal["too_close", "too_fast", "in_my_way", "wrong_side", "jerky", "detour", "good"]
WHYS: tuple[Why, ...] = get_args(Why)
GOOD: Why = "good"
MOST_MARKS = 20


@dataclass(frozen=True)
class Mark:
    """at_s: from the robot's first move to the tap; why: None where nobody said."""

    at_s: float
    why: Why | None

    @property
    def better(self) -> bool:
        """Whether it is good there; else something is not right."""
        return self.why == GOOD


def marks_in(value: Mapping[str, Any]) -> tuple[Mark, ...] | None:
    """In the order of time; None where it is no answer of that kind: what was imported may say anything."""
    given = value.get("marks")
    if not isinstance(given, list) or len(given) > MOST_MARKS or not all(isinstance(one, dict) for one in given):
        return None
    if not all(_is_time(one.get("at_s")) and one.get("why") in (None, *WHYS) for one in given):
        return None
    return tuple(sorted((Mark(float(one["at_s"]), one.get("why")) for one in given), key=lambda mark: mark.at_s))


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value >= 0
