"""The body of a piece of furniture for its outline: what of it is seen from afar, without handles, gaps and legs.

A stack of prisms, each around whatever stands at its height. How far they stick out at each moment is the page's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from desirepath_stage.shapes import Colour, Shape

Points = NDArray[np.float64]

SAME_M = 0.015  # prisms that differ by less are one: no line between a body and its lid
SLICE_M = 0.012  # a thinner layer is none
FILLED = 0.35  # a layer that fills less of its outline is legs
STEEPEST = 1.8  # a corner is moved outwards by no more than this many thicknesses


@dataclass(frozen=True)
class _Prism:
    """A convex polygon (n, 2) on the floor from one height to another, metres."""

    polygon: Points
    low: float
    high: float

    def looks_like(self, other: _Prism) -> bool:
        """Whether both stand on about the same ground."""
        mine, its = (np.concatenate([prism.polygon.min(0), prism.polygon.max(0)]) for prism in (self, other))
        return float(np.abs(mine - its).max()) < SAME_M


def body(shape: Shape, colour: Colour) -> Shape:
    """The outline's corners and triangles. normals: the way outwards of each corner; a step of 1 along it takes each of
    the corner's faces 1 outwards.
    """
    corners: list[Points] = []
    outwards: list[Points] = []
    faces: list[NDArray[np.int64]] = []
    first = 0
    for prism in _prisms(shape):
        n = len(prism.polygon)
        floor = np.column_stack([prism.polygon, np.full(n, prism.low)])
        lid = np.column_stack([prism.polygon, np.full(n, prism.high)])
        aside = _outwards(prism.polygon)
        corners += [floor, lid]
        outwards += [np.column_stack([aside, np.full(n, -1.0)]), np.column_stack([aside, np.full(n, 1.0)])]
        ring, following = np.arange(n), (np.arange(n) + 1) % n
        fan = np.arange(1, n - 1)
        faces += [
            first + np.stack([ring, following, n + following], 1),
            first + np.stack([ring, n + following, n + ring], 1),
            first + np.stack([np.zeros_like(fan), fan + 1, fan], 1),
            first + n + np.stack([np.zeros_like(fan), fan, fan + 1], 1),
        ]
        first += 2 * n
    colours = np.ones((first, 4), np.float32)
    colours[:, :3] = np.asarray(colour, np.float32) / 255
    return Shape(
        np.concatenate(corners).astype(np.float32),
        np.concatenate(outwards).astype(np.float32),
        colours,
        np.concatenate(faces).astype(np.uint32),
    )


def _prisms(shape: Shape) -> list[_Prism]:
    parts = _parts(shape)
    heights = sorted({round(float(height), 3) for part in parts for height in (part[:, 2].min(), part[:, 2].max())})
    prisms: list[_Prism] = []
    for low, high in pairwise(heights):
        if high - low < SLICE_M:
            continue
        there = [part[:, :2] for part in parts if part[:, 2].min() <= low + 0.002 and part[:, 2].max() >= high - 0.002]
        if not there:
            continue
        polygon = _convex(np.concatenate(there))
        if sum(_area(_convex(part)) for part in there) < FILLED * _area(polygon):
            continue
        prism = _Prism(polygon, low, high)
        if prisms and prism.looks_like(prisms[-1]) and low - prisms[-1].high < 2 * SLICE_M:
            larger = max(prisms[-1], prism, key=lambda of: _area(of.polygon))
            prisms[-1] = _Prism(larger.polygon, prisms[-1].low, high)
        else:
            prisms.append(prism)
    return prisms


def _parts(shape: Shape) -> list[Points]:
    """The corners of each connected part of the shape."""
    places, which = np.unique(np.round(shape.positions.astype(np.float64), 4), axis=0, return_inverse=True)
    root = np.arange(len(places))
    faces = which.reshape(-1)[shape.faces.astype(np.int64)]
    while True:  # every corner takes the smallest number in its triangles until nothing changes
        least = root[faces].min(axis=1)
        following = root.copy()
        for k in range(3):
            np.minimum.at(following, faces[:, k], least)
        if np.array_equal(following, root):
            break
        root = following
    return [places[root == label] for label in np.unique(root)]


def _convex(points: Points) -> Points:
    """The convex hull, counter-clockwise (Andrew's monotone chain)."""
    order = np.unique(points, axis=0)

    def chain(some: Points) -> list[Points]:
        kept: list[Points] = []
        for point in some:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 1e-9:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.asarray(chain(order) + chain(order[::-1]))


def _turn(a: Points, b: Points, c: Points) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _area(polygon: Points) -> float:
    x, y = polygon[:, 0], polygon[:, 1]
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) if len(polygon) > 2 else 0.0


def _outwards(polygon: Points) -> Points:
    """(n, 2) for every corner of a counter-clockwise polygon."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
    both = normals + np.roll(normals, 1, axis=0)
    ways: Points = both / (1 + (normals * np.roll(normals, 1, axis=0)).sum(axis=1, keepdims=True))
    longest = np.linalg.norm(ways, axis=1, keepdims=True)
    bounded: Points = ways * np.minimum(1.0, STEEPEST / np.maximum(longest, 1e-9))
    return bounded
