"""The texts in figures of scenes, in English; whoever draws for other people gives others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Words:
    """The texts in a figure."""

    x: str = "x (m)"
    y: str = "y (m)"
    start: str = "start"
    goal: str = "goal"
    person: str = "person, facing"
    traversals: str = "trajectories through a cell"
    heading_difference: str = "angle between headings (rad)"
    traversals_difference: str = "trajectories through a cell, B minus A"
    arrows: str = "headings of A (blue) and B (orange)"
    streams: str = "heading; thick: {fastest} m/s"


@dataclass(frozen=True)
class ExplanationWords:
    """The texts in the figure of an explanation; `things` by kind, as scenes name them."""

    x: str = "x (m)"
    y: str = "y (m)"
    time: str = "time (s)"
    score: str = "score (0-1)"
    speed: str = "speed (m/s), light line"
    turning: str = "turning (rad/s), light line"
    title: str = "{method} of {command}"
    things: Mapping[str, str] = field(default_factory=dict)

    def thing(self, name: str) -> str:
        """A thing's name in these words: its kind, then its number where it has one."""
        kind, _, number = name.rpartition(" ")
        kind, number = (kind, f" {number}") if number.isdigit() else (name, "")
        return self.things.get(kind, kind) + number


ENGLISH = Words()
ENGLISH_EXPLANATION = ExplanationWords()
