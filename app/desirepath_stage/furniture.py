"""Obstacles and walls as things one recognises: sideboard, couch, table, cupboard, column, crate, planter, wall.

Every piece stays inside the box that the robot collides with; only looks live here.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.ground_maps import GroundMap
from desirepath.simulation.scene import Obstacle, Room
from desirepath_stage.shapes import Colour, Shape, ball, box, merge, quads, rotate

MAP_WALL_HEIGHT_M = 2.0  # as `scene.Room`'s
CUT_WALL_HEIGHT_M = 0.30  # seen from above, walls are cut low as in a plan, so that they hide nothing

_OAK: Colour = (186, 146, 104)
_OAK_WARM: Colour = (178, 138, 98)
_OAK_DARK: Colour = (150, 112, 76)
_OAK_LIGHT: Colour = (206, 170, 128)
_LINEN: Colour = (232, 226, 214)
_STONE: Colour = (222, 216, 206)
_STONE_DARK: Colour = (196, 188, 176)
_BRASS: Colour = (150, 122, 78)
_PLASTER: Colour = (240, 234, 223)
_SKIRTING: Colour = (206, 196, 180)
_WALL_CAP: Colour = (190, 178, 160)
_UNKNOWN: Colour = (176, 172, 165)
_TERRACOTTA: Colour = (186, 120, 88)
_SOIL: Colour = (88, 68, 54)
_LEAF: Colour = (104, 134, 92)
_LEAF_LIGHT: Colour = (132, 158, 108)
_GLASS: Colour = (206, 222, 228)
_CLOTH: Colour = (118, 134, 146)
_CLOTH_DARK: Colour = (92, 106, 118)
_CLOTH_LIGHT: Colour = (142, 158, 168)


def sideboard(length: float, width: float, height: float) -> Shape:
    """A sideboard on short legs with doors and drawers on both long sides; long side along x when length > width."""
    if width > length:
        return sideboard(width, length, height).moved(yaw=math.pi / 2)
    leg, top, rim = 0.10, 0.035, 0.012
    body_height = height - leg - top
    parts = [
        box((length - 0.04, width - 0.04, body_height), (0, 0, leg + body_height / 2), _OAK),
        box((length, width, top - 0.004), (0, 0, height - top / 2 - 0.002), _OAK_DARK),
        *(
            box((length - 0.07, (width - 0.10) / 4, 0.004), (0, (i - 1.5) * (width - 0.07) / 4, height - 0.002), tone)
            for i, tone in enumerate((_OAK, _OAK_WARM, _OAK, _OAK_WARM))
        ),
        box((length - 0.16, width - 0.16, 0.02), (0, 0, leg - 0.01), _OAK_DARK),
    ]
    for along in (-1, 1):
        for across in (-1, 1):
            foot = (along * (length / 2 - 0.08), across * (width / 2 - 0.08), leg / 2)
            parts.append(box((0.06, 0.06, leg), foot, _OAK_DARK))
    doors = max(2, round(length / 0.55))
    door_width = (length - 0.08) / doors
    drawer = 0.24 * body_height
    for side in (-1, 1):
        face = side * (width / 2 - 0.02)
        for i in range(doors):
            x = -length / 2 + 0.04 + door_width * (i + 0.5)
            for low, tall, colour in (
                (leg, body_height - drawer, _LINEN),
                (leg + body_height - drawer, drawer, _OAK_LIGHT),
            ):
                centre = (x, face + side * rim / 2, low + tall / 2)
                parts.append(box((door_width - 0.025, rim, tall - 0.025), centre, colour))
                parts.append(box((0.12, 0.014, 0.018), (x, face + side * 0.013, low + tall - 0.07), _BRASS))
    return merge(parts)


def column(length: float, width: float, height: float) -> Shape:
    """A stone column: square base and capital, round shaft."""
    radius = 0.5 * min(length, width)
    base = min(0.10, height / 4)
    shaft = [(radius * 0.86, base * 1.2), (radius * 0.80, base * 1.5), (radius * 0.74, height - base * 1.4)]
    shaft.append((radius * 0.86, height - base))
    return merge(
        [
            box((length, width, base), (0, 0, base / 2), _STONE_DARK),
            rotate([(radius * 0.94, base), (radius * 0.94, base * 1.2), *shaft], _STONE, segments=20),
            box((length, width, base), (0, 0, height - base / 2), _STONE_DARK),
        ]
    )


def crate(length: float, width: float, height: float) -> Shape:
    """A wooden crate: boards behind a frame, a brace across each side."""
    frame = min(0.07, 0.14 * min(length, width, height))
    inset = 0.018
    parts: list[Shape] = []
    boards = max(3, round(height / 0.14))
    board = (height - 0.02) / boards
    for i in range(boards):
        tone = _OAK if i % 2 else _OAK_LIGHT
        z = 0.01 + board * (i + 0.5)
        parts.append(box((length - 2 * inset, width - 2 * inset, board - 0.008), (0, 0, z), tone))
    lids = max(3, round(length / 0.14))
    lid = length / lids
    for i in range(lids):
        tone = _OAK_LIGHT if i % 2 else _OAK
        parts.append(box((lid - 0.01, width, 0.02), (-length / 2 + lid * (i + 0.5), 0, height - 0.01), tone))
    for x in (-1, 1):
        for y in (-1, 1):
            corner = (x * (length - frame) / 2, y * (width - frame) / 2, height / 2 - 0.01)
            parts.append(box((frame, frame, height - 0.02), corner, _OAK_DARK))
    for z in (frame / 2, height - 0.02 - frame / 2):
        for side in (-1, 1):
            parts.append(box((length - 2 * frame, 0.016, frame), (0, side * (width / 2 - 0.009), z), _OAK_DARK))
            parts.append(box((0.016, width - 2 * frame, frame), (side * (length / 2 - 0.009), 0, z), _OAK_DARK))
    return merge(parts)


def planter(length: float, width: float, height: float) -> Shape:
    """A terracotta trough with low leaves; leaves stay below `height`."""
    trough = 0.62 * height
    rim = 0.05
    parts = [
        box((length - 0.06, width - 0.06, trough), (0, 0, trough / 2), _TERRACOTTA),
        box((length, rim, 0.07), (0, (width - rim) / 2, trough - 0.035), _TERRACOTTA),
        box((length, rim, 0.07), (0, -(width - rim) / 2, trough - 0.035), _TERRACOTTA),
        box((rim, width - 2 * rim, 0.07), ((length - rim) / 2, 0, trough - 0.035), _TERRACOTTA),
        box((rim, width - 2 * rim, 0.07), (-(length - rim) / 2, 0, trough - 0.035), _TERRACOTTA),
        box((length - 2 * rim, width - 2 * rim, 0.01), (0, 0, trough - 0.005), _SOIL),
    ]
    room = height - trough
    spots = 7
    for i in range(spots):
        angle = 2 * math.pi * i / (spots - 1)
        out = 0.0 if i == spots - 1 else 0.27
        radius = room * (0.56 if out == 0.0 else 0.46)
        wide = min(radius * 1.15, 0.2 * min(length, width))
        centre = (out * length * math.cos(angle), out * width * math.sin(angle), trough + radius * 0.75)
        parts.append(ball(centre, (wide, wide, radius), _LEAF if i % 2 else _LEAF_LIGHT, segments=9, rings=5))
    return merge(parts)


def couch(length: float, width: float, height: float) -> Shape:
    """A couch on short legs, its back along one long side, an arm at either end; long side along x."""
    return sofa(width, length, height).moved(yaw=math.pi / 2) if width > length else sofa(length, width, height)


def sofa(length: float, width: float, height: float) -> Shape:
    """As a couch, its back always along +y, so that it and an armchair may stand against any wall of a home."""
    leg, seat = 0.08, 0.5 * height
    arm, back = min(0.16, 0.12 * length), min(0.22, 0.3 * width)
    parts = [
        box((length - 0.02, width - 0.02, seat - leg - 0.10), (0, 0, (seat + leg - 0.10) / 2), _CLOTH_DARK),
        box((length, back, height - leg), (0, (width - back) / 2, (height + leg) / 2), _CLOTH),
    ]
    cushions = max(2, round((length - 2 * arm) / 0.75))
    wide = (length - 2 * arm) / cushions
    for i in range(cushions):
        x = -length / 2 + arm + wide * (i + 0.5)
        parts.append(box((wide - 0.02, width - back - 0.02, 0.12), (x, -back / 2, seat - 0.05), _CLOTH_LIGHT))
    for side in (-1, 1):
        x = side * (length - arm) / 2
        parts.append(box((arm, width - back, 0.72 * height - leg), (x, -back / 2, (0.72 * height + leg) / 2), _CLOTH))
        for across in (-1, 1):
            foot = (side * (length / 2 - 0.07), across * (width / 2 - 0.07), leg / 2)
            parts.append(box((0.05, 0.05, leg), foot, _OAK_DARK))
    return merge(parts)


def table(length: float, width: float, height: float) -> Shape:
    """A table with four legs; what stands on it stays at home, so that nothing hides the way."""
    top, leg = 0.04, 0.07
    parts = [
        box((length, width, top), (0, 0, height - top / 2), _OAK_LIGHT),
        box((length - 0.16, width - 0.16, 0.08), (0, 0, height - top - 0.04), _OAK),
        *(
            box((length - 0.02, (width - 0.06) / 4, 0.004), (0, (i - 1.5) * (width - 0.02) / 4, height + 0.001), tone)
            for i, tone in enumerate((_OAK_LIGHT, _OAK, _OAK_LIGHT, _OAK))
        ),
    ]
    for along in (-1, 1):
        for across in (-1, 1):
            foot = (along * (length / 2 - 0.08), across * (width / 2 - 0.08), (height - top) / 2)
            parts.append(box((leg, leg, height - top), foot, _OAK_DARK))
    return merge(parts)


def cupboard(length: float, width: float, height: float) -> Shape:
    """A tall cupboard: two doors over a drawer on both long sides."""
    if width > length:
        return cupboard(width, length, height).moved(yaw=math.pi / 2)
    parts = [
        box((length - 0.03, width - 0.03, height - 0.04), (0, 0, (height - 0.04) / 2), _OAK_WARM),
        box((length, width, 0.04), (0, 0, height - 0.02), _OAK_DARK),
        box((length, width, 0.06), (0, 0, 0.03), _OAK_DARK),
    ]
    drawer = 0.22 * height
    for side in (-1, 1):
        face = side * (width / 2 - 0.012)
        parts.append(box((length - 0.08, 0.02, drawer - 0.05), (0, face, 0.06 + drawer / 2), _OAK_LIGHT))
        parts.append(box((0.16, 0.03, 0.02), (0, face, 0.06 + drawer / 2), _BRASS))
        for door in (-1, 1):
            tall = height - drawer - 0.14
            x, z = door * (length - 0.06) / 4, drawer + 0.06 + tall / 2
            parts.append(box(((length - 0.06) / 2 - 0.02, 0.02, tall), (x, face, z), _LINEN))
            parts.append(box((0.02, 0.03, 0.14), (door * 0.05, face, z), _BRASS))
    return merge(parts)


def chair(length: float, width: float, height: float) -> Shape:
    """A chair with its back along +y."""
    seat, leg = 0.5 * height, 0.04
    parts = [
        box((length, width, 0.04), (0, 0, seat - 0.02), _OAK_WARM),
        box((length, 0.04, 0.4 * (height - seat)), (0, width / 2 - 0.02, height - 0.2 * (height - seat)), _OAK_WARM),
    ]
    for along in (-1, 1):
        x = along * (length - leg) / 2
        parts.append(box((leg, 0.04, height - seat), (x, width / 2 - 0.02, (height + seat) / 2), _OAK_DARK))
        for across in (-1, 1):
            parts.append(box((leg, leg, seat - 0.04), (x, across * (width - leg) / 2, (seat - 0.04) / 2), _OAK_DARK))
    return merge(parts)


def bed(length: float, width: float, height: float) -> Shape:
    """A bed whose head stands along +y; `height` is the headboard's."""
    frame = box((length, width - 0.06, 0.14), (0, -0.03, 0.21), _OAK)
    parts = [
        frame,
        box((length - 0.06, width - 0.14, 0.18), (0, -0.04, 0.37), _LINEN),
        box((length - 0.04, 0.62 * width, 0.03), (0, -0.19 * width + 0.02, 0.465), _CLOTH_LIGHT),
        box((length, 0.06, height), (0, width / 2 - 0.03, height / 2), _OAK_WARM),
    ]
    for along in (-1, 1):
        pillow = (along * length / 4, width / 2 - 0.32, 0.462)
        parts.append(box((0.42 * length, 0.36, 0.03), pillow, _PLASTER))
        for across in (-1, 1):
            foot = (along * (length / 2 - 0.06), across * (width / 2 - 0.1), 0.07)
            parts.append(box((0.08, 0.08, 0.14), foot, _OAK_DARK))
    return merge(parts)


def lamp(length: float, width: float, height: float) -> Shape:
    """A standing lamp: a flat foot, a thin pole, a shade."""
    radius, shade = min(length, width) / 2, height - 0.28
    foot = [(0.85 * radius, 0.0), (0.85 * radius, 0.03), (0.018, 0.031), (0.018, shade)]
    return merge(
        [
            rotate(foot, _BRASS, segments=20),
            rotate([(radius, shade), (0.8 * radius, height)], _LINEN, segments=24),
            rotate([(0.8 * radius, height), (0.0, height)], _LINEN, segments=24),
        ]
    )


_MAKERS = {
    "column": column,
    "planter": planter,
    "crate": crate,
    "sideboard": sideboard,
    "couch": couch,
    "table": table,
    "cupboard": cupboard,
    "sofa": sofa,
    "chair": chair,
    "bed": bed,
    "lamp": lamp,
}


def _inner_wall(length: float, width: float, height: float) -> Shape:
    """A wall between two rooms, with the cap that outer walls have."""
    return merge(
        [
            box((length, width, height - 0.02), (0, 0, (height - 0.02) / 2), _PLASTER),
            box((length, width, 0.02), (0, 0, height - 0.01), _WALL_CAP),
        ]
    )


def piece(obstacle: Obstacle, index: int, *, cut: bool = False) -> Shape:
    """The obstacle's furniture in the world frame. Cubes alternate between crates and planters by `index`.

    cut: walls between rooms are as low as outer walls seen from above.
    """
    size = (obstacle.length, obstacle.width, obstacle.height)
    called = name(obstacle, index)
    if called == "wall":
        made = _inner_wall(*size[:2], min(CUT_WALL_HEIGHT_M, obstacle.height) if cut else obstacle.height)
    else:
        made = _MAKERS[called](*size)
    x, y, yaw = obstacle.pose.x, obstacle.pose.y, obstacle.pose.yaw
    if called == "couch" and y * math.cos(yaw) < x * math.sin(yaw):
        yaw += math.pi  # its back is away from the middle of the room
    return made.moved(x, y, yaw=yaw).lit()


def name(obstacle: Obstacle, index: int) -> str:
    """What people call the piece that `piece` makes; the words are the catalogues' (`drawing.stage.things`)."""
    if obstacle.kind == "cube":
        return "planter" if index % 3 == 2 else "crate"
    return {"pillar": "column", "box": "sideboard"}.get(obstacle.kind, obstacle.kind)


@lru_cache(maxsize=8)  # a setup has one room
def room_walls(room: Room, *, cut: bool) -> Shape:
    """The four walls with skirting; `cut` low for the view from above, else full height with windows and a door."""
    height = min(CUT_WALL_HEIGHT_M, room.wall_height) if cut else room.wall_height
    parts = []
    for wall in room.walls():
        x, y = wall.pose.x, wall.pose.y
        parts.append(box((wall.length, wall.width, height - 0.02), (x, y, (height - 0.02) / 2), _PLASTER))
        parts.append(box((wall.length, wall.width, 0.02), (x, y, height - 0.01), _WALL_CAP))
    half_x, half_y, skirt = room.length / 2, room.width / 2, 0.09
    for side in (-1, 1):
        parts.append(box((0.02, room.width, skirt), (side * (half_x - 0.01), 0, skirt / 2), _SKIRTING))
        parts.append(box((room.length, 0.02, skirt), (0, side * (half_y - 0.01), skirt / 2), _SKIRTING))
    if not cut:
        parts += [part for side in (-1, 1) for part in _windows(side * half_x, room.width, side, room.wall_height)]
        parts += _door(half_y, room.length, room.wall_height)
    return merge(parts).lit()


def map_walls(here: GroundMap, *, cut: bool) -> Shape:
    """What is occupied in a map, raised to walls, `cut` low as `room_walls`; what is unknown, darker on the floor."""
    height = CUT_WALL_HEIGHT_M if cut else MAP_WALL_HEIGHT_M
    sides, facing = here.wall_sides
    upright = np.concatenate([sides, sides[:, [2, 3, 0, 1]]], axis=1).reshape(
        -1, 4, 2
    )  # along the floor and back above
    heights = np.broadcast_to([[0.0], [0.0], [height], [height]], (len(sides), 4, 1))
    faces = quads(np.concatenate([upright, heights], axis=2), np.pad(facing, ((0, 0), (0, 1))), _PLASTER)
    return merge(
        [faces.lit(), _lying(here.walls, height, _WALL_CAP).lit(), _lying(here.unknown_parts, 0.004, _UNKNOWN)]
    )


def _lying(rectangles: NDArray[np.float64], height: float, colour: Colour) -> Shape:
    """Rectangles (n, 4), smallest x and y, largest x and y, m, so high above the floor."""
    corners = rectangles[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2)
    level = np.full((len(corners), 4, 1), height)
    return quads(np.concatenate([corners, level], axis=2), np.tile([0.0, 0.0, 1.0], (len(corners), 1)), colour)


def _windows(x: float, along: float, side: int, wall_height: float) -> list[Shape]:
    """Two framed windows on the wall at `x`, seen from inside."""
    low, high = 0.42 * wall_height, 0.86 * wall_height
    tall, wide = high - low, min(1.7, 0.25 * along)
    panes = []
    for where in (-0.24, 0.24):
        y, z = where * along, (low + high) / 2
        inner = x - side * 0.012
        panes.append(box((0.024, wide + 0.12, tall + 0.12), (inner, y, z), _LINEN))
        for pane in (-1, 1):
            panes.append(box((0.03, wide / 2 - 0.03, tall), (inner, y + pane * wide / 4, z), _GLASS))
        panes.append(box((0.09, wide + 0.2, 0.035), (x - side * 0.045, y, low - 0.07), _OAK_LIGHT))
    return panes


def _door(y: float, along: float, wall_height: float) -> list[Shape]:
    """A closed door in the wall at `y`, seen from inside."""
    tall, wide, x = 0.93 * wall_height, 0.9, -0.18 * along
    return [
        box((wide + 0.16, 0.02, tall + 0.06), (x, y - 0.01, (tall + 0.06) / 2), _SKIRTING),
        box((wide, 0.03, tall), (x, y - 0.015, tall / 2), _OAK_LIGHT),
        box((wide - 0.24, 0.036, 0.40 * tall), (x, y - 0.018, 0.72 * tall), _OAK),
        box((wide - 0.24, 0.036, 0.34 * tall), (x, y - 0.018, 0.27 * tall), _OAK),
        box((0.11, 0.07, 0.022), (x + wide / 2 - 0.09, y - 0.035, 0.5 * tall), _BRASS),
    ]
