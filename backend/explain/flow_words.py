"""The texts in the figures of `scene_plots.py`, in English; whoever draws for other people gives others."""

from __future__ import annotations

from dataclasses import dataclass


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


ENGLISH = Words()
