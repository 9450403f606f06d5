"""Small solids from numpy: boxes, turned bodies, limbs, with colours and light already on their vertices.

Nothing here knows a scene, a robot or viser. Light is baked, because one unlit draw call per thing is what keeps
software WebGL quick and makes all views show the same materials.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Colour = tuple[int, int, int]
Point = tuple[float, float, float]

_SUN = np.array([-0.42, -0.34, 0.84], np.float32)  # from the light to us reversed: where the light stands
_CONTACT_M = 0.22  # below this height things darken towards the floor


@dataclass(frozen=True)
class Shape:
    """Triangles with one colour per vertex.

    positions, normals: (N, 3) float32, metres. colours: (N, 4) float32, sRGB and alpha in [0, 1]. faces: (M, 3) uint32.
    """

    positions: Floats
    normals: Floats
    colours: Floats
    faces: NDArray[np.uint32]

    def moved(self, x: float = 0.0, y: float = 0.0, *, yaw: float = 0.0) -> Shape:
        """The same shape turned by `yaw` (rad) about z, then shifted by (x, y) metres."""
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
        shift = np.array([x, y, 0.0], np.float32)
        return replace(self, positions=self.positions @ turn.T + shift, normals=self.normals @ turn.T)

    def lit(self, *, turning: bool = False) -> Shape:
        """Colours under one soft light with darker feet.

        turning: for things that rotate while they are watched; leaves out the light's direction about z.
        """
        up = self.normals[:, 2] * 0.5 + 0.5
        light = 0.70 + 0.30 * up
        if not turning:
            light = 0.76 + 0.15 * up + 0.12 * np.clip(self.normals @ _SUN, 0.0, 1.0)
        near_floor = np.clip(self.positions[:, 2] / _CONTACT_M, 0.0, 1.0)
        light = light * (0.80 + 0.20 * near_floor)
        colours = self.colours.copy()
        # What the light misses turns a little warmer, not grey: the floor throws its colour back.
        colours[:, :3] = np.clip(colours[:, :3] * light[:, None] ** np.array([0.82, 1.0, 1.22]), 0.0, 1.0)
        return replace(self, colours=colours)


def merge(shapes: Iterable[Shape]) -> Shape:
    """All shapes as one, for one draw call."""
    parts = list(shapes)
    offsets = np.cumsum([0] + [len(part.positions) for part in parts[:-1]])
    return Shape(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.colours for part in parts]),
        np.concatenate([part.faces + np.uint32(offset) for part, offset in zip(parts, offsets, strict=True)]),
    )


def _coloured(
    positions: NDArray[Any], normals: NDArray[Any], faces: NDArray[Any], colour: Colour, alpha: float
) -> Shape:
    colours = np.empty((len(positions), 4), np.float32)
    colours[:, :3] = np.asarray(colour, np.float32) / 255.0
    colours[:, 3] = alpha
    return Shape(positions.astype(np.float32), normals.astype(np.float32), colours, faces.astype(np.uint32))


def box(size: Point, centre: Point, colour: Colour) -> Shape:
    """An upright box of full `size` (m) about `centre` (m), flat faces."""
    positions, normals, faces = _unit_box()
    corners = (positions * np.asarray(size) / 2 + np.asarray(centre)).astype(np.float32)
    return _coloured(corners, normals, faces, colour, 1.0)


@cache
def _unit_box() -> tuple[Floats, Floats, NDArray[np.uint32]]:
    """Corners at +-1, four for every face, their normals, and the triangles."""
    positions: list[NDArray[np.float64]] = []
    normals: list[NDArray[np.float64]] = []
    faces: list[list[int]] = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for sign in (-1.0, 1.0):
            normal = np.eye(3)[axis] * sign
            first = len(positions)
            positions += [normal + a * u * sign + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            normals += [normal] * 4
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return np.asarray(positions, np.float32), np.asarray(normals, np.float32), np.asarray(faces, np.uint32)


def rotate(
    profile: Sequence[tuple[float, float]],
    colour: Colour,
    *,
    segments: int = 24,
    smooth: bool = False,
    start: float = 0.0,
    stop: float = 2 * math.pi,
    alpha: float = 1.0,
) -> Shape:
    """A body turned about z from (radius, height) points (m) that run from bottom to top on the outside.

    smooth: round the edges between profile points (for balls and limbs). start, stop: the arc in radians.
    """
    points = np.asarray(profile, np.float32)
    steps = np.diff(points, axis=0)
    outward = np.stack([steps[:, 1], -steps[:, 0]], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    at_points = np.concatenate([outward[:1], outward[:-1] + outward[1:], outward[-1:]])
    at_points /= np.maximum(np.linalg.norm(at_points, axis=1, keepdims=True), 1e-9)
    angles = np.linspace(start, stop, segments + 1)
    cos, sin = np.cos(angles), np.sin(angles)
    positions, normals, faces, first = [], [], [], 0
    row = np.arange(segments)
    for i in range(len(steps)):
        for j in (i, i + 1):
            radius, height = points[j]
            across, up = at_points[j] if smooth else outward[i]
            positions.append(np.stack([radius * cos, radius * sin, np.full_like(cos, height)], axis=1))
            normals.append(np.stack([across * cos, across * sin, np.full_like(cos, up)], axis=1))
        low, high = first + row, first + segments + 1 + row
        faces += [np.stack([low, low + 1, high + 1], axis=1), np.stack([low, high + 1, high], axis=1)]
        first += 2 * (segments + 1)
    return _coloured(np.concatenate(positions), np.concatenate(normals), np.concatenate(faces), colour, alpha)


def ball(centre: Point, radii: Point, colour: Colour, *, segments: int = 18, rings: int = 10) -> Shape:
    """An ellipsoid about `centre` with half axes `radii`, metres."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, rings + 1)
    unit = rotate([(math.cos(a), math.sin(a)) for a in angles], colour, segments=segments, smooth=True)
    scale = np.asarray(radii, np.float32)
    normals = unit.normals / scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(unit, positions=unit.positions * scale + np.asarray(centre, np.float32), normals=normals)


def limb(a: Point, b: Point, radius_a: float, radius_b: float, colour: Colour, *, segments: int = 12) -> Shape:
    """A rounded, tapering rod from `a` to `b`, metres."""
    start, end = np.asarray(a, np.float32), np.asarray(b, np.float32)
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    caps = np.linspace(0, math.pi / 2, 5)
    profile = [(radius_a * math.sin(t), -radius_a * math.cos(t)) for t in caps]
    profile += [(radius_b * math.cos(t), length + radius_b * math.sin(t)) for t in caps]
    rod = rotate(profile, colour, segments=segments, smooth=True)
    helper = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.9 else np.array([0, 1.0, 0])
    side = np.cross(helper, axis)
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis], axis=1).astype(np.float32)
    return replace(rod, positions=rod.positions @ frame.T + start, normals=rod.normals @ frame.T)


def disc(radius: float, height: float, colour: Colour, *, alpha: float, rim_alpha: float, segments: int = 40) -> Shape:
    """A flat disc at `height` (m) whose alpha runs from `alpha` in the middle to `rim_alpha` at the edge."""
    angles = np.linspace(0, 2 * math.pi, segments, endpoint=False)
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(segments, height)], axis=1)
    positions = np.concatenate([[[0.0, 0.0, height]], rim])
    normals = np.tile([0.0, 0.0, 1.0], (segments + 1, 1))
    row = np.arange(segments)
    faces = np.stack([np.zeros(segments, int), row + 1, (row + 1) % segments + 1], axis=1)
    flat = _coloured(positions, normals, faces, colour, rim_alpha)
    flat.colours[0, 3] = alpha
    return flat


def flat(corners: Sequence[tuple[float, float]], height: float, colour: Colour, *, alpha: float = 1.0) -> Shape:
    """A convex polygon at `height` (m) facing up; corners (x, y) counter-clockwise."""
    count = len(corners)
    positions = np.array([(x, y, height) for x, y in corners])
    row = np.arange(1, count - 1)
    faces = np.stack([np.zeros(count - 2, int), row, row + 1], axis=1)
    return _coloured(positions, np.tile([0.0, 0.0, 1.0], (count, 1)), faces, colour, alpha)


def quads(corners: NDArray[np.float64], normals: NDArray[np.float64], colour: Colour) -> Shape:
    """Flat faces (n, 4, 3), counter-clockwise from where their normals (n, 3) point, m."""
    first = 4 * np.arange(len(corners))[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    return _coloured(corners.reshape(-1, 3), np.repeat(normals, 4, axis=0), faces, colour, 1.0)


def prism(outline: NDArray[np.float64], low: float, high: float, colour: Colour) -> Shape:
    """A polygon (n, 2), counter-clockwise, m, raised from one height to another, with its lid."""
    count, ends = len(outline), np.roll(outline, -1, axis=0)
    along = ends - outline
    outward = np.stack([along[:, 1], -along[:, 0], np.zeros(count)], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    heights = np.broadcast_to([[low], [low], [high], [high]], (count, 4, 1))
    upright = np.concatenate([np.stack([outline, ends, ends, outline], axis=1), heights], axis=2)
    above = np.column_stack([outline, np.full(count, high)])
    lid = _coloured(above, np.tile([0.0, 0.0, 1.0], (count, 1)), np.array(_triangles(outline)), colour, 1.0)
    return merge([quads(upright, outward, colour), lid])


def _triangles(outline: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """A polygon (n, 2), counter-clockwise, cut into n - 2 triangles by taking off one ear after another."""
    left, found = list(range(len(outline))), []
    points = [(float(x), float(y)) for x, y in outline]

    def turn(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = points[a], points[b], points[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    def is_ear(a: int, b: int, c: int) -> bool:
        others = [p for p in left if p not in (a, b, c)]
        return turn(a, b, c) > 0 and not any(min(turn(a, b, p), turn(b, c, p), turn(c, a, p)) >= 0 for p in others)

    while len(left) > 3:
        corners = [(left[n - 1], left[n], left[(n + 1) % len(left)]) for n in range(len(left))]
        ear = next((corner for corner in corners if is_ear(*corner)), corners[0])
        found.append(ear)
        left.remove(ear[1])
    return [*found, (left[0], left[1], left[2])]
