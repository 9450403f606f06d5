"""Homes: four furnished rooms with doors, made by rules from random numbers; start, goal and person in one of them.

Which seed gives which numbers, and what a scene is, stands in `scenes.py`. All sizes are ours, those of flats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from desirepath.simulation import kernels as k

WALL_M = 0.12
WALL_HEIGHT_M = 2.0  # as the outer walls'
DOOR_M = (0.9, 1.05)
AT_DOORS_M = 0.85  # nothing stands so near before a door
OFF_WALL_M = 0.05
BETWEEN_M = 0.08  # pieces
HAIR_M = 2e-6
CELL_M = 0.1
ROBOT_M = 0.23  # radius with some spare: what has to get through every door
SHORTEST_M, LONGEST_M = 1.5, 6.0  # of the way, section 3.4.3
TRIES = 60

# Name, depth from the wall, length along it, height, metres: (smallest, largest) each.
Size = tuple[float, float]
Piece = tuple[str, Size, Size, Size]
_SOFA: Piece = ("sofa", (0.85, 0.95), (1.7, 2.2), (0.78, 0.85))
_ARMCHAIR: Piece = ("sofa", (0.8, 0.9), (0.8, 0.9), (0.78, 0.9))
_SIDEBOARD: Piece = ("box", (0.4, 0.45), (1.2, 1.7), (0.5, 0.85))
_LAMP: Piece = ("lamp", (0.36, 0.4), (0.36, 0.4), (1.5, 1.7))
_BED: Piece = ("bed", (2.0, 2.1), (1.4, 1.8), (0.85, 1.05))
_CUPBOARD: Piece = ("cupboard", (0.5, 0.6), (1.2, 1.8), (1.8, 1.95))
_CHEST: Piece = ("box", (0.4, 0.5), (0.8, 1.1), (0.75, 0.95))
_DESK: Piece = ("table", (0.65, 0.75), (1.2, 1.5), (0.72, 0.75))
_SHELF: Piece = ("cupboard", (0.3, 0.35), (0.9, 1.4), (1.8, 1.95))
_DINING: Piece = ("table", (0.8, 0.9), (1.3, 1.6), (0.74, 0.76))
_COFFEE: Piece = ("table", (0.5, 0.6), (0.9, 1.1), (0.42, 0.48))
CHAIR_M, CHAIR_HEIGHT_M = 0.44, 0.88

WALLS = 7
_LIVING, _DINING_ROOM = ("sofa", "table", "sofa", "box", "lamp"), ("table", *("chair",) * 4, "box")
_BEDROOM, _STUDY = ("bed", "cupboard", "box"), ("table", "chair", "cupboard", "lamp")
KINDS = ("wall",) * WALLS + _LIVING + _DINING_ROOM + _BEDROOM + _STUDY

Rectangle = tuple[float, float, float, float]
"""Smallest x and y, largest x and y, metres."""


class _NoNumbersLeft(Exception):
    pass


class _NoRoom(Exception):
    """A piece found no place: the home is drawn anew."""


class _Chance:
    """Random numbers in [0, 1), one after the other."""

    def __init__(self, uniforms: NDArray[np.float64]) -> None:
        self._left = iter(uniforms.tolist())

    def __call__(self) -> float:
        for number in self._left:
            return float(number)
        raise _NoNumbersLeft

    def within(self, low: float, high: float) -> float:
        """A micrometre's grid hides the last-bit differences between machines."""
        return _tidy(low + (high - low) * self())

    def order(self, count: int) -> list[int]:
        return sorted(range(count), key=lambda _: self())


def _tidy(value: float) -> float:
    return math.floor(value * 1e6 + 0.5) / 1e6


@dataclass
class _Plan:
    """What has been decided: walls (rectangles), rooms, zones before doors, pieces (rectangle and row numbers)."""

    walls: list[Rectangle]
    rooms: list[Rectangle]
    doors: list[Rectangle]
    furniture: list[tuple[str, Rectangle, float, float, float, float]]

    def fits(self, here: Rectangle, room: Rectangle, between: float = BETWEEN_M) -> bool:
        if here[0] < room[0] or here[1] < room[1] or here[2] > room[2] or here[3] > room[3]:
            return False
        if any(_overlap(here, door, 0.0) for door in self.doors):
            return False
        return not any(_overlap(here, piece[1], between) for piece in self.furniture)


def _overlap(a: Rectangle, b: Rectangle, gap: float) -> bool:
    return a[0] < b[2] + gap and b[0] < a[2] + gap and a[1] < b[3] + gap and b[1] < a[3] + gap


def _floor_plan(chance: _Chance, half_x: float, half_y: float) -> _Plan:
    """Four rooms: one wall straight through, with a door on either side of two walls that end at it."""
    x = chance.within(-0.5, 0.5)
    ends = chance.within(-0.4, 0.4), chance.within(-0.4, 0.4)
    t, plan = WALL_M / 2, _Plan([], [], [], [])
    low, high = min(ends) - t, max(ends) + t

    def opening(begin: float, end: float) -> tuple[float, float]:
        """A door between two walls' corners."""
        width = chance.within(*DOOR_M)
        middle = chance.within(begin + width / 2 + 0.15, end - width / 2 - 0.15)
        return _tidy(middle - width / 2), _tidy(middle + width / 2)

    lower, upper = opening(-half_y, low), opening(high, half_y)
    stops = (-half_y, *lower, *upper, half_y)
    plan.walls += [(x - t, stops[i], x + t, stops[i + 1]) for i in (0, 2, 4)]
    plan.doors += [(x - AT_DOORS_M, door[0], x + AT_DOORS_M, door[1]) for door in (lower, upper)]
    for y, (begin, end) in zip(ends, ((-half_x, x - t), (x + t, half_x)), strict=True):
        door = opening(begin, end)
        plan.walls += [(begin, y - t, door[0], y + t), (door[1], y - t, end, y + t)]
        plan.doors.append((door[0], y - AT_DOORS_M, door[1], y + AT_DOORS_M))
        plan.rooms += [(begin, -half_y, end, y - t), (begin, y + t, end, half_y)]
    return plan


# Quarter turns of a piece whose back (+y) is at the wall: north, west, south, east; and whether it lies along x.
_SIDES = ((0.0, True), (math.pi / 2, False), (math.pi, True), (-math.pi / 2, False))


def _at_wall(chance: _Chance, plan: _Plan, room: Rectangle, piece: Piece) -> int:
    """Put a piece with its back to a wall of the room; returns the wall. Raises _NoRoom."""
    kind, depth, along, tall = piece
    deep, wide, height = chance.within(*depth), chance.within(*along), chance.within(*tall)
    for _ in range(TRIES):
        side = min(3, int(4 * chance()))
        yaw, along_x = _SIDES[side]
        size_x, size_y = (wide, deep) if along_x else (deep, wide)
        x = chance.within(room[0] + size_x / 2 + OFF_WALL_M, room[2] - size_x / 2 - OFF_WALL_M)
        y = chance.within(room[1] + size_y / 2 + OFF_WALL_M, room[3] - size_y / 2 - OFF_WALL_M)
        if along_x:
            y = _tidy(room[3] - deep / 2 - OFF_WALL_M if side == 0 else room[1] + deep / 2 + OFF_WALL_M)
        else:
            x = _tidy(room[0] + deep / 2 + OFF_WALL_M if side == 1 else room[2] - deep / 2 - OFF_WALL_M)
        here = (x - size_x / 2, y - size_y / 2, x + size_x / 2, y + size_y / 2)
        if plan.fits(here, room):
            plan.furniture.append((kind, here, yaw, wide, deep, height))
            return side
    raise _NoRoom


def _before(chance: _Chance, plan: _Plan, room: Rectangle, side: int, piece: Piece, gap: Size) -> None:
    """Put a piece in front of the one placed last, e.g. the low table before the sofa."""
    kind, depth, along, tall = piece
    deep, wide, height = chance.within(*depth), chance.within(*along), chance.within(*tall)
    there, away = plan.furniture[-1][1], chance.within(*gap)
    yaw, along_x = _SIDES[side]
    size_x, size_y = (wide, deep) if along_x else (deep, wide)
    x, y = (there[0] + there[2]) / 2, (there[1] + there[3]) / 2
    if along_x:
        y = there[1] - away - deep / 2 if side == 0 else there[3] + away + deep / 2
    else:
        x = there[2] + away + deep / 2 if side == 1 else there[0] - away - deep / 2
    x, y = _tidy(x), _tidy(y)
    here = (x - size_x / 2, y - size_y / 2, x + size_x / 2, y + size_y / 2)
    if not plan.fits(here, room, between=0.01):
        raise _NoRoom
    plan.furniture.append((kind, here, yaw, wide, deep, height))


def _dining_group(chance: _Chance, plan: _Plan, room: Rectangle) -> None:
    """A table with two chairs on either long side."""
    kind, depth, along, tall = _DINING
    deep, wide, height = chance.within(*depth), chance.within(*along), chance.within(*tall)
    turned = chance() < 0.5
    reach = deep / 2 + 0.04 + CHAIR_M
    half_x, half_y = (reach, wide / 2) if turned else (wide / 2, reach)
    for _ in range(TRIES):
        x, y = chance.within(room[0] + half_x, room[2] - half_x), chance.within(room[1] + half_y, room[3] - half_y)
        if not plan.fits((x - half_x, y - half_y, x + half_x, y + half_y), room):
            continue
        flat = (deep / 2, wide / 2) if turned else (wide / 2, deep / 2)
        here = (x - flat[0], y - flat[1], x + flat[0], y + flat[1])
        plan.furniture.append((kind, here, math.pi / 2 if turned else 0.0, wide, deep, height))
        for across in (-1, 1):
            for beside in (-1, 1):
                off, off_along = across * (reach - CHAIR_M / 2), beside * wide / 4
                cx, cy = (_tidy(x + off), _tidy(y + off_along)) if turned else (_tidy(x + off_along), _tidy(y + off))
                away = {(False, 1): 0, (True, -1): 1, (False, -1): 2, (True, 1): 3}[turned, across]
                h = CHAIR_M / 2
                spot = (cx - h, cy - h, cx + h, cy + h)
                plan.furniture.append(("chair", spot, _SIDES[away][0], CHAIR_M, CHAIR_M, CHAIR_HEIGHT_M))
        return
    raise _NoRoom


def _furnished(chance: _Chance, plan: _Plan) -> None:
    """All pieces in the order of KINDS, the rooms' uses in a drawn order."""
    living, dining, bedroom, study = (plan.rooms[i] for i in chance.order(4))
    side = _at_wall(chance, plan, living, _SOFA)
    _before(chance, plan, living, side, _COFFEE, (0.3, 0.4))
    for piece in (_ARMCHAIR, _SIDEBOARD, _LAMP):
        _at_wall(chance, plan, living, piece)
    _dining_group(chance, plan, dining)
    _at_wall(chance, plan, dining, _SIDEBOARD)
    for piece in (_BED, _CUPBOARD, _CHEST):
        _at_wall(chance, plan, bedroom, piece)
    side = _at_wall(chance, plan, study, _DESK)
    _before(chance, plan, study, side, ("chair", (CHAIR_M,) * 2, (CHAIR_M,) * 2, (CHAIR_HEIGHT_M,) * 2), (0.05, 0.15))
    # A chair looks at its desk: its back is turned to the room.
    kind, here, yaw, *sizes = plan.furniture[-1]
    plan.furniture[-1] = (kind, here, k.wrap(yaw + math.pi), sizes[0], sizes[1], sizes[2])
    for piece in (_SHELF, _LAMP):
        _at_wall(chance, plan, study, piece)


def _write(plan: _Plan, row: k.Row) -> None:
    bodies = [((w[0] + w[2]) / 2, (w[1] + w[3]) / 2, 0.0, w[2] - w[0], w[3] - w[1], WALL_HEIGHT_M) for w in plan.walls]
    bodies += [
        ((at[0] + at[2]) / 2, (at[1] + at[3]) / 2, yaw, wide, deep, height)
        for _, at, yaw, wide, deep, height in plan.furniture
    ]
    row[k.BOX_COUNT] = len(bodies)
    for box, (x, y, yaw, length, width, height) in enumerate(bodies):
        o = k.FIRST_BOX + k.BOX_COLUMNS * box
        row[o + k.BOX_X], row[o + k.BOX_Y], row[o + k.BOX_YAW] = _tidy(x), _tidy(y), yaw
        # Smaller by a hair, so that rounding makes no two walls that meet overlap.
        row[o + k.BOX_HALF_LENGTH], row[o + k.BOX_HALF_WIDTH] = _tidy(length / 2 - HAIR_M), _tidy(width / 2 - HAIR_M)
        row[o + k.BOX_HEIGHT] = height
    k.finish_row(row)


def _open_floor(row: k.Row, radius: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(columns, lines, 2) places CELL_M apart, and (columns, lines) the number of the connected floor a disc is on."""
    half_x, half_y = row[k.ROOM_HALF_X], row[k.ROOM_HALF_Y]
    axes = [np.arange(-half + CELL_M / 2, half, CELL_M) for half in (half_x, half_y)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=2)
    free = np.zeros(places.shape[:2], dtype=np.bool_)
    alone = row.copy()
    alone[k.PERSON_X] = math.inf
    k.mark_free(alone, places, radius, free)
    return places, ndimage.label(free)[0]


def _cell(places: NDArray[np.float64], where: NDArray[np.float64]) -> tuple[int, int]:
    i, j = np.round((where - places[0, 0]) / CELL_M).astype(int)
    return int(i), int(j)


def _connected(plan: _Plan, places: NDArray[np.float64], floors: NDArray[np.int64]) -> int:
    """The number of the floor that every door lies on, 0 where there is none."""
    found = set()
    for door in plan.doors:
        middle = np.array([(door[0] + door[2]) / 2, (door[1] + door[3]) / 2])
        found.add(int(floors[_cell(places, middle)]))
    return found.pop() if len(found) == 1 else 0


def _places(chance: _Chance, plan: _Plan, row: k.Row, spacing: k.Spacing) -> bool:
    """Start, goal and person in one room, on the floor that leads everywhere."""
    grid, floors = _open_floor(row, ROBOT_M)
    whole = _connected(plan, grid, floors)
    if whole == 0:
        return False
    room = plan.rooms[min(3, int(4 * chance()))]
    spare = spacing.robot_radius + spacing.spare_at_ends
    for _ in range(TRIES):
        for column in (k.START_X, k.GOAL_X, k.PERSON_X):
            row[column], row[column + 1] = chance.within(room[0], room[2]), chance.within(room[1], room[3])
            row[column + 2] = (2 * chance() - 1) * math.pi
        way = math.dist(row[[k.START_X, k.START_Y]], row[[k.GOAL_X, k.GOAL_Y]])
        if not SHORTEST_M < way < LONGEST_M or not k._person_fits(row, spacing):
            continue
        ends = [(float(row[c]), float(row[c + 1])) for c in (k.START_X, k.GOAL_X)]
        if min(k.surface_distance(row, *end) for end in ends) < spare:
            continue
        if (
            k.surface_distance(row, row[k.PERSON_X], row[k.PERSON_Y])
            < row[k.PERSON_RADIUS] + spacing.gap_between_bodies
        ):
            continue
        if any(floors[_cell(grid, np.array(end))] != whole for end in ends):
            continue
        if k.reachable(row, spacing.robot_radius + spacing.spare_on_the_way):
            return True
    return False


def draw_home(uniforms: NDArray[np.float64], row: k.Row, spacing: k.Spacing) -> bool:
    """Draw one home into the row from numbers in [0, 1); False if they ran out."""
    chance = _Chance(uniforms)
    try:
        while True:
            row[k.ROOM_HALF_X], row[k.ROOM_HALF_Y] = chance.within(4.6, 5.4), chance.within(3.8, 4.4)
            plan = _floor_plan(chance, float(row[k.ROOM_HALF_X]), float(row[k.ROOM_HALF_Y]))
            try:
                _furnished(chance, plan)
            except _NoRoom:
                continue
            _write(plan, row)
            if _places(chance, plan, row, spacing):
                return True
    except _NoNumbersLeft:
        return False
