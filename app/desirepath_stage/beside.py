"""Paths that lie on the floor beside what moves on a replay, for analysts. Drawing them is `scene_nodes.py`'s."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Beside:
    """Paths under one name in the legend. colour: red, green, blue, 0 to 255. paths: (n, 2 or more) each, metres."""

    name: str
    colour: tuple[int, int, int]
    paths: Sequence[ArrayLike]
