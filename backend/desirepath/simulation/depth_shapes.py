"""What a depth camera sees of furniture and people: boxes, cylinders and capsules inside what the robot collides with.

The sizes are those of the looks on the stage (`desirepath_stage/furniture.py`, `bodies.py`), without ornament.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.scene import Obstacle, Pose, Scene

Doubles = NDArray[np.float64]
TABLE_LEG_M, CHAIR_LEG_M = 0.07, 0.04


@dataclass(frozen=True)
class UprightBox:
    """A part of a piece in its frame: centre (x, y), sizes along and across, from height low to high; metres."""

    x: float
    y: float
    length: float
    width: float
    low: float
    high: float


@dataclass(frozen=True)
class UprightCylinder:
    """A round part of a piece in its frame, metres."""

    x: float
    y: float
    radius: float
    low: float
    high: float


Part = UprightBox | UprightCylinder


def _legs(length: float, width: float, inset: float, thick: float, high: float) -> list[Part]:
    return [
        UprightBox(a * (length / 2 - inset), b * (width / 2 - inset), thick, thick, 0.0, high)
        for a in (-1, 1)
        for b in (-1, 1)
    ]


def _table(length: float, width: float, height: float) -> list[Part]:
    top = 0.04
    return [
        UprightBox(0.0, 0.0, length, width, height - top, height),
        UprightBox(0.0, 0.0, length - 0.16, width - 0.16, height - top - 0.08, height - top),
        *_legs(length, width, 0.08, TABLE_LEG_M, height - top),
    ]


def _sofa(length: float, width: float, height: float) -> list[Part]:
    """Its back along +y."""
    arm, back = min(0.16, 0.12 * length), min(0.22, 0.3 * width)
    side = (length - arm) / 2
    return [
        UprightBox(0.0, -back / 2, length - 2 * arm, width - back, 0.05, height / 2 + 0.01),
        UprightBox(0.0, (width - back) / 2, length, back, 0.05, height),
        *(UprightBox(a * side, -back / 2, arm, width - back, 0.05, 0.72 * height) for a in (-1, 1)),
    ]


def _chair(length: float, width: float, height: float) -> list[Part]:
    """Its back along +y."""
    seat = 0.5 * height
    return [
        UprightBox(0.0, 0.0, length, width, seat - 0.04, seat),
        UprightBox(0.0, width / 2 - 0.02, length, 0.04, seat, height),
        *_legs(length, width, CHAIR_LEG_M / 2, CHAIR_LEG_M, seat - 0.04),
    ]


def _bed(length: float, width: float, height: float) -> list[Part]:
    """Its head along +y, `height` that of the headboard."""
    return [
        UprightBox(0.0, -0.03, length, width - 0.06, 0.14, 0.48),
        UprightBox(0.0, width / 2 - 0.03, length, 0.06, 0.0, height),
        *_legs(length, width, 0.06, 0.08, 0.14),
    ]


def _lamp(length: float, width: float, height: float) -> list[Part]:
    radius = min(length, width) / 2
    return [
        UprightCylinder(0.0, 0.0, 0.85 * radius, 0.0, 0.03),
        UprightCylinder(0.0, 0.0, 0.018, 0.03, height - 0.28),
        UprightCylinder(0.0, 0.0, radius, height - 0.28, height),
    ]


def parts_of(obstacle: Obstacle) -> list[Part]:
    """What is seen of a piece, in its own frame. A couch's back is on the side that the stage draws it on."""
    size = obstacle.length, obstacle.width, obstacle.height
    match obstacle.kind:
        case "table":
            return _table(*size)
        case "sofa":
            return _sofa(*size)
        case "chair":
            return _chair(*size)
        case "bed":
            return _bed(*size)
        case "lamp":
            return _lamp(*size)
        case "pillar":
            return [UprightCylinder(0.0, 0.0, min(obstacle.length, obstacle.width) / 2, 0.0, obstacle.height)]
        case _:
            return [UprightBox(0.0, 0.0, obstacle.length, obstacle.width, 0.0, obstacle.height)]


def _in_world(pose: Pose, x: float, y: float) -> tuple[float, float]:
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return pose.x + c * x - s * y, pose.y + s * x + c * y


def seen_of(scene: Scene) -> tuple[Doubles, Doubles]:
    """(boxes (n, 8), cylinders (m, 5)) of furniture and walls, as `depth_kernels.py` reads them; the person is apart.

    Walls first: what they hide is then never drawn.
    """
    boxes, cylinders = [], []
    for obstacle in sorted(scene.solids(), key=lambda one: one.kind != "wall"):
        c, s = math.cos(obstacle.pose.yaw), math.sin(obstacle.pose.yaw)
        for part in parts_of(obstacle):
            x, y = _in_world(obstacle.pose, part.x, part.y)
            if isinstance(part, UprightBox):
                boxes.append((x, y, c, s, part.length / 2, part.width / 2, part.low, part.high))
            else:
                cylinders.append((x, y, part.radius, part.low, part.high))
    return np.array(boxes).reshape(-1, 8), np.array(cylinders).reshape(-1, 5)


def pack(found: Sequence[Doubles], numbers: int) -> tuple[Doubles, NDArray[np.int64]]:
    """Sets (n_i, numbers) side by side: (sets, most, numbers) and how many each has."""
    counts = np.array([len(one) for one in found], dtype=np.int64)
    together = np.zeros((len(found), max(1, counts.max(initial=0)), numbers))
    for place, one in zip(together, found, strict=True):
        place[: len(one)] = one
    return together, counts


def _mannequin() -> Doubles:
    """(capsules, 7) of the stage's mannequin, 1 m tall, facing +x: both ends, radius."""
    limbs = [
        (0.0, 0.0, 1.55, 0.0, 0.0, 1.60, 0.095),  # head
        (0.0, 0.0, 1.38, 0.0, 0.0, 1.50, 0.045),  # neck
        (0.0, -0.055, 0.93, 0.0, -0.055, 1.30, 0.112),  # trunk, twice: it is wider than deep
        (0.0, 0.055, 0.93, 0.0, 0.055, 1.30, 0.112),
        (0.0, -0.165, 1.36, 0.0, 0.165, 1.36, 0.058),  # shoulders
    ]
    for side in (-1, 1):
        shoulder, elbow, hand = (0.0, side * 0.222, 1.355), (0.03, side * 0.262, 1.09), (0.22, side * 0.235, 0.92)
        hip, knee, ankle = (0.0, side * 0.088, 0.88), (0.018, side * 0.094, 0.49), (-0.01, side * 0.098, 0.09)
        limbs += [
            (*shoulder, *elbow, 0.046),
            (*elbow, *hand, 0.034),
            (*hip, *knee, 0.068),
            (*knee, *ankle, 0.050),
            (-0.03, side * 0.104, 0.045, 0.16, side * 0.104, 0.04, 0.042),
        ]
    return np.array(limbs) / 1.7


MANNEQUIN = _mannequin()
