"""Floor materials and shadows, drawn with numpy: wood, concrete, and the soft dark around whatever stands on them.

Pictures only; where they lie is decided in `scene_nodes.py`.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.scene import Obstacle
from desirepath_stage.shapes import Colour

TILE_M = 4.0  # side of one floor tile before it repeats; a multiple of the 1 m grid
_PIXELS_PER_M = 96
_PLANKS_PER_TILE = 25  # 16 cm boards
_SHADOW_PIXELS_PER_M = 20
_SHADOW_REACH_M = 1.0  # further from a solid its shadow takes less than a tenth of one of 255 grey levels

Material = Literal["wood", "concrete", "linoleum"]
MIDDLE: dict[Material, Colour] = {"wood": (216, 188, 154), "concrete": (208, 202, 192), "linoleum": (203, 204, 198)}
Image2D = NDArray[np.float32]


def _noise(rng: np.random.Generator, rows: int, columns: int, size: int) -> Image2D:
    """Smooth periodic noise in [-1, 1] of `size` x `size` pixels from a coarse grid, tileable."""
    from PIL import Image  # a tenth of a second that a restart need not wait

    coarse = rng.uniform(-1, 1, (rows, columns)).astype(np.float32)
    padded = np.pad(coarse, ((2, 2), (2, 2)), mode="wrap")
    picture = Image.fromarray(padded).resize(
        ((columns + 4) * size // columns, (rows + 4) * size // rows), Image.Resampling.BICUBIC
    )
    top, left = 2 * size // rows, 2 * size // columns
    noise: Image2D = np.array(picture, np.float32)[top : top + size, left : left + size]
    return noise


def _grid_lines(size: int, strength: float) -> Image2D:
    """A faint line every metre: 0 off the lines, -strength on them."""
    across = np.arange(size) % _PIXELS_PER_M
    line = (across < 1).astype(np.float32) * -strength
    grid: Image2D = np.minimum(line[:, None], line[None, :])
    return grid


def to_jpeg(picture: NDArray[Any], quality: int = 88) -> bytes:
    """picture: (rows, columns, 3), 0 to 255."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(out, "JPEG", quality=quality)
    return out.getvalue()


@cache
def _wood() -> Image2D:
    """(384, 384, 3) oak boards along x, 4 x 4 m, tileable, with a faint 1 m grid; 0 to 255."""
    size = int(TILE_M * _PIXELS_PER_M)
    rng = np.random.default_rng(20)
    board_of_row = np.arange(size) * _PLANKS_PER_TILE // size
    tone = np.zeros((size, size), np.float32)
    gap = np.zeros((size, size), np.float32)
    columns = np.arange(size)
    for board in range(_PLANKS_PER_TILE):
        rows = board_of_row == board
        shift = int(rng.integers(size))
        ends = (shift + np.array([0, int(size * rng.uniform(0.38, 0.62))])) % size
        which = (((columns - ends[0]) % size) >= ((ends[1] - ends[0]) % size)).astype(int)
        tone[rows] = rng.uniform(-1, 1, 2).astype(np.float32)[which]
        for end in ends:
            gap[rows, end % size] = 1.0
    first_row = np.flatnonzero(np.diff(board_of_row, prepend=-1))
    gap[first_row] = 1.0
    grain = 0.65 * _noise(rng, 192, 8, size) + 0.35 * _noise(rng, 384, 16, size)
    light = 1.0 + 0.036 * tone + 0.026 * grain - 0.15 * gap + _grid_lines(size, 0.10)
    warmth = np.stack([1.0 + 0.006 * tone, np.ones_like(tone), 1.0 - 0.02 * tone], axis=-1)
    picture: Image2D = (np.array(MIDDLE["wood"], np.float32) * light[..., None] * warmth).astype(np.float32)
    return picture


@cache
def _slab(material: Material) -> Image2D:
    """(384, 384, 3) matte concrete, or linoleum without its clouds, 4 x 4 m, tileable, with a faint 1 m grid of joints;
    0 to 255."""
    size = int(TILE_M * _PIXELS_PER_M)
    rng = np.random.default_rng(21)
    cloud = 0.6 * _noise(rng, 4, 4, size) + 0.4 * _noise(rng, 16, 16, size)
    speck = _noise(rng, 192, 192, size)
    clouds = 0.022 if material == "concrete" else 0.0
    light = 1.0 + clouds * cloud + 0.016 * speck + _grid_lines(size, 0.12)
    slab: Image2D = (np.array(MIDDLE[material], np.float32) * light[..., None]).astype(np.float32)
    return slab


@cache
def tile(material: Material) -> bytes:
    """JPEG of 4 x 4 m of it, tileable, its lower left corner on a whole multiple of 4 m."""
    return to_jpeg(_drawn(material))


def _drawn(material: Material) -> Image2D:
    return _wood() if material == "wood" else _slab(material)


def floor(material: Material, solids: Sequence[Obstacle], bounds: tuple[float, float, float, float]) -> bytes:
    """JPEG of the floor over `bounds` (x_min, y_min, x_max, y_max in metres), shadows included. Row 0 is y_max.

    One opaque picture, because a second, blended layer over the whole floor costs software rendering as much again.
    """
    from PIL import Image

    x_min, y_min, x_max, y_max = bounds
    drawn = _drawn(material)
    columns, rows = (max(8, round(side * _PIXELS_PER_M)) for side in (x_max - x_min, y_max - y_min))
    x = x_min + (np.arange(columns) + 0.5) * (x_max - x_min) / columns  # the middles of the pixels
    y = y_max - (np.arange(rows) + 0.5) * (y_max - y_min) / rows
    across = (np.floor(x * _PIXELS_PER_M).astype(int)) % drawn.shape[1]
    down = (np.floor(-y * _PIXELS_PER_M).astype(int)) % drawn.shape[0]
    # Shadow takes blue first, so that it stays warm.
    light = _light_left(solids, bounds)[..., None] ** np.array([0.94, 1.0, 1.06], np.float32)
    picture = drawn.take(down, axis=0).take(across, axis=1)
    for channel in range(3):
        coarse = Image.fromarray(np.ascontiguousarray(light[..., channel]))
        picture[..., channel] *= np.asarray(coarse.resize((columns, rows), Image.Resampling.BILINEAR))
    return to_jpeg(picture)


def _light_left(solids: Sequence[Obstacle], bounds: tuple[float, float, float, float]) -> Image2D:
    """How much light reaches the floor, 0 to 1, on a coarse grid over `bounds`, row 0 at y_max.

    A tight dark edge around every footprint, and a soft longer one away from the light (the same light that
    `shapes.Shape.lit` bakes).
    """
    x_min, y_min, x_max, y_max = bounds
    columns, rows = (max(8, round(side * _SHADOW_PIXELS_PER_M)) for side in (x_max - x_min, y_max - y_min))
    x, y = np.meshgrid(
        np.linspace(x_min, x_max, columns, dtype=np.float32), np.linspace(y_max, y_min, rows, dtype=np.float32)
    )
    light_left, at_walls = np.ones_like(x), np.ones_like(x)
    for solid in solids:
        near = _rows_and_columns_near(solid, x, y)
        here_x, here_y = x[near], y[near]
        left = 1.0 - 0.40 * np.exp(-solid.distance_m(here_x, here_y) / 0.10)
        if solid.kind == "wall":  # they stand around everything, often in pieces: theirs is only the dark edge, once
            at_walls[near] = np.minimum(at_walls[near], left)
        else:
            reach = min(0.55 * solid.height, 0.6)
            cast = np.zeros_like(here_x)
            for step in (0.25, 0.5, 0.75, 1.0):
                gone = reach * step
                distance = solid.distance_m(here_x - np.float32(0.78 * gone), here_y - np.float32(0.63 * gone))
                cast += np.exp(-((distance / (0.05 + 0.10 * step)) ** 2)) * (1.1 - step)
            left *= 1.0 - 0.16 * np.minimum(cast, 1.5)
            light_left[near] *= left
    light: Image2D = np.clip(light_left * at_walls, 0.3, 1.0).astype(np.float32)
    return light


def _rows_and_columns_near(solid: Obstacle, x: Image2D, y: Image2D) -> tuple[slice, slice]:
    """The part of a grid (from `np.meshgrid`, y falling) in which the solid's shadow can be seen."""
    c, s = abs(math.cos(solid.pose.yaw)), abs(math.sin(solid.pose.yaw))
    half_x = (c * solid.length + s * solid.width) / 2 + _SHADOW_REACH_M
    half_y = (s * solid.length + c * solid.width) / 2 + _SHADOW_REACH_M
    columns = np.searchsorted(x[0], [solid.pose.x - half_x, solid.pose.x + half_x])
    rows = np.searchsorted(-y[:, 0], [-solid.pose.y - half_y, -solid.pose.y + half_y])
    return slice(*rows), slice(*columns)
