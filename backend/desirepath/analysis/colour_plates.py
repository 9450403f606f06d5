"""Discs of dots in which a digit differs from its ground by one kind of cone alone (all ours). No diagnostic:
colours of a screen are not calibrated, and nobody validated these plates.

A colour is one vector of what the three cones get (L, M, S). Figure and ground differ in L (`protan`) or M (`deutan`)
alone, so that an eye without these cones sees one colour; every dot is lighter or darker by lot, so that light tells
nothing. The digit of a `control` is darker, which every eye sees.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Confusion = Literal["control", "protan", "deutan"]
Dot = tuple[float, float, float, str]
"""x, y and radius in a square of 100, and a colour."""
Array = NDArray[np.float64]

# Smith and Pokorny's cones over linear sRGB, as Vienot, Brettel and Mollon (1999) give them
CONES = np.array(
    [[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]], dtype=np.float64
)
_BASE = np.array([0.36, 0.30, 0.13])  # linear sRGB: an olive from which both directions have room
_AWAY = {"protan": (0, 2.8), "deutan": (1, 1.75)}  # which cone, and how far figure and ground lie from the base
_DARKEST, _LIGHTEST = 0.7, 1.3  # of a dot's light
_DOTS, _TRIES, _GAP = 420, 20_000, 0.35
_DIGITS = {
    "2": ("01110", "10001", "00001", "00110", "01000", "10000", "11111"),
    "3": ("11110", "00001", "00001", "01110", "00001", "00001", "11110"),
    "5": ("11111", "10000", "11110", "00001", "00001", "10001", "01110"),
    "6": ("01110", "10000", "10000", "11110", "10001", "10001", "01110"),
    "8": ("01110", "10001", "10001", "01110", "10001", "10001", "01110"),
    "9": ("01110", "10001", "10001", "01111", "00001", "00001", "01110"),
}
DIGITS = tuple(_DIGITS)


def figure_and_ground(of: Confusion) -> tuple[Array, Array]:
    """Their colours in linear sRGB, before a dot's own light."""
    if of == "control":
        return 0.25 * _BASE, _BASE
    cone, far = _AWAY[of]
    away = far * np.linalg.inv(CONES)[:, cone]
    return _BASE + away, _BASE - away


@lru_cache(maxsize=32)
def colour_plate(shows: str, of: Confusion) -> tuple[Dot, ...]:
    """The dots of the plate that shows this digit, the same each time."""
    random = np.random.default_rng([int(shows), *map(ord, of)])
    figure, ground = figure_and_ground(of)
    placed = np.empty((0, 3))
    dots: list[Dot] = []
    for _ in range(_TRIES):
        angle, far, radius = 2 * np.pi * random.random(), 47 * np.sqrt(random.random()), 1.4 + 1.4 * random.random()
        x, y = 50 + far * np.cos(angle), 50 + far * np.sin(angle)
        if len(placed) and (np.hypot(placed[:, 0] - x, placed[:, 1] - y) < placed[:, 2] + radius + _GAP).any():
            continue
        placed = np.vstack([placed, (x, y, radius)])
        light = random.uniform(_DARKEST, _LIGHTEST)
        colour = (figure if _is_figure(x, y, shows) else ground) * light
        dots.append((round(x, 1), round(y, 1), round(radius, 1), _hex(colour)))
        if len(dots) == _DOTS:
            break
    return tuple(dots)


def _is_figure(x: float, y: float, shows: str) -> bool:
    column, row = int((x - 26) // 9.6), int((y - 16) // 9.7)
    return 0 <= column < 5 and 0 <= row < 7 and _DIGITS[shows][row][column] == "1"


def _hex(linear: Array) -> str:
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(float(part) * 255):02x}" for part in np.clip(shown, 0, 1))
