"""The robot, a TurtleBot, a body of its own outline or its URDF, whose heading reads at a glance; the person, a wooden
mannequin that faces +x.

Both stand at the origin of their own frame, floor at z = 0. Looks only: what the robot hits is decided elsewhere, and
how legs move is the page's (`client/people.js`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import structlog
from numpy.typing import NDArray

from desirepath.grammar.source import ProtocolError
from desirepath.simulation.setups import Robot, version
from desirepath.simulation.urdf import Look, read_looks
from desirepath_stage.shapes import Colour, Shape, ball, box, disc, flat, limb, merge, prism, rotate

log = structlog.get_logger("desirepath.stage")

PERSON_DISC_RADIUS_M = 0.25  # ch. 7
_MODEL_RADIUS_M, _MODEL_HEIGHT_M = 0.18, 0.42  # of the TurtleBot 2 that every robot is drawn as, in its own size

_GRAPHITE: Colour = (58, 60, 64)
_GRAPHITE_LIGHT: Colour = (92, 95, 100)
_PLATE: Colour = (196, 196, 192)
_LAMP: Colour = (206, 244, 255)
_DARKEST = 28  # of a URDF's colours: black would show no shape
_WALNUT: Colour = (88, 58, 41)  # dark on every floor of `surfaces.py`, also where the page dims both
_WALNUT_DARK: Colour = (58, 38, 28)
_FACE: Colour = (112, 78, 54)
_BLUE: Colour = (52, 120, 214)
_GREEN: Colour = (26, 118, 62)
_CHALK: Colour = (250, 248, 240)
SHADE: Colour = (38, 26, 18)
GOAL_CONE_HEIGHT_M = 0.55


@dataclass(frozen=True)
class RobotColours:
    """What may differ between two robots on one stage (analysts only; participants always see `NEUTRAL`)."""

    top: Colour
    lamp: Colour


NEUTRAL = RobotColours(top=(240, 240, 236), lamp=_LAMP)
LEFT = RobotColours(top=(88, 150, 222), lamp=(226, 240, 255))
RIGHT = RobotColours(top=(232, 150, 66), lamp=(255, 240, 216))


def robot(of: Robot, colours: RobotColours = NEUTRAL) -> Shape:
    """What its URDF shows, where it has one that can be read; a body of its outline, where it is no disc; else a
    TurtleBot 2 of its size. Opaque parts."""
    return _robot(of, colours, changed(of))


def changed(of: Robot) -> tuple[int, int]:
    """What is another once the robot's URDF is, or a setup."""
    at = of.urdf.stat().st_mtime_ns if of.urdf is not None and of.urdf.is_file() else 0
    return version(), at


@lru_cache(maxsize=8)  # each may hold 100,000 triangles, and takes seconds to read
def _robot(of: Robot, colours: RobotColours, changed: tuple[int, int]) -> Shape:
    if of.urdf is not None:
        try:
            return _pictured(read_looks(of.urdf), colours)
        except ProtocolError as wrong:  # `desirepath robots check` tells the same
            log.warning("robot_without_urdf", robot=of.name, problems=[str(problem) for problem in wrong.problems])
    return _turtlebot(of, colours) if of.footprint is None else _outlined(of, of.footprint, colours)


def _pictured(looks: Sequence[Look], colours: RobotColours) -> Shape:
    """The parts of a URDF, flat faces; robots that are to be told apart have a tint of their own."""
    tint, share = np.array(colours.top), 0.0 if colours == NEUTRAL else 0.45
    parts = []
    for look in looks:
        corners = look.triangles.astype(np.float32)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        paint = np.ones((3 * len(corners), 4), np.float32)
        paint[:, :3] = ((1 - share) * np.maximum(look.colour, _DARKEST) + share * tint) / 255
        faces = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
        parts.append(Shape(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), paint, faces))
    return merge(parts).lit(turning=True)


def _outlined(of: Robot, footprint: tuple[tuple[float, float], ...], colours: RobotColours) -> Shape:
    """A body of that outline: a dark skirt, a plate, a top with an arrow ahead, lamps on the sides that face ahead."""
    outline, high = np.array(footprint), of.height_m
    if sum(x * v - y * u for (x, y), (u, v) in zip(footprint, footprint[1:] + footprint[:1], strict=True)) < 0:
        outline = outline[::-1]  # counter-clockwise
    parts = [
        prism(0.94 * outline, 0.02 * high, 0.34 * high, _GRAPHITE),
        prism(outline, 0.30 * high, 0.42 * high, _PLATE),
        prism(outline, 0.42 * high, 0.90 * high, _GRAPHITE_LIGHT),
        prism(0.97 * outline, 0.90 * high, high, colours.top),
    ]
    ends = np.roll(outline, -1, axis=0)
    for (ax, ay), (bx, by) in zip(outline, ends, strict=True):
        if by - ay > 0.7 * math.dist((ax, ay), (bx, by)):  # it faces ahead
            centre, length = ((ax + bx) / 2, (ay + by) / 2), math.dist((ax, ay), (bx, by))
            lamp = box((0.012, 0.9 * length, 0.18 * high), (-0.004, 0, 0.62 * high), colours.lamp)
            parts.append(lamp.moved(*centre, yaw=math.atan2(by - ay, bx - ax) - math.pi / 2))
    half, nose = of.inscribed_m, 0.8 * front_m(of)
    arrow = [(nose, 0.0), (nose - 0.9 * half, 0.5 * half), (nose - 0.65 * half, 0.0), (nose - 0.9 * half, -0.5 * half)]
    parts += [flat([arrow[0], arrow[1], arrow[2]], high + 0.002, _GRAPHITE)]
    parts += [flat([arrow[0], arrow[2], arrow[3]], high + 0.002, _GRAPHITE)]
    return merge(parts).lit(turning=True)


def front_m(of: Robot) -> float:
    """How far (m) its body reaches straight ahead of its middle."""
    if of.footprint is None:
        return of.radius_m
    crossings = [0.0]
    for (ax, ay), (bx, by) in zip(of.footprint, of.footprint[1:] + of.footprint[:1], strict=True):
        if (ay > 0) != (by > 0):
            crossings.append(ax - ay / (by - ay) * (bx - ax))
    return max(crossings)


def _turtlebot(of: Robot, colours: RobotColours) -> Shape:
    """A TurtleBot 2 of the robot's radius and height: base, three plates on posts, a sensor bar, and a lamp arc at its
    front (+x)."""
    r = _MODEL_RADIUS_M
    base = [(0, 0.012), (r * 0.92, 0.012), (r, 0.03), (r, 0.08), (r * 0.95, 0.098)]
    parts = [rotate(base, _GRAPHITE, segments=32), rotate([(r * 0.95, 0.098), (0, 0.1)], _GRAPHITE_LIGHT, segments=32)]
    arc = math.radians(55)
    lamp = [(r * 1.01, 0.036), (r * 1.015, 0.08), (r * 0.955, 0.101), (r * 0.80, 0.103)]
    parts.append(rotate(lamp, colours.lamp, segments=16, start=-arc, stop=arc))
    for height in (0.245, 0.405):
        top = colours.top if height > 0.4 else _PLATE
        parts.append(rotate([(0, height), (r * 0.88, height)], _GRAPHITE, segments=32))
        parts.append(rotate([(r * 0.88, height), (r * 0.88, height + 0.013)], _GRAPHITE, segments=32))
        parts.append(rotate([(r * 0.88, height + 0.013), (0, height + 0.013)], top, segments=32))
    for angle in (0.75, 2.35, -2.35, -0.75):
        x, y = 0.74 * r * math.cos(angle), 0.74 * r * math.sin(angle)
        parts.append(rotate([(0.011, 0.1), (0.011, 0.41)], _GRAPHITE, segments=8).moved(x, y))
    lid = 0.420
    cap = rotate([(r * 0.88, lid), (r * 0.34, lid)], _GRAPHITE, segments=16, start=-0.75, stop=0.75)
    bar = rotate([(r * 0.84, lid + 0.002), (r * 0.58, lid + 0.002)], colours.lamp, segments=16, start=-0.62, stop=0.62)
    sensor = [
        box((0.055, 0.23, 0.045), (0.045, 0, 0.345), _GRAPHITE),
        box((0.01, 0.19, 0.024), (0.074, 0, 0.346), _GRAPHITE_LIGHT),
        box((0.03, 0.05, 0.065), (0.02, 0, 0.29), _GRAPHITE),
    ]
    return _sized(merge([*parts, cap, bar, *sensor]).lit(turning=True), of)


def _sized(shape: Shape, of: Robot) -> Shape:
    wide, tall = of.radius_m / _MODEL_RADIUS_M, of.height_m / _MODEL_HEIGHT_M
    return replace(shape, positions=shape.positions * np.array([wide, wide, tall], np.float32))


def robot_glow(of: Robot, colours: RobotColours = NEUTRAL) -> Shape:
    """What lies on the floor under the robot: its contact shadow and the light of its lamp ahead. Translucent."""
    shade = disc(0.25, 0.006, SHADE, alpha=0.62, rim_alpha=0.0)
    begin = _MODEL_RADIUS_M * 0.9 * front_m(of) / of.radius_m
    reach, half = begin + 0.418, 0.5
    rays = 14
    light = rotate([(reach, 0.008), (begin, 0.008)], colours.lamp, segments=rays, start=-half, stop=half)
    light.colours[: rays + 1, 3] = 0.0
    light.colours[rays + 1 :, 3] = 0.85
    return _sized(merge([shade, light]), of)


SEAT_M, _HIP_M = 0.47, 0.88  # of who sits, of who stands
THIGH, SHIN, ARM = 1, 2, 3
"""What of a mannequin swings when it walks: about the hip, about the knee and the hip, about the shoulder."""


def mannequin(height: float = 1.7) -> Shape:
    """A jointed wooden figure facing +x, arms a little forward, nose and feet telling front from back."""
    figure = merge(part for part, _, _ in _joints())
    return Shape(figure.positions * (height / 1.7), figure.normals, figure.colours, figure.faces).lit()


def seated() -> Shape:
    """The figure on a stool, facing +x; it does not walk."""
    parts = [limb((0.0, 0.0, 0.03), (0.0, 0.0, SEAT_M - 0.12), 0.16, 0.19, _WALNUT_DARK)]
    for shape, part, _ in _joints():
        if part in (THIGH, SHIN):
            continue
        lower = shape.positions - np.array([0.0, 0.0, _HIP_M - SEAT_M], np.float32)
        parts.append(replace(shape, positions=lower))
    for side in (-1, 1):
        hip, knee, ankle = (0.0, side * 0.088, SEAT_M), (0.40, side * 0.115, SEAT_M), (0.40, side * 0.115, 0.09)
        parts += [
            limb(hip, knee, 0.076, 0.054, _WALNUT),
            ball(knee, (0.058, 0.055, 0.058), _WALNUT_DARK, segments=10, rings=6),
            limb(knee, ankle, 0.052, 0.036, _WALNUT),
            ball((0.472, side * 0.12, 0.040), (0.135, 0.050, 0.042), _WALNUT_DARK, segments=12, rings=6),
        ]
    return merge(parts).lit()


def gait_marks(height: float = 1.7) -> NDArray[np.float32]:
    """(N, 3) of every corner of the mannequin: its part (0 for the trunk), side (-1 right, 1 left) and figure's height
    (m), by which the page makes it walk.
    """
    marks = [np.tile([part, side, height], (len(shape.positions), 1)) for shape, part, side in _joints()]
    return np.concatenate(marks).astype(np.float32)


def _joints() -> list[tuple[Shape, int, int]]:
    """The parts of a figure of 1.7 m, each with what it swings with and its side."""
    trunk = [
        ball((0.0, 0, 1.575), (0.098, 0.078, 0.122), _FACE),
        limb((0.085, 0, 1.575), (0.135, 0, 1.550), 0.018, 0.014, _WALNUT_DARK, segments=8),
        limb((-0.005, 0, 1.40), (0.0, 0, 1.47), 0.045, 0.042, _WALNUT_DARK),
        ball((0.0, 0, 1.25), (0.118, 0.172, 0.185), _WALNUT),
        limb((0, -0.165, 1.36), (0, 0.165, 1.36), 0.055, 0.055, _WALNUT),
        ball((0.0, 0, 1.04), (0.088, 0.118, 0.10), _WALNUT_DARK),
        ball((0.0, 0, 0.92), (0.108, 0.158, 0.105), _WALNUT),
    ]
    parts = [(shape, 0, 0) for shape in trunk]
    for side in (-1, 1):
        shoulder, elbow, hand = (0.0, side * 0.222, 1.355), (0.03, side * 0.262, 1.09), (0.20, side * 0.235, 0.93)
        hip, knee, ankle = (0.0, side * 0.088, 0.88), (0.018, side * 0.094, 0.49), (-0.01, side * 0.098, 0.09)
        palm = (hand[0] + 0.04, hand[1], hand[2] - 0.03)
        parts += [
            (ball(shoulder, (0.062, 0.062, 0.062), _WALNUT_DARK, segments=12, rings=7), ARM, side),
            (limb(shoulder, elbow, 0.046, 0.038, _WALNUT), ARM, side),
            (ball(elbow, (0.042, 0.042, 0.042), _WALNUT_DARK, segments=10, rings=6), ARM, side),
            (limb(elbow, hand, 0.037, 0.029, _WALNUT), ARM, side),
            (ball(palm, (0.055, 0.026, 0.036), _FACE, segments=10, rings=6), ARM, side),
            (limb(hip, knee, 0.076, 0.054, _WALNUT), THIGH, side),
            (ball(knee, (0.058, 0.055, 0.058), _WALNUT_DARK, segments=10, rings=6), THIGH, side),
            (limb(knee, ankle, 0.052, 0.036, _WALNUT), SHIN, side),
            (ball((0.062, side * 0.104, 0.040), (0.135, 0.050, 0.042), _WALNUT_DARK, segments=12, rings=6), SHIN, side),
        ]
    return parts


def person_place(*, facing: bool) -> Shape:
    """The translucent blue disc that marks a person's place (ch. 7); `facing` adds a point towards +x."""
    plate = disc(PERSON_DISC_RADIUS_M, 0.010, _BLUE, alpha=0.46, rim_alpha=0.46, segments=48)
    r = PERSON_DISC_RADIUS_M
    rim = rotate([(r, 0.012), (r * 0.93, 0.012)], _BLUE, segments=48, alpha=0.85)
    parts = [plate, rim]
    if facing:
        side = (r * 1.03 * math.cos(0.42), r * 1.03 * math.sin(0.42))
        parts.append(flat([(side[0], -side[1]), (r * 1.55, 0.0), side], 0.011, _BLUE, alpha=0.9))
    return merge(parts)


def goal_cone() -> Shape:
    """The green cone at the goal (ch. 2), 12 cm thick at its foot: what stands there must not hide the way."""
    height, foot = GOAL_CONE_HEIGHT_M, 0.12
    slope = [(foot * 1.35, 0.012), (foot * 1.3, 0.03), (foot, 0.03), (0.012, height), (0.0, height)]
    return rotate(slope, _GREEN, segments=24).lit(turning=True)


def goal_ring(radius: float) -> Shape:
    """On the floor around the cone, as far as the goal reaches (m): green between two light rims. Translucent."""
    inside = rotate([(radius, 0.009), (0.0, 0.009)], _GREEN, segments=48, alpha=0.2)
    return merge([inside, _ring(radius, 0.05)])


def robot_ring(of: Robot) -> Shape:
    """On the floor around a robot, which is found by it in any picture and keeps its own size. Translucent."""
    return _ring(of.radius_m + min(0.75 * of.radius_m, 0.15), 0.045)


def _ring(radius: float, width: float) -> Shape:
    """A green band on the floor that ends at `radius`, with a light rim on either side, m."""
    rim = 0.4 * width
    bands = ((rim, 0.0, _CHALK, 0.9), (rim + width, rim, _GREEN, 0.95), (2 * rim + width, rim + width, _CHALK, 0.9))
    return merge(
        rotate([(radius - outside, 0.0095), (radius - inside, 0.0095)], colour, segments=48, alpha=alpha)
        for inside, outside, colour, alpha in bands
    )
