"""What a robot can be said to have done otherwise than the usual one: codes, without what finds them
(`choice_reasons.py`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Did = Literal[
    "as_usual",
    "farther",
    "closer",
    "on_its_left",
    "on_its_right",
    "clearer",
    "tighter",
    "longer",
    "shorter",
    "curvier",
    "straighter",
    "faster_near",
    "slower_near",
    "later",
    "sooner",
    "in_front",
    "beside",
    "behind",
]
MORE_OR_LESS: tuple[tuple[Did, Did], ...] = (
    ("farther", "closer"),
    ("on_its_left", "on_its_right"),
    ("clearer", "tighter"),
    ("longer", "shorter"),
    ("curvier", "straighter"),
    ("faster_near", "slower_near"),
    ("later", "sooner"),
)
"""What more and less is called of each of `preferences.measures.MEASURES`."""
TOLD = 2  # reasons; more nobody keeps in mind


@dataclass(frozen=True)
class Reason:
    """did: what the own robot did. own, usual: the measure of both, in its unit; None where it is no amount."""

    did: Did
    own: float | None = None
    usual: float | None = None
