"""Every compiled function of a scene row: its geometry, scene drawing, lidar, driving, rewards, what planners ask it.

They share one file because Numba's cache on disk notices a change only in the file of the function itself
(`tests/test_compiled_functions.py` holds it). Nothing here knows of Scene objects, policies or Gymnasium; `scenes.py`,
`fast.py` and the controllers of `desirepath.demonstrations` call these functions.

A *scene row* is a scene as float64 numbers, with the columns named below.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Row = NDArray[np.float64]
Rows = NDArray[np.float64]

START_X, START_Y, START_YAW = 0, 1, 2
GOAL_X, GOAL_Y, GOAL_YAW, GOAL_RADIUS = 3, 4, 5, 6
PERSON_X, PERSON_Y, PERSON_YAW, PERSON_RADIUS = 7, 8, 9, 10
ROOM_HALF_X, ROOM_HALF_Y = 11, 12  # 0 where there is no room
BOX_COUNT, FIRST_BOX = 13, 14
# One box, relative to its first column. Cosine and sine of the yaw are kept because every ray needs them.
BOX_X, BOX_Y, BOX_HALF_LENGTH, BOX_HALF_WIDTH, BOX_YAW, BOX_COS, BOX_SIN, BOX_HEIGHT = range(8)
BOX_COLUMNS = 8

RUNNING, SUCCESS, COLLISION, TIMEOUT = 0, 1, 2, 3  # trajectory.Outcome

SMALLEST_ADVANCE_M = 5e-4  # collision search: the robot moves by its clearance, but at least this far per sub-step
TOUCH_M = 1e-9  # rounding: a robot that moved exactly up to a surface has not hit it
OVERLAP_M = 1e-3  # what a polygon that overlaps something is said to be inside it
LONGEST_LEAP = 127  # cells, in a table of int8
GRID_M = 0.05  # cell of the reachability search


Compiled = TypeVar("Compiled", bound=Callable[..., object])


# NaN and infinity keep their meaning, so an empty field may have infinite clearance.
_FAST: dict[str, Any] = {
    "cache": True,
    "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"},
    "error_model": "numpy",
}


def compiled(function: Compiled) -> Compiled:
    """Compile for speed."""
    return cast(Compiled, numba.njit(**_FAST)(function))


def compiled_parallel(function: Compiled) -> Compiled:
    """Compile for speed, with `prange` loops on all of Numba's threads."""
    return cast(Compiled, numba.njit(parallel=True, **_FAST)(function))


def inlined(function: Compiled) -> Compiled:
    """Compile into the caller: handing a tuple of arrays to a function costs as much as half a lidar scan."""
    return cast(Compiled, numba.njit(forceinline=True, **_FAST)(function))


def compiled_exactly(function: Compiled) -> Compiled:
    """Compile with IEEE arithmetic as written, for scenes that must be equal on every machine."""
    return cast(Compiled, numba.njit(cache=True)(function))


# --- geometry -------------------------------------------------------------------------------------------------------


@compiled_exactly
def finish_row(row: Row) -> None:
    """Fill in the cosines and sines of all boxes of one scene row."""
    for b in range(int(row[BOX_COUNT])):
        o = FIRST_BOX + BOX_COLUMNS * b
        row[o + BOX_COS] = math.cos(row[o + BOX_YAW])
        row[o + BOX_SIN] = math.sin(row[o + BOX_YAW])


@compiled
def wrap(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    turns = math.floor((angle + math.pi) / (2 * math.pi))
    wrapped = angle - 2 * math.pi * turns
    return wrapped if wrapped > -math.pi else wrapped + 2 * math.pi


@compiled
def box_distance(row: Row, o: int, x: float, y: float) -> float:
    """Distance (m) from a point to the surface of the box at column o; negative inside."""
    dx, dy = x - row[o + BOX_X], y - row[o + BOX_Y]
    c, s = row[o + BOX_COS], row[o + BOX_SIN]
    along: float = abs(dx * c + dy * s) - row[o + BOX_HALF_LENGTH]
    across: float = abs(dy * c - dx * s) - row[o + BOX_HALF_WIDTH]
    if along > 0.0 and across > 0.0:
        return math.sqrt(along * along + across * across)
    return max(along, across)


class Ground(NamedTuple):
    """The cells of a map (`ground_maps.py`), whose outermost ones are all occupied; its lower left corner lies at x, y.

    nearest (columns, lines, 2) int16: of each cell the nearest occupied one, by their centres. leaps (columns, lines)
    int8, as small as caches are: how far any point of a cell may move without reaching an occupied one, in whole cells;
    -1 where it is occupied itself. cell: side, metres.

    Functions take None where a scene has no map: Numba compiles them without a map then, as fast as if there were none.
    """

    nearest: NDArray[np.int16]
    leaps: NDArray[np.int8]
    x: float
    y: float
    cell: float


@compiled
def ground_distance(ground: Ground, x: float, y: float) -> float:
    """Distance (m) from a point to the nearest occupied cell; negative inside one and off the map."""
    across, up = (x - ground.x) / ground.cell, (y - ground.y) / ground.cell
    columns, lines = ground.leaps.shape
    if across < 0.0 or up < 0.0 or across >= columns or up >= lines:
        return -ground.cell / 2
    i, j = int(across), int(up)
    if ground.leaps[i, j] < 0:
        return -ground.cell / 2
    # Of the four cells around the point, each one's nearest: no other is nearer by more than a hair.
    beside = 1 if across - i > 0.5 else -1
    above = 1 if up - j > 0.5 else -1
    best = math.inf
    for di in (0, beside):
        for dj in (0, above):
            n, m = ground.nearest[i + di, j + dj, 0], ground.nearest[i + di, j + dj, 1]
            dx, dy = max(abs(across - n - 0.5) - 0.5, 0.0), max(abs(up - m - 0.5) - 0.5, 0.0)
            best = min(best, dx * dx + dy * dy)
    return math.sqrt(best) * ground.cell


@compiled
def surface_distance(row: Row, x: float, y: float, ground: Ground | None = None) -> float:
    """Distance (m) from a point to the nearest box or wall surface; infinite in an empty field."""
    nearest = math.inf
    if ground is not None:
        nearest = ground_distance(ground, x, y)
    if row[ROOM_HALF_X] > 0.0:
        nearest = min(row[ROOM_HALF_X] - abs(x), row[ROOM_HALF_Y] - abs(y))
    for b in range(int(row[BOX_COUNT])):
        nearest = min(nearest, box_distance(row, FIRST_BOX + BOX_COLUMNS * b, x, y))
    return nearest


@compiled
def path_surface_distance(row: Row, path: NDArray[np.float64], ground: Ground | None = None) -> float:
    """The smallest `surface_distance` along the points (points, 2) of a path."""
    nearest = math.inf
    for p in range(path.shape[0]):
        nearest = min(nearest, surface_distance(row, path[p, 0], path[p, 1], ground))
    return nearest


@compiled
def _to_box(x: float, y: float, half_length: float, half_width: float) -> float:
    """Distance from a point in a box's own frame to the box; 0 inside."""
    along, across = max(abs(x) - half_length, 0.0), max(abs(y) - half_width, 0.0)
    return math.sqrt(along * along + across * across)


@compiled
def _to_segment(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Distance from a point to the line segment from a to b."""
    ex, ey = bx - ax, by - ay
    squared = ex * ex + ey * ey
    part = min(max(((px - ax) * ex + (py - ay) * ey) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return math.sqrt((px - ax - part * ex) ** 2 + (py - ay - part * ey) ** 2)


@compiled
def _segment_to_box(ax: float, ay: float, bx: float, by: float, half_length: float, half_width: float) -> float:
    """Distance from a segment in a box's own frame to the box; -OVERLAP_M where it enters it."""
    enters, leaves, misses = 0.0, 1.0, False
    for axis in range(2):
        origin, step, half = (ax, bx - ax, half_length) if axis == 0 else (ay, by - ay, half_width)
        half -= TOUCH_M
        if step == 0.0:
            misses = misses or abs(origin) > half
        else:
            first, last = (-half - origin) / step, (half - origin) / step
            enters, leaves = max(enters, min(first, last)), min(leaves, max(first, last))
    if not misses and enters <= leaves:
        return -OVERLAP_M
    nearest = min(_to_box(ax, ay, half_length, half_width), _to_box(bx, by, half_length, half_width))
    for sign_x in (-1.0, 1.0):
        for sign_y in (-1.0, 1.0):
            nearest = min(nearest, _to_segment(sign_x * half_length, sign_y * half_width, ax, ay, bx, by))
    return nearest


@compiled
def _holds(corners: NDArray[np.float64], x: float, y: float) -> bool:
    """Whether a polygon (corners, 2) holds a point."""
    inside, before = False, corners.shape[0] - 1
    for after in range(corners.shape[0]):
        ay, by = corners[before, 1], corners[after, 1]
        if (ay > y) != (by > y):
            crossing = corners[before, 0] + (y - ay) / (by - ay) * (corners[after, 0] - corners[before, 0])
            inside = inside != (x < crossing)
        before = after
    return bool(inside)


@compiled
def body_corners(outline: NDArray[np.float64], x: float, y: float, yaw: float) -> NDArray[np.float64]:
    """The corners (n, 2) of an outline, given in the robot's frame, of a robot at that pose."""
    c, s = math.cos(yaw), math.sin(yaw)
    corners = np.empty_like(outline)
    for n in range(outline.shape[0]):
        corners[n, 0] = x + c * outline[n, 0] - s * outline[n, 1]
        corners[n, 1] = y + s * outline[n, 0] + c * outline[n, 1]
    return corners


@compiled
def body_person_gap(row: Row, corners: NDArray[np.float64]) -> float:
    """Distance (m) from a robot's outline (corners, 2) to the person's surface; negative where they overlap."""
    x, y, before = row[PERSON_X], row[PERSON_Y], corners.shape[0] - 1
    nearest = math.inf
    for after in range(corners.shape[0]):
        to_side = _to_segment(x, y, corners[before, 0], corners[before, 1], corners[after, 0], corners[after, 1])
        nearest = min(nearest, to_side)
        before = after
    gap: float = (-nearest if _holds(corners, x, y) else nearest) - row[PERSON_RADIUS]
    return gap


@compiled
def body_surface_gap(row: Row, corners: NDArray[np.float64], ground: Ground | None = None) -> float:
    """Distance (m) from a robot's outline (corners, 2) to the nearest box, wall or occupied cell, below 0 where they
    overlap; infinite in an empty field."""
    nearest = math.inf
    sides = corners.shape[0]
    if row[ROOM_HALF_X] > 0.0:
        for n in range(sides):
            nearest = min(nearest, row[ROOM_HALF_X] - abs(corners[n, 0]), row[ROOM_HALF_Y] - abs(corners[n, 1]))
    for b in range(int(row[BOX_COUNT])):
        o = FIRST_BOX + BOX_COLUMNS * b
        c, s = row[o + BOX_COS], row[o + BOX_SIN]
        length, width = row[o + BOX_HALF_LENGTH], row[o + BOX_HALF_WIDTH]
        dx, dy = corners[sides - 1, 0] - row[o + BOX_X], corners[sides - 1, 1] - row[o + BOX_Y]
        ax, ay = dx * c + dy * s, dy * c - dx * s
        for n in range(sides):
            dx, dy = corners[n, 0] - row[o + BOX_X], corners[n, 1] - row[o + BOX_Y]
            bx, by = dx * c + dy * s, dy * c - dx * s
            nearest = min(nearest, _segment_to_box(ax, ay, bx, by, length, width))
            ax, ay = bx, by
        if _holds(corners, row[o + BOX_X], row[o + BOX_Y]):
            nearest = min(nearest, -OVERLAP_M)
    if ground is not None:
        for n in range(sides):
            mx, my = (corners[n - 1, 0] + corners[n, 0]) / 2, (corners[n - 1, 1] + corners[n, 1]) / 2
            nearest = min(nearest, ground_distance(ground, corners[n, 0], corners[n, 1]))
            nearest = min(nearest, ground_distance(ground, mx, my))
        for n in range(sides):
            ax, ay = corners[n - 1, 0], corners[n - 1, 1]
            ex, ey = corners[n, 0] - ax, corners[n, 1] - ay
            side = math.sqrt(ex * ex + ey * ey)
            if side <= 0.0 or ground_distance(ground, ax + ex / 2, ay + ey / 2) - side / 2 >= nearest:
                continue
            at = 0.0
            while at <= side:
                # A place as far off as `apart` has nothing nearer than `nearest` around it: skip that far.
                apart = ground_distance(ground, ax + at / side * ex, ay + at / side * ey)
                at += max(apart - nearest, ground.cell / 8)
                nearest = min(nearest, apart)
    return nearest


@compiled
def poses_surface_gap(
    row: Row, poses: NDArray[np.float64], outline: NDArray[np.float64], ground: Ground | None = None
) -> float:
    """The smallest `body_surface_gap` along poses (n, 3) of a robot of that outline."""
    nearest = math.inf
    for p in range(poses.shape[0]):
        corners = body_corners(outline, poses[p, 0], poses[p, 1], poses[p, 2])
        nearest = min(nearest, body_surface_gap(row, corners, ground))
    return nearest


@compiled
def person_distance(row: Row, x: float, y: float) -> float:
    """Distance (m) from a point to the person's centre."""
    return math.sqrt((x - row[PERSON_X]) ** 2 + (y - row[PERSON_Y]) ** 2)


@compiled_exactly
def boxes_gap(row: Row, first: int, second: int) -> float:
    """A lower bound (m) of the gap between two boxes, by separating axes; negative exactly when they overlap."""
    dx, dy = row[second + BOX_X] - row[first + BOX_X], row[second + BOX_Y] - row[first + BOX_Y]
    gap = -math.inf
    for owner in (first, second):
        for quarter in range(2):
            ax, ay = row[owner + BOX_COS], row[owner + BOX_SIN]
            if quarter == 1:
                ax, ay = -ay, ax
            reach = 0.0
            for o in (first, second):
                c, s = row[o + BOX_COS], row[o + BOX_SIN]
                reach += row[o + BOX_HALF_LENGTH] * abs(ax * c + ay * s)
                reach += row[o + BOX_HALF_WIDTH] * abs(ay * c - ax * s)
            gap = max(gap, abs(dx * ax + dy * ay) - reach)
    return gap


@compiled_exactly
def _wall_gap(row: Row, body: int, wall: int) -> float:
    """The gap (m) between a box, or the person (number BOX_COUNT), and wall 0..3 (+x, -x, +y, -y) of the room."""
    if body == int(row[BOX_COUNT]):
        x, y = row[PERSON_X], row[PERSON_Y]
        reach_x = reach_y = row[PERSON_RADIUS]
    else:
        o = FIRST_BOX + BOX_COLUMNS * body
        x, y = row[o + BOX_X], row[o + BOX_Y]
        c, s = abs(row[o + BOX_COS]), abs(row[o + BOX_SIN])
        reach_x = row[o + BOX_HALF_LENGTH] * c + row[o + BOX_HALF_WIDTH] * s
        reach_y = row[o + BOX_HALF_LENGTH] * s + row[o + BOX_HALF_WIDTH] * c
    side = 1.0 if wall % 2 == 0 else -1.0
    gap_x: float = row[ROOM_HALF_X] - side * x - reach_x
    gap_y: float = row[ROOM_HALF_Y] - side * y - reach_y
    return gap_x if wall < 2 else gap_y


@compiled_exactly
def nearest_wall_gap(row: Row, body: int) -> float:
    """The gap (m) between a box, or the person (number BOX_COUNT), and the nearest wall; infinite without a room."""
    gap = math.inf
    if row[ROOM_HALF_X] > 0.0:
        for wall in range(4):
            gap = min(gap, _wall_gap(row, body, wall))
    return gap


@compiled_exactly
def _passages_form_no_ring(row: Row, radius: float) -> bool:
    """Whether the bodies that are too close to pass between form no ring, which makes all free space connected.

    Boxes and person grown by the radius are convex; if the graph of their overlaps (the walls being one more node)
    has no cycle, their union has no hole and cuts nothing off.
    """
    boxes = int(row[BOX_COUNT])
    group = np.arange(boxes + 2)  # boxes, person, walls
    for i in range(boxes + 1):
        for j in range(i + 4):
            if j >= i:  # the four walls one by one: a body that reaches two of them closes a ring by itself
                if row[ROOM_HALF_X] <= 0.0:
                    break
                gap, other = _wall_gap(row, i, j - i), boxes + 1
            elif i < boxes:
                gap, other = boxes_gap(row, FIRST_BOX + BOX_COLUMNS * i, FIRST_BOX + BOX_COLUMNS * j), j
            else:
                away = box_distance(row, FIRST_BOX + BOX_COLUMNS * j, row[PERSON_X], row[PERSON_Y])
                gap, other = away - row[PERSON_RADIUS], j
            if gap < 2 * radius:
                if group[i] == group[other]:
                    return False
                old = group[i]
                for k in range(boxes + 2):
                    if group[k] == old:
                        group[k] = group[other]
    return True


@compiled_exactly
def reachable(row: Row, radius: float, ground: Ground | None = None) -> bool:
    """Whether a disc of that radius (m) can get from the start to the goal. Both must be free themselves.

    Answers at once where no ring of bodies exists; else a depth-first search on a grid of GRID_M, so a passage less
    than about one cell wider than the disc counts as closed.
    """
    x0, y0 = row[START_X], row[START_Y]
    if ground is not None:
        reach_x = ground.cell * ground.leaps.shape[0]
        reach_y = ground.cell * ground.leaps.shape[1]
    elif _passages_form_no_ring(row, radius):
        return True
    elif row[ROOM_HALF_X] > 0.0:
        reach_x, reach_y = 2 * row[ROOM_HALF_X], 2 * row[ROOM_HALF_Y]
    else:  # a margin around everything, wide enough to walk around the outermost body
        far = max(abs(row[GOAL_X] - x0), abs(row[GOAL_Y] - y0), abs(row[PERSON_X] - x0), abs(row[PERSON_Y] - y0))
        for b in range(int(row[BOX_COUNT])):
            o = FIRST_BOX + BOX_COLUMNS * b
            size = row[o + BOX_HALF_LENGTH] + row[o + BOX_HALF_WIDTH]
            far = max(far, abs(row[o + BOX_X] - x0) + size, abs(row[o + BOX_Y] - y0) + size)
        reach_x = reach_y = far + 4 * radius + row[PERSON_RADIUS]
    cells_x, cells_y = int(reach_x / GRID_M) + 1, int(reach_y / GRID_M) + 1
    columns, lines = 2 * cells_x + 1, 2 * cells_y + 1
    seen = np.zeros((columns, lines), dtype=np.bool_)
    stack = np.empty((columns * lines, 2), dtype=np.int64)
    stack[0, 0], stack[0, 1] = cells_x, cells_y
    seen[cells_x, cells_y] = True
    top = 1
    close = max(row[GOAL_RADIUS], GRID_M)
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        x, y = x0 + (i - cells_x) * GRID_M, y0 + (j - cells_y) * GRID_M
        to_goal_x, to_goal_y = row[GOAL_X] - x, row[GOAL_Y] - y
        if to_goal_x * to_goal_x + to_goal_y * to_goal_y <= close * close:
            return True
        # Steps towards the goal are pushed last, so they are tried first.
        step_x, step_y = (1 if to_goal_x > 0 else -1), (1 if to_goal_y > 0 else -1)
        x_matters = abs(to_goal_x) > abs(to_goal_y)
        for choice in range(4):
            backwards = choice < 2
            along_x = (choice % 2 == 1) == x_matters
            sign = -1 if backwards else 1
            u = i + (sign * step_x if along_x else 0)
            w = j + (0 if along_x else sign * step_y)
            if u < 0 or w < 0 or u >= columns or w >= lines or seen[u, w]:
                continue
            seen[u, w] = True
            nx, ny = x0 + (u - cells_x) * GRID_M, y0 + (w - cells_y) * GRID_M
            if surface_distance(row, nx, ny, ground) < radius:
                continue
            if person_distance(row, nx, ny) < radius + row[PERSON_RADIUS]:
                continue
            stack[top, 0], stack[top, 1] = u, w
            top += 1
    return False


# --- drawing scenes -------------------------------------------------------------------------------------------------


class Spacing(NamedTuple):
    """Room that drawn scenes leave, metres: for the robot at start and goal, between bodies, along the way."""

    robot_radius: float
    spare_at_ends: float
    gap_between_bodies: float
    spare_on_the_way: float


@compiled_exactly
def _tidy(value: float) -> float:
    """Rounded to a micrometre: hides the last-bit differences between mathematics libraries."""
    return math.floor(value * 1e6 + 0.5) / 1e6


@compiled_exactly
def _person_fits(row: Row, spacing: Spacing) -> bool:
    """Whether the person stands clear of start, goal and walls."""
    needed = row[PERSON_RADIUS] + spacing.robot_radius + spacing.spare_at_ends
    if person_distance(row, row[START_X], row[START_Y]) < needed:
        return False
    if person_distance(row, row[GOAL_X], row[GOAL_Y]) < needed:
        return False
    return nearest_wall_gap(row, int(row[BOX_COUNT])) >= spacing.gap_between_bodies


@compiled_exactly
def _box_fits(row: Row, box: int, spacing: Spacing) -> bool:
    """Whether box number `box` keeps its distance from start, goal, person, walls and the boxes before it."""
    o = FIRST_BOX + BOX_COLUMNS * box
    needed = spacing.robot_radius + spacing.spare_at_ends
    if box_distance(row, o, row[START_X], row[START_Y]) < needed:
        return False
    if box_distance(row, o, row[GOAL_X], row[GOAL_Y]) < needed:
        return False
    if box_distance(row, o, row[PERSON_X], row[PERSON_Y]) < row[PERSON_RADIUS] + spacing.gap_between_bodies:
        return False
    if nearest_wall_gap(row, box) < spacing.gap_between_bodies:
        return False
    nearest = math.inf
    for other in range(box):
        nearest = min(nearest, boxes_gap(row, o, FIRST_BOX + BOX_COLUMNS * other))
    return nearest >= spacing.gap_between_bodies


@compiled_exactly
def draw_open_field(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw one open field (ch. 6) into the row from numbers in [0, 1); False if they ran out.

    Start and goal 2-10 m apart around the origin, person at a fraction U(0.3, 0.7) of the way with lateral offset
    N(0, 0.3 m) cut at 0.6 m, four cubes of 0.5-0.8 m side, each 0.8-3 m from the start or the person (ours).
    """
    distance, direction = 2.0 + 8.0 * uniforms[0], (2 * uniforms[1] - 1) * math.pi
    along_x, along_y = math.cos(direction), math.sin(direction)
    row[START_X], row[START_Y] = _tidy(-distance / 2 * along_x), _tidy(-distance / 2 * along_y)
    row[GOAL_X], row[GOAL_Y] = -row[START_X], -row[START_Y]
    row[START_YAW], row[PERSON_YAW] = (2 * uniforms[2] - 1) * math.pi, (2 * uniforms[3] - 1) * math.pi
    row[GOAL_YAW] = direction
    row[ROOM_HALF_X], row[ROOM_HALF_Y], row[BOX_COUNT] = 0.0, 0.0, 4
    used = 4
    while True:
        if used + 3 > uniforms.size:
            return False
        fraction = 0.3 + 0.4 * uniforms[used]
        normal = math.sqrt(-2 * math.log(1 - uniforms[used + 1])) * math.cos(2 * math.pi * uniforms[used + 2])
        lateral, used = 0.3 * normal, used + 3
        row[PERSON_X] = _tidy((fraction - 0.5) * distance * along_x - lateral * along_y)
        row[PERSON_Y] = _tidy((fraction - 0.5) * distance * along_y + lateral * along_x)
        if abs(lateral) <= 0.6 and _person_fits(row, spacing):
            break
    while True:  # the four cubes anew if they close the way
        for box in range(4):
            o = FIRST_BOX + BOX_COLUMNS * box
            while True:
                if used + 5 > uniforms.size:
                    return False
                half = _tidy(0.25 + 0.15 * uniforms[used])
                yaw, away = uniforms[used + 1] * math.pi / 2, 0.8 + 2.2 * uniforms[used + 2]
                bearing, near_start = uniforms[used + 3] * 2 * math.pi, uniforms[used + 4] < 0.5
                used += 5
                row[o + BOX_X] = _tidy((row[START_X] if near_start else row[PERSON_X]) + away * math.cos(bearing))
                row[o + BOX_Y] = _tidy((row[START_Y] if near_start else row[PERSON_Y]) + away * math.sin(bearing))
                row[o + BOX_HALF_LENGTH] = row[o + BOX_HALF_WIDTH] = half
                row[o + BOX_YAW], row[o + BOX_COS], row[o + BOX_SIN] = yaw, math.cos(yaw), math.sin(yaw)
                row[o + BOX_HEIGHT] = 2 * half
                if _box_fits(row, box, spacing):
                    break
        if reachable(row, spacing.robot_radius + spacing.spare_on_the_way):
            return True


@compiled_exactly
def draw_adaptable(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw one scene of chapter 5 into the row from numbers in [0, 1); False if they ran out.

    Open space; start and goal 6-12 m apart around the origin, the person at a fraction U(0.35, 0.65) of the way with
    lateral offset N(0, 0.3 m) cut at 0.6 m, three boxes of 0.3-0.9 m by 0.3-0.9 m, uniform over the way give or take
    3.5 m beside it, 0.36 m from the person's surface at least, so that a robot fits between (sizes and places ours).
    """
    distance, direction = 6.0 + 6.0 * uniforms[0], (2 * uniforms[1] - 1) * math.pi
    along_x, along_y = math.cos(direction), math.sin(direction)
    row[START_X], row[START_Y] = _tidy(-distance / 2 * along_x), _tidy(-distance / 2 * along_y)
    row[GOAL_X], row[GOAL_Y] = -row[START_X], -row[START_Y]
    row[START_YAW], row[PERSON_YAW] = (2 * uniforms[2] - 1) * math.pi, (2 * uniforms[3] - 1) * math.pi
    row[GOAL_YAW] = direction
    row[ROOM_HALF_X], row[ROOM_HALF_Y], row[BOX_COUNT] = 0.0, 0.0, 3
    used = 4
    while True:
        if used + 3 > uniforms.size:
            return False
        fraction = 0.35 + 0.3 * uniforms[used]
        normal = math.sqrt(-2 * math.log(1 - uniforms[used + 1])) * math.cos(2 * math.pi * uniforms[used + 2])
        lateral, used = 0.3 * normal, used + 3
        row[PERSON_X] = _tidy((fraction - 0.5) * distance * along_x - lateral * along_y)
        row[PERSON_Y] = _tidy((fraction - 0.5) * distance * along_y + lateral * along_x)
        if abs(lateral) <= 0.6 and _person_fits(row, spacing):
            break
    while True:  # the three boxes anew if they close the way
        for box in range(3):
            o = FIRST_BOX + BOX_COLUMNS * box
            while True:
                if used + 5 > uniforms.size:
                    return False
                row[o + BOX_HALF_LENGTH] = _tidy(0.15 + 0.3 * uniforms[used])
                row[o + BOX_HALF_WIDTH] = _tidy(0.15 + 0.3 * uniforms[used + 1])
                yaw = uniforms[used + 2] * math.pi
                ahead, aside = (uniforms[used + 3] - 0.5) * distance, 3.5 * (2 * uniforms[used + 4] - 1)
                used += 5
                row[o + BOX_X] = _tidy(ahead * along_x - aside * along_y)
                row[o + BOX_Y] = _tidy(ahead * along_y + aside * along_x)
                row[o + BOX_YAW], row[o + BOX_COS], row[o + BOX_SIN] = yaw, math.cos(yaw), math.sin(yaw)
                row[o + BOX_HEIGHT] = 1.0
                apart = box_distance(row, o, row[PERSON_X], row[PERSON_Y]) - row[PERSON_RADIUS]
                if apart >= 2 * spacing.robot_radius and _box_fits(row, box, spacing):
                    break
        if reachable(row, spacing.robot_radius + spacing.spare_on_the_way):
            return True


@compiled_exactly
def draw_study_room(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw one study room (ch. 7) into the row from numbers in [0, 1); False if they ran out.

    8 x 11 m with walls; start and goal 1-6 m apart, point-symmetric about the centre; person at the centre plus
    N(0, 1 m) per axis; four boxes 0.8 x 1.6 x 1.2 m and four pillars 0.3 x 0.3 m (2 m high, ours), yaw 0 or 90 degrees,
    uniform over the room.
    """
    distance, direction = 1.0 + 5.0 * uniforms[0], (2 * uniforms[1] - 1) * math.pi
    row[START_X] = _tidy(-distance / 2 * math.cos(direction))
    row[START_Y] = _tidy(-distance / 2 * math.sin(direction))
    row[GOAL_X], row[GOAL_Y] = -row[START_X], -row[START_Y]
    row[START_YAW], row[PERSON_YAW] = (2 * uniforms[2] - 1) * math.pi, (2 * uniforms[3] - 1) * math.pi
    row[GOAL_YAW] = direction
    row[ROOM_HALF_X], row[ROOM_HALF_Y], row[BOX_COUNT] = 4.0, 5.5, 8
    used = 4
    while True:
        if used + 2 > uniforms.size:
            return False
        radial, angle = math.sqrt(-2 * math.log(1 - uniforms[used])), 2 * math.pi * uniforms[used + 1]
        used += 2
        row[PERSON_X], row[PERSON_Y] = _tidy(radial * math.cos(angle)), _tidy(radial * math.sin(angle))
        if _person_fits(row, spacing):
            break
    while True:  # all obstacles anew if they close the way
        for box in range(8):
            o = FIRST_BOX + BOX_COLUMNS * box
            while True:
                if used + 3 > uniforms.size:
                    return False
                row[o + BOX_X] = _tidy((2 * uniforms[used] - 1) * row[ROOM_HALF_X])
                row[o + BOX_Y] = _tidy((2 * uniforms[used + 1] - 1) * row[ROOM_HALF_Y])
                yaw = math.pi / 2 if uniforms[used + 2] < 0.5 else 0.0
                used += 3
                large = box < 4
                row[o + BOX_HALF_LENGTH] = 0.4 if large else 0.15
                row[o + BOX_HALF_WIDTH] = 0.8 if large else 0.15
                row[o + BOX_HEIGHT] = 1.2 if large else 2.0
                row[o + BOX_YAW], row[o + BOX_COS], row[o + BOX_SIN] = yaw, math.cos(yaw), math.sin(yaw)
                if _box_fits(row, box, spacing):
                    break
        if reachable(row, spacing.robot_radius + spacing.spare_on_the_way):
            return True


@compiled_exactly
def _draw_places(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw start, goal and person, each uniform over a furnished room, into the row; False if the numbers ran out.

    Start and goal at least 2 m apart (ours), headings uniform, nothing overlapping, the goal within reach.
    """
    half_x, half_y = row[ROOM_HALF_X], row[ROOM_HALF_Y]
    at_ends = spacing.robot_radius + spacing.spare_at_ends
    used = 0
    while used + 9 <= uniforms.size:
        for place in range(3):
            column = (START_X, GOAL_X, PERSON_X)[place]
            row[column] = _tidy((2 * uniforms[used] - 1) * half_x)
            row[column + 1] = _tidy((2 * uniforms[used + 1] - 1) * half_y)
            row[column + 2] = (2 * uniforms[used + 2] - 1) * math.pi
            used += 3
        if (row[START_X] - row[GOAL_X]) ** 2 + (row[START_Y] - row[GOAL_Y]) ** 2 < 4.0:
            continue
        if surface_distance(row, row[START_X], row[START_Y]) < at_ends:
            continue
        if surface_distance(row, row[GOAL_X], row[GOAL_Y]) < at_ends:
            continue
        if surface_distance(row, row[PERSON_X], row[PERSON_Y]) < row[PERSON_RADIUS] + spacing.gap_between_bodies:
            continue
        if _person_fits(row, spacing) and reachable(row, spacing.robot_radius + spacing.spare_on_the_way):
            return True
    return False


@compiled_exactly
def _furnish(row: Row, box: int, x: float, y: float, yaw: float, length: float, width: float, height: float) -> None:
    """Write box number `box` of a room whose furniture stands where it always stands; metres, radians."""
    o = FIRST_BOX + BOX_COLUMNS * box
    row[o + BOX_X], row[o + BOX_Y], row[o + BOX_YAW] = x, y, yaw
    row[o + BOX_HALF_LENGTH], row[o + BOX_HALF_WIDTH], row[o + BOX_HEIGHT] = length / 2, width / 2, height
    row[BOX_COUNT] = box + 1
    finish_row(row)


@compiled_exactly
def draw_corridor(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw places in the corridor of chapter 2: 8 x 3 m (ours), nothing but walls."""
    row[ROOM_HALF_X], row[ROOM_HALF_Y], row[BOX_COUNT] = 4.0, 1.5, 0
    return _draw_places(uniforms, row, spacing)


@compiled_exactly
def draw_room(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw places in the room of chapter 2: 7 x 5 m with couch, table and cupboard (ours)."""
    row[ROOM_HALF_X], row[ROOM_HALF_Y] = 3.5, 2.5
    _furnish(row, 0, -0.6, -2.0, 0.0, 1.9, 0.85, 0.8)
    _furnish(row, 1, 2.2, -1.95, 0.0, 1.2, 0.8, 0.75)
    _furnish(row, 2, 3.2, 1.2, math.pi / 2, 1.6, 0.5, 1.9)
    return _draw_places(uniforms, row, spacing)


@compiled_exactly
def _stands_apart(row: Row, box: int, first: int, spacing: Spacing) -> bool:
    """Whether box number `box` leaves a robot its way around it: 0.3 m at start and goal, 0.6 m to the person, to box
    number `first` and to those before it (first = -1: there is none yet); less at walls.
    """
    o = FIRST_BOX + BOX_COLUMNS * box
    needed = spacing.robot_radius + 0.3
    if box_distance(row, o, row[START_X], row[START_Y]) < needed:
        return False
    if box_distance(row, o, row[GOAL_X], row[GOAL_Y]) < needed:
        return False
    if box_distance(row, o, row[PERSON_X], row[PERSON_Y]) < row[PERSON_RADIUS] + 0.6:
        return False
    if nearest_wall_gap(row, box) < spacing.gap_between_bodies:
        return False
    if first < 0:
        return True
    nearest = boxes_gap(row, o, FIRST_BOX + BOX_COLUMNS * first)
    for other in range(box):
        if other != first:
            nearest = min(nearest, boxes_gap(row, o, FIRST_BOX + BOX_COLUMNS * other))
    return nearest >= 0.6


@compiled_exactly
def draw_explained_room(uniforms: NDArray[np.float64], row: Row, spacing: Spacing) -> bool:
    """Draw one room of chapter 8 into the row from numbers in [0, 1); False if they ran out.

    8 x 7 m with walls (all ours): start and goal 4-6 m apart, so that a robot is still under way after 3 s; it faces
    the goal. Couch, table, cupboard, sideboard and column, in rows with the walls give or take 17 degrees, 0.6 m from
    everything and 0.1 m from walls; one of them, drawn, stands in or near the way: its middle between 0.35 and 0.75
    of the straight line and at most 1 m beside it. The person watches from 1.2 m beside that line or farther, looking
    at its middle.
    """
    row[ROOM_HALF_X], row[ROOM_HALF_Y], row[BOX_COUNT] = 4.0, 3.5, 5
    at_ends = 0.7  # of walls
    used = 0
    while True:
        if used + 4 > uniforms.size:
            return False
        distance, direction = 4.0 + 2.0 * uniforms[used], (2 * uniforms[used + 1] - 1) * math.pi
        along_x, along_y = math.cos(direction), math.sin(direction)
        row[START_X] = _tidy((2 * uniforms[used + 2] - 1) * (row[ROOM_HALF_X] - at_ends))
        row[START_Y] = _tidy((2 * uniforms[used + 3] - 1) * (row[ROOM_HALF_Y] - at_ends))
        row[GOAL_X], row[GOAL_Y] = _tidy(row[START_X] + distance * along_x), _tidy(row[START_Y] + distance * along_y)
        used += 4
        if abs(row[GOAL_X]) <= row[ROOM_HALF_X] - at_ends and abs(row[GOAL_Y]) <= row[ROOM_HALF_Y] - at_ends:
            break
    row[START_YAW], row[GOAL_YAW] = direction, direction
    middle_x, middle_y = (row[START_X] + row[GOAL_X]) / 2, (row[START_Y] + row[GOAL_Y]) / 2
    while True:
        if used + 2 > uniforms.size:
            return False
        row[PERSON_X] = _tidy((2 * uniforms[used] - 1) * row[ROOM_HALF_X])
        row[PERSON_Y] = _tidy((2 * uniforms[used + 1] - 1) * row[ROOM_HALF_Y])
        used += 2
        dx, dy = row[PERSON_X] - row[START_X], row[PERSON_Y] - row[START_Y]
        if abs(dy * along_x - dx * along_y) >= 1.2 and _person_fits(row, spacing):
            break
    row[PERSON_YAW] = _tidy(math.atan2(middle_y - row[PERSON_Y], middle_x - row[PERSON_X]))
    lengths, widths = (1.9, 1.2, 1.2, 1.0, 0.4), (0.85, 0.8, 0.5, 0.5, 0.4)
    heights = (0.8, 0.75, 1.9, 0.9, 2.0)
    while True:  # everything anew if it closes the way
        if used + 1 > uniforms.size:
            return False
        blocking = min(int(5 * uniforms[used]), 4)
        used += 1
        for place in range(5):  # the one in the way first: the others leave it room
            box = blocking if place == 0 else (place - 1 if place - 1 < blocking else place)
            o = FIRST_BOX + BOX_COLUMNS * box
            row[o + BOX_HALF_LENGTH], row[o + BOX_HALF_WIDTH] = lengths[box] / 2, widths[box] / 2
            row[o + BOX_HEIGHT] = heights[box]
            while True:
                if used + 4 > uniforms.size:
                    return False
                if place == 0:
                    share, aside = 0.35 + 0.4 * uniforms[used], 2 * uniforms[used + 1] - 1
                    row[o + BOX_X] = _tidy(row[START_X] + share * distance * along_x - aside * along_y)
                    row[o + BOX_Y] = _tidy(row[START_Y] + share * distance * along_y + aside * along_x)
                else:
                    row[o + BOX_X] = _tidy((2 * uniforms[used] - 1) * row[ROOM_HALF_X])
                    row[o + BOX_Y] = _tidy((2 * uniforms[used + 1] - 1) * row[ROOM_HALF_Y])
                yaw = _tidy(math.pi / 2 * math.floor(2 * uniforms[used + 2]) + 0.3 * (2 * uniforms[used + 3] - 1))
                row[o + BOX_YAW], row[o + BOX_COS], row[o + BOX_SIN] = yaw, math.cos(yaw), math.sin(yaw)
                used += 4
                if _stands_apart(row, box, -1 if place == 0 else blocking, spacing):
                    break
        if reachable(row, spacing.robot_radius + 0.1):
            return True


# --- lidar ----------------------------------------------------------------------------------------------------------


class Beams(NamedTuple):
    """The lidar: directions (3 * beams, 2) float64 unit vectors, three turns long so that no index wraps.

    number, sectors: of a whole turn. seen: of these sectors it sees half to the left of straight ahead and half to the
    right, all where it looks all round. x, y (m), yaw (rad): where it is mounted, in the robot's frame.
    """

    number: int
    sectors: int
    range_m: float
    directions: NDArray[np.float64]
    seen: int
    x: float
    y: float
    yaw: float


@inlined
def _see_face(
    out: NDArray[np.float64],
    beams: Beams,
    bearing: float,
    normal_x: float,
    normal_y: float,
    away: float,
    low: float,
    high: float,
) -> None:
    """Note a flat face in `out` (sectors,), which holds 1 / range: no division per beam.

    The face lies `away` metres off in direction `bearing` (its normal, also given as a unit vector in the robot's
    frame) and spans [low, high] metres to the left of that direction. Along a face the range grows with the angle from
    the normal, so of the beams of one sector that hit it only the one nearest to the normal matters: the minimum over
    all beams, without testing them all.
    """
    if away >= beams.range_m:
        return
    away = max(away, 1e-9)
    widest = math.sqrt(beams.range_m * beams.range_m - away * away)
    low, high = max(low, -widest), min(high, widest)
    if low >= high:
        return
    turn = 2 * math.pi
    bearing -= turn * math.floor(bearing / turn)
    per_radian = beams.number / turn
    # + number: positions in the second turn of the table, so that none is negative
    centre = bearing * per_radian + beams.number
    first = math.ceil(centre + math.atan(low / away) * per_radian)
    last = math.floor(centre + math.atan(high / away) * per_radian)
    if first > last:
        return
    nearest = math.floor(centre + 0.5)
    normal_x, normal_y = normal_x / away, normal_y / away
    per_sector = beams.number // beams.sectors
    first_sector = first // per_sector
    start, index = first_sector * per_sector, first_sector % beams.sectors
    while start <= last:
        beam = min(max(nearest, first, start), last, start + per_sector - 1)
        nearness = beams.directions[beam, 0] * normal_x + beams.directions[beam, 1] * normal_y
        if nearness > out[index]:
            out[index] = nearness
        start += per_sector
        index = index + 1 if index + 1 < beams.sectors else 0


@compiled
def scan(
    row: Row,
    x: float,
    y: float,
    yaw: float,
    beams: Beams,
    out: NDArray[np.float64],
    ground: Ground | None = None,
) -> None:
    """The lidar seen from a pose: out (sectors,) metres, minimum over each sector's beams, at most the range."""
    dx, dy = row[PERSON_X] - x, row[PERSON_Y] - y
    scan_knowing(row, x, y, yaw, math.sqrt(dx * dx + dy * dy), wrap(math.atan2(dy, dx) - yaw), beams, out, ground)


@compiled
def scan_mounted(
    row: Row,
    x: float,
    y: float,
    yaw: float,
    beams: Beams,
    out: NDArray[np.float64],
    ground: Ground | None = None,
) -> None:
    """`scan` from where the lidar is mounted on a robot at that pose."""
    c, s = math.cos(yaw), math.sin(yaw)
    scan(row, x + c * beams.x - s * beams.y, y + s * beams.x + c * beams.y, yaw + beams.yaw, beams, out, ground)


@compiled
def seen_along(row: Row, poses: NDArray[np.float64], beams: Beams, ground: Ground | None = None) -> NDArray[np.float64]:
    """(n, seen) metres: what the lidar of a robot sees at each of the poses (n, 3), in the order of its observation."""
    seen, ranges = np.empty((poses.shape[0], beams.seen)), np.empty(beams.sectors)
    left = (beams.seen + 1) // 2
    for p in range(poses.shape[0]):
        scan_mounted(row, poses[p, 0], poses[p, 1], poses[p, 2], beams, ranges, ground)
        seen[p, :left] = ranges[:left]
        seen[p, left:] = ranges[beams.sectors - (beams.seen - left) :]
    return seen


@compiled
def seen_ranges(
    row: Row, x: float, y: float, yaw: float, beams: Beams, ground: Ground | None = None
) -> NDArray[np.float64]:
    """(seen,) metres: the same at one pose."""
    pose = np.empty((1, 3))
    pose[0, 0], pose[0, 1], pose[0, 2] = x, y, yaw
    seen: NDArray[np.float64] = seen_along(row, pose, beams, ground)[0]
    return seen


class Errors(NamedTuple):
    """What a lidar gets wrong, see `setups.Lidar`: beams, each of them a sector; noise and least, metres; drop_out, a
    share; steps_per_scan, at least 1. Functions take None of one that gets nothing wrong, as of a map."""

    beams: Beams
    noise: float
    drop_out: float
    least: float
    steps_per_scan: float


@compiled_exactly
def _mixed(value: np.uint64) -> np.uint64:
    """64 bits that look drawn at random, from a counter (SplitMix64, Steele et al. 2014)."""
    value += np.uint64(0x9E3779B97F4A7C15)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@compiled_exactly
def _uniform(bits: np.uint64) -> float:
    """A number in (0, 1] of random bits."""
    return (float(bits >> np.uint64(11)) + 1.0) / 9007199254740992.0


@compiled
def scan_with_errors(
    row: Row,
    x: float,
    y: float,
    yaw: float,
    beams: Beams,
    errors: Errors,
    step: int,
    out: NDArray[np.float64],
    ground: Ground | None = None,
) -> None:
    """`scan_mounted` as a lidar measures that gets some wrong: the same in the same step of the same scene."""
    ranges = np.empty(errors.beams.sectors)
    scan_mounted(row, x, y, yaw, errors.beams, ranges, ground)
    seed = _mixed(np.uint64(step))
    for column in (START_X, START_Y, START_YAW, GOAL_X, GOAL_Y):
        seed = _mixed(seed ^ np.uint64(np.int64(math.floor(row[column] * 1e6))))
    per_sector = beams.number // beams.sectors
    for sector in range(beams.sectors):
        nearest = beams.range_m
        for beam in range(sector * per_sector, (sector + 1) * per_sector):
            measured = ranges[beam]
            bits = _mixed(seed + np.uint64(4 * beam))
            if measured >= beams.range_m or _uniform(bits) <= errors.drop_out:
                continue
            if errors.noise > 0.0:  # Box-Muller
                radial = math.sqrt(-2 * math.log(_uniform(_mixed(seed + np.uint64(4 * beam + 1)))))
                angle = 2 * math.pi * _uniform(_mixed(seed + np.uint64(4 * beam + 2)))
                measured = max(measured + errors.noise * radial * math.cos(angle), 0.0)
            if measured >= errors.least:
                nearest = min(nearest, measured)
        out[sector] = nearest


@compiled
def scan_knowing(
    row: Row,
    x: float,
    y: float,
    yaw: float,
    person: float,
    bearing: float,
    beams: Beams,
    out: NDArray[np.float64],
    ground: Ground | None = None,
) -> None:
    """`scan` for a caller who has the person's distance (m) and bearing (rad) already."""
    out[:] = 1 / beams.range_m
    quarter = math.pi / 2
    cr, sr = math.cos(yaw), math.sin(yaw)
    if row[ROOM_HALF_X] > 0.0:
        hx, hy = row[ROOM_HALF_X], row[ROOM_HALF_Y]
        _see_face(out, beams, -yaw, cr, -sr, hx - x, -hy - y, hy - y)
        _see_face(out, beams, quarter - yaw, sr, cr, hy - y, x - hx, x + hx)
        _see_face(out, beams, 2 * quarter - yaw, -cr, sr, hx + x, y - hy, y + hy)
        _see_face(out, beams, 3 * quarter - yaw, -sr, -cr, hy + y, -hx - x, hx - x)
    for b in range(int(row[BOX_COUNT])):
        o = FIRST_BOX + BOX_COLUMNS * b
        dx, dy = x - row[o + BOX_X], y - row[o + BOX_Y]
        length, width = row[o + BOX_HALF_LENGTH], row[o + BOX_HALF_WIDTH]
        too_far = beams.range_m + length + width
        if dx * dx + dy * dy > too_far * too_far:
            continue
        c, s = row[o + BOX_COS], row[o + BOX_SIN]
        along, across = dx * c + dy * s, dy * c - dx * s  # the robot in the box's own frame
        turned = row[o + BOX_YAW] - yaw
        ct, st = c * cr + s * sr, s * cr - c * sr  # the box's own x axis in the robot's frame
        if along > length:
            _see_face(out, beams, turned + 2 * quarter, -ct, -st, along - length, across - width, across + width)
        elif along < -length:
            _see_face(out, beams, turned, ct, st, -length - along, -width - across, width - across)
        if across > width:
            _see_face(out, beams, turned + 3 * quarter, st, -ct, across - width, -length - along, length - along)
        elif across < -width:
            _see_face(out, beams, turned + quarter, -st, ct, -width - across, along - length, along + length)
    _see_person(row[PERSON_RADIUS], person, bearing, beams, out)
    if ground is not None:  # last: what is seen already is as far as it has to look
        _see_ground(ground, x, y, cr, sr, beams, out)
    for sector in range(beams.sectors):
        out[sector] = 1 / out[sector]


@inlined
def _see_person(radius: float, person: float, bearing: float, beams: Beams, out: NDArray[np.float64]) -> None:
    """Note the person's circle in `out` likewise; in each sector the beam nearest to its centre sees it closest."""
    if person >= beams.range_m + radius or person <= radius:
        return
    half = math.asin(radius / person)
    per_radian = beams.number / (2 * math.pi)
    centre = bearing * per_radian + beams.number
    first, last = math.ceil(centre - half * per_radian), math.floor(centre + half * per_radian)
    nearest = math.floor(centre + 0.5)
    local_x, local_y = person * math.cos(bearing), person * math.sin(bearing)
    per_sector = beams.number // beams.sectors
    for sector in range(first // per_sector, last // per_sector + 1):
        beam = min(max(nearest, first, sector * per_sector), last, sector * per_sector + per_sector - 1)
        along = beams.directions[beam, 0] * local_x + beams.directions[beam, 1] * local_y
        inside = along * along - person * person + radius * radius
        if inside >= 0.0:
            index = sector % beams.sectors
            out[index] = max(out[index], 1 / (along - math.sqrt(inside)))


@inlined
def _onward(leaps: NDArray[np.int8], x: float, y: float, c: float, s: float, at: float) -> float:
    """How far a ray from x, y along (c, s) may go on from `at`, all in cells: by a leap where the next cells are free,
    else into the next cell; 0 where it is in an occupied one."""
    across, up = x + at * c, y + at * s
    i, j = int(across), int(up)
    leap = leaps[np.uint32(i), np.uint32(j)]
    if leap >= 1.0:
        return float(leap)
    if leap < 0.0:
        return 0.0
    to_side = (i + (1 if c > 0.0 else 0) - across) / c if c != 0.0 else math.inf
    to_line = (j + (1 if s > 0.0 else 0) - up) / s if s != 0.0 else math.inf
    return min(to_side, to_line) + 1e-6


@inlined
def _see_ground(
    ground: Ground, x: float, y: float, cr: float, sr: float, beams: Beams, out: NDArray[np.float64]
) -> None:
    """Note the map in `out` (1 / range) seen from x, y heading along (cr, sr). All lengths in cells.

    A sector's beams leap together, as a cone, until something is near; then two by two, each no farther than what is
    nearest so far, the outermost two first, since along a wall one of them is nearest. Two at once, because a ray
    waits for the cell that it looks up: a scan takes a seventh less. x, y lie on the map, whose edge is occupied: no
    ray leaves it.
    """
    leaps, per_cell = ground.leaps, 1 / ground.cell
    x, y = (x - ground.x) * per_cell, (y - ground.y) * per_cell
    if x < 0.0 or y < 0.0 or x >= leaps.shape[0] or y >= leaps.shape[1]:
        return
    per_sector = beams.number // beams.sectors
    spread = 2 * math.sin(per_sector / 2 * math.pi / beams.number)  # of its beams, for each cell of the middle one
    for sector in range(beams.sectors):
        limit = per_cell / out[sector]
        first = sector * per_sector
        middle = first + per_sector // 2
        c = beams.directions[middle, 0] * cr - beams.directions[middle, 1] * sr
        s = beams.directions[middle, 0] * sr + beams.directions[middle, 1] * cr
        begin = 0.0
        while begin < limit:
            leap = leaps[np.uint32(int(x + begin * c)), np.uint32(int(y + begin * s))] - begin * spread
            if leap < 1.0:
                break
            begin += leap
        for place in range((per_sector + 1) // 2):
            beam, other = first + place, first + per_sector - 1 - place
            c = beams.directions[beam, 0] * cr - beams.directions[beam, 1] * sr
            s = beams.directions[beam, 0] * sr + beams.directions[beam, 1] * cr
            c_other = beams.directions[other, 0] * cr - beams.directions[other, 1] * sr
            s_other = beams.directions[other, 0] * sr + beams.directions[other, 1] * cr
            at, at_other = begin, begin if other > beam else limit
            while at < limit and at_other < limit:
                further = _onward(leaps, x, y, c, s, at)
                further_other = _onward(leaps, x, y, c_other, s_other, at_other)
                if further == 0.0:
                    limit = min(limit, at)
                if further_other == 0.0:
                    limit = min(limit, at_other)
                at += further
                at_other += further_other
            while at < limit:
                further = _onward(leaps, x, y, c, s, at)
                if further == 0.0:
                    limit = at
                at += further
            while at_other < limit:
                further = _onward(leaps, x, y, c_other, s_other, at_other)
                if further == 0.0:
                    limit = at_other
                at_other += further
        out[sector] = max(out[sector], per_cell / max(limit, 1e-9))


# --- driving --------------------------------------------------------------------------------------------------------


class Rules(NamedTuple):
    """Numbers of a setup that a step needs; SI units. See setups.py for what they mean."""

    dt: float
    robot_radius: float
    v_min: float
    v_max: float
    w_max: float
    max_steps: int
    loop_age: int
    distance_scale: float
    with_velocity: bool
    goal: float
    collision: float
    timeout: float
    self_intersection: float
    time_per_step: float
    jerk_weight: float
    progress_weight: float
    solids: int  # > 0: that many walls and boxes are observed instead of the lidar
    with_person: bool
    near: float  # reward of a step that ends with the robot's centre nearer than near_m to anything
    near_m: float
    v_change: float  # m/s and rad/s that a command may differ from the one before; infinite: as it likes
    w_change: float


class State(NamedTuple):
    """Where every environment stands. n environments; commands are (v m/s, w rad/s), newest first.

    obstacle_clearance and human_distance are those of the present pose, float64 for the collision search.
    """

    rows: Rows  # (n, columns)
    poses: NDArray[np.float64]  # (n, 3)
    paths: NDArray[np.float64]  # (n, max_steps + 1, 2)
    steps: NDArray[np.int32]  # (n,)
    finished: NDArray[np.bool_]  # (n,) ended and not restarted: steps leave it alone
    commands: NDArray[np.float64]  # (n, 2, 2) of the last two steps
    largest_jerk: NDArray[np.float64]  # (n,) largest squared norm so far
    obstacle_clearance: NDArray[np.float64]  # (n,)
    human_distance: NDArray[np.float64]  # (n,)


class Results(NamedTuple):
    """What a step leaves for the caller; the last six describe the episode that the step belonged to."""

    next_observations: NDArray[np.float32]  # (n, obs)
    rewards: NDArray[np.float32]
    dones: NDArray[np.bool_]
    outcomes: NDArray[np.int8]
    human_distance: NDArray[np.float32]
    obstacle_clearance: NDArray[np.float32]
    steps: NDArray[np.int32]
    min_human_distance: NDArray[np.float32]
    min_clearance: NDArray[np.float32]
    path_length: NDArray[np.float32]
    accumulated_angle: NDArray[np.float32]
    self_intersections: NDArray[np.int32]


@compiled
def arc(x: float, y: float, yaw: float, travel: float, turn: float) -> tuple[float, float]:
    """Where the robot is after driving `travel` metres while turning by `turn` radians at a constant rate."""
    half = turn / 2
    chord = travel * (math.sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half)


@compiled
def drive(
    row: Row,
    x: float,
    y: float,
    yaw: float,
    travel: float,
    turn: float,
    radius: float,
    free: float,
    ground: Ground | None = None,
) -> tuple[float, float, float, float, float, bool]:
    """Drive one arc, stopping at the first contact: (x, y, yaw, surface distance, person distance, hit).

    `free` is the clearance of the robot's body at the beginning: it may move that far without touching anything, then
    look again. So nothing is tunnelled, however fast it drives; the stop lies within SMALLEST_ADVANCE_M of contact.
    """
    done = 0.0
    here_x, here_y = x, y
    surface, person = 0.0, 0.0
    looked = False
    while not looked or done < travel:
        ahead = min(travel, done + max(free, SMALLEST_ADVANCE_M))
        part = turn * (ahead / travel) if travel > 0.0 else turn
        new_x, new_y = arc(x, y, yaw, ahead, part)
        new_surface, new_person = surface_distance(row, new_x, new_y, ground), person_distance(row, new_x, new_y)
        free = min(new_surface, new_person - row[PERSON_RADIUS]) - radius
        if free < -TOUCH_M and ahead > 0.0:
            if not looked:
                surface, person = surface_distance(row, x, y, ground), person_distance(row, x, y)
            stopped_turn = turn * (done / travel)
            return here_x, here_y, wrap(yaw + stopped_turn), surface, person, True
        here_x, here_y, surface, person = new_x, new_y, new_surface, new_person
        done, looked = ahead, True
    return here_x, here_y, wrap(yaw + turn), surface, person, False


@compiled
def drive_outline(
    row: Row,
    x: float,
    y: float,
    yaw: float,
    travel: float,
    turn: float,
    radius: float,
    outline: NDArray[np.float64],
    free: float,
    ground: Ground | None = None,
) -> tuple[float, float, float, float, bool]:
    """`drive` of a robot whose body is a polygon: (x, y, yaw, gap to the nearest surface, hit). radius: of the circle
    around it: no part of the body moves farther than `travel` and what that circle turns."""
    longest = travel + radius * abs(turn)
    done, here_x, here_y, here_yaw = 0.0, x, y, yaw
    surface = math.nan  # until somewhere was looked
    while done < 1.0:
        part = min(1.0, done + max(free, SMALLEST_ADVANCE_M) / longest) if longest > 0.0 else 1.0
        new_x, new_y = arc(x, y, yaw, travel * part, turn * part)
        new_yaw = yaw + turn * part
        corners = body_corners(outline, new_x, new_y, new_yaw)
        new_surface = body_surface_gap(row, corners, ground)
        free = min(new_surface, body_person_gap(row, corners))
        if free < -TOUCH_M:
            if done == 0.0:
                surface = body_surface_gap(row, body_corners(outline, x, y, yaw), ground)
            return here_x, here_y, wrap(here_yaw), surface, True
        done, here_x, here_y, here_yaw, surface = part, new_x, new_y, new_yaw, new_surface
    return here_x, here_y, wrap(here_yaw), surface, False


@compiled
def crosses_itself(path: NDArray[np.float64], steps: int, age: int, longest: float) -> bool:
    """Whether the newest segment of a path (positions 0..steps) crosses a segment more than `age` steps older.

    No segment is longer than `longest` metres, so a block of them that begins far away is skipped unseen.
    """
    ax, ay, bx, by = path[steps - 1, 0], path[steps - 1, 1], path[steps, 0], path[steps, 1]
    ex, ey = bx - ax, by - ay
    if ex * ex + ey * ey < 1e-12:
        return False
    block = 16
    reach = (block + 1) * longest
    for begin in range(0, steps - age - 1, block):
        px, py = path[begin, 0] - ax, path[begin, 1] - ay
        if px * px + py * py > reach * reach:
            continue
        was_left = ex * py - ey * px >= 0.0
        for k in range(begin + 1, min(begin + block + 1, steps - age)):
            dx, dy = path[k, 0], path[k, 1]
            is_left = ex * (dy - ay) - ey * (dx - ax) >= 0.0
            if is_left != was_left:
                cx, cy = path[k - 1, 0], path[k - 1, 1]
                fx, fy = dx - cx, dy - cy
                # On a straight line rounding alone decides the sides, so parallel segments never cross.
                parallel = abs(ex * fy - ey * fx) <= 1e-9 * (ex * ex + ey * ey)
                a_is_left = fx * (ay - cy) - fy * (ax - cx) >= 0.0
                b_is_left = fx * (by - cy) - fy * (bx - cx) >= 0.0
                if a_is_left != b_is_left and not parallel:
                    return True
            was_left = is_left
    return False


@compiled
def _note_polar(dx: float, dy: float, c: float, s: float, scale: float, out: NDArray[np.float32], at: int) -> None:
    """Write length / scale, cosine and sine of the bearing of an offset (m) for a robot heading along (c, s)."""
    length = max(math.sqrt(dx * dx + dy * dy), 1e-9)
    out[at] = length / scale
    out[at + 1] = (dx * c + dy * s) / length
    out[at + 2] = (dy * c - dx * s) / length


@compiled
def observe_solids(row: Row, pose: NDArray[np.float64], scale: float, out: NDArray[np.float32]) -> None:
    """Write the observation of chapter 2 (`Setup.solids`): person, goal bearing, closest point of walls and boxes."""
    x, y, yaw = pose[0], pose[1], pose[2]
    c, s = math.cos(yaw), math.sin(yaw)
    _note_polar(row[GOAL_X] - x, row[GOAL_Y] - y, c, s, scale, out, 2)  # its distance is overwritten: not observed
    goal_cos, goal_sin = out[3], out[4]
    _note_polar(row[PERSON_X] - x, row[PERSON_Y] - y, c, s, scale, out, 0)
    out[3], out[4] = goal_cos, goal_sin
    out[5], out[6] = math.cos(row[PERSON_YAW] - yaw), math.sin(row[PERSON_YAW] - yaw)
    at = 7
    if row[ROOM_HALF_X] > 0.0:
        _note_polar(row[ROOM_HALF_X] - x, 0.0, c, s, scale, out, at)
        _note_polar(-row[ROOM_HALF_X] - x, 0.0, c, s, scale, out, at + 3)
        _note_polar(0.0, row[ROOM_HALF_Y] - y, c, s, scale, out, at + 6)
        _note_polar(0.0, -row[ROOM_HALF_Y] - y, c, s, scale, out, at + 9)
        at += 12
    for b in range(int(row[BOX_COUNT])):
        o = FIRST_BOX + BOX_COLUMNS * b
        dx, dy = x - row[o + BOX_X], y - row[o + BOX_Y]
        bc, bs = row[o + BOX_COS], row[o + BOX_SIN]
        along, across = dx * bc + dy * bs, dy * bc - dx * bs
        near_along = min(max(along, -row[o + BOX_HALF_LENGTH]), row[o + BOX_HALF_LENGTH]) - along
        near_across = min(max(across, -row[o + BOX_HALF_WIDTH]), row[o + BOX_HALF_WIDTH]) - across
        _note_polar(near_along * bc - near_across * bs, near_along * bs + near_across * bc, c, s, scale, out, at)
        at += 3


@compiled
def observe(
    row: Row,
    pose: NDArray[np.float64],
    v: float,
    w: float,
    rules: Rules,
    beams: Beams,
    scratch: NDArray[np.float64],
    out: NDArray[np.float32],
    ground: Ground | None = None,
    errors: Errors | None = None,
    step: int = 0,
) -> None:
    """Write the observation of a pose, in the order and scale of the setup's layout. errors, step: where a scan has
    some, and is not a new one in every step; else `out` keeps the one it has."""
    if rules.solids > 0:
        observe_solids(row, pose, rules.distance_scale, out)
        return
    x, y, yaw = pose[0], pose[1], pose[2]
    dx, dy = row[GOAL_X] - x, row[GOAL_Y] - y
    out[0] = math.sqrt(dx * dx + dy * dy) / rules.distance_scale
    out[1] = wrap(math.atan2(dy, dx) - yaw) / math.pi
    dx, dy = row[PERSON_X] - x, row[PERSON_Y] - y
    person, bearing = math.sqrt(dx * dx + dy * dy), wrap(math.atan2(dy, dx) - yaw)
    first = 2
    if rules.with_person:
        out[2] = person / rules.distance_scale
        out[3] = bearing / math.pi
        first = 4
    if rules.with_velocity:
        out[first] = v / rules.v_max
        out[first + 1] = w / rules.w_max
        first += 2
    if errors is not None:
        if step > 0 and math.floor(step / errors.steps_per_scan) == math.floor((step - 1) / errors.steps_per_scan):
            return
        scan_with_errors(row, x, y, yaw, beams, errors, step, scratch, ground)
    elif beams.x != 0.0 or beams.y != 0.0 or beams.yaw != 0.0:
        scan_mounted(row, x, y, yaw, beams, scratch, ground)
    else:
        scan_knowing(row, x, y, yaw, person, bearing, beams, scratch, ground)
    blind = beams.sectors - beams.seen
    for k in range(beams.seen):
        out[first + k] = scratch[k if 2 * k < beams.seen else k + blind] / beams.range_m


@compiled
def jerk_penalty(
    commands: NDArray[np.float64], largest_jerk: NDArray[np.float64], i: int, v: float, w: float, weight: float
) -> float:
    """-weight |j|^2 / max |j|^2 so far, j = (a_t - 2 a_(t-1) + a_(t-2)) f^2 (ch. 7); f cancels; a = 0 before.

    Updates the largest jerk and the command history of environment i. a is the command in m/s and rad/s.
    """
    jerk_v = v - 2 * commands[i, 0, 0] + commands[i, 1, 0]
    jerk_w = w - 2 * commands[i, 0, 1] + commands[i, 1, 1]
    squared = jerk_v * jerk_v + jerk_w * jerk_w
    commands[i, 1, 0], commands[i, 1, 1] = commands[i, 0, 0], commands[i, 0, 1]
    commands[i, 0, 0], commands[i, 0, 1] = v, w
    largest = max(largest_jerk[i], squared)
    largest_jerk[i] = largest
    return -weight * squared / largest if largest > 0.0 else 0.0


@inlined
def _step_one(
    i: int,
    state: State,
    results: Results,
    actions: NDArray[np.float32],
    rules: Rules,
    beams: Beams,
    scratch: NDArray[np.float64],
    ground: Ground | None,
    outline: NDArray[np.float64] | None,
    errors: Errors | None,
) -> None:
    """One control step of environment i, which has not finished."""
    row, pose = state.rows[i], state.poses[i]
    forward, turning = min(max(actions[i, 0], -1.0), 1.0), min(max(actions[i, 1], -1.0), 1.0)
    v = (forward + 1) / 2 * (rules.v_max - rules.v_min) + rules.v_min
    w = turning * rules.w_max
    v = min(max(v, state.commands[i, 0, 0] - rules.v_change), state.commands[i, 0, 0] + rules.v_change)
    w = min(max(w, state.commands[i, 0, 1] - rules.w_change), state.commands[i, 0, 1] + rules.w_change)
    x, y, yaw = pose[0], pose[1], pose[2]
    goal_before = math.sqrt((row[GOAL_X] - x) ** 2 + (row[GOAL_Y] - y) ** 2)
    free = min(state.obstacle_clearance[i], state.human_distance[i] - row[PERSON_RADIUS] - rules.robot_radius)
    if outline is not None:
        free = max(free, 0.0)  # the circle around it may overlap what its body does not
        pose[0], pose[1], pose[2], clearance, hit = drive_outline(
            row, x, y, yaw, v * rules.dt, w * rules.dt, rules.robot_radius, outline, free, ground
        )
        surface = surface_distance(row, pose[0], pose[1], ground)
        person = person_distance(row, pose[0], pose[1])
    else:
        pose[0], pose[1], pose[2], surface, person, hit = drive(
            row, x, y, yaw, v * rules.dt, w * rules.dt, rules.robot_radius, free, ground
        )
        clearance = surface - rules.robot_radius
    state.obstacle_clearance[i], state.human_distance[i] = clearance, person
    state.steps[i] += 1
    steps = state.steps[i]
    state.paths[i, steps, 0], state.paths[i, steps, 1] = pose[0], pose[1]

    reward = rules.time_per_step + jerk_penalty(state.commands, state.largest_jerk, i, v, w, rules.jerk_weight)
    goal_after = math.sqrt((row[GOAL_X] - pose[0]) ** 2 + (row[GOAL_Y] - pose[1]) ** 2)
    reward += rules.progress_weight * (goal_before - goal_after)
    crossed = crosses_itself(state.paths[i], steps, rules.loop_age, rules.v_max * rules.dt)
    if crossed:
        reward += rules.self_intersection
    if min(surface, person - row[PERSON_RADIUS]) < rules.near_m:
        reward += rules.near
    outcome = RUNNING
    if hit:
        outcome = COLLISION
        reward += rules.collision
    elif goal_after <= row[GOAL_RADIUS]:
        outcome = SUCCESS
        reward += rules.goal
    elif steps >= rules.max_steps:
        outcome = TIMEOUT
        reward += rules.timeout

    first = steps == 1
    travelled = math.sqrt((pose[0] - x) ** 2 + (pose[1] - y) ** 2)
    turned = abs(wrap(pose[2] - yaw))
    results.rewards[i] = reward
    results.dones[i] = state.finished[i] = outcome != RUNNING
    results.outcomes[i] = outcome
    results.human_distance[i] = person
    results.obstacle_clearance[i] = clearance
    results.steps[i] = steps
    # The episode's own values begin anew with its first step: until then they tell of the episode before.
    if first:
        if outline is not None:
            start_surface = body_surface_gap(row, body_corners(outline, x, y, yaw), ground)
        else:
            start_surface = surface_distance(row, x, y, ground) - rules.robot_radius
        results.min_human_distance[i] = min(person_distance(row, x, y), person)
        results.min_clearance[i] = min(start_surface, clearance)
        results.path_length[i] = travelled
        results.accumulated_angle[i] = turned
        results.self_intersections[i] = 0
    else:
        results.min_human_distance[i] = min(results.min_human_distance[i], person)
        results.min_clearance[i] = min(results.min_clearance[i], clearance)
        results.path_length[i] += travelled
        results.accumulated_angle[i] += turned
    if crossed:
        results.self_intersections[i] += 1
    observe(row, pose, v, w, rules, beams, scratch, results.next_observations[i], ground, errors, steps)


@compiled
def step_all(
    state: State,
    results: Results,
    actions: NDArray[np.float32],
    rules: Rules,
    beams: Beams,
    ground: Ground | None = None,
    outline: NDArray[np.float64] | None = None,
    errors: Errors | None = None,
) -> None:
    """One control step of every environment, on one thread."""
    scratch = np.empty(beams.sectors)
    for i in range(state.poses.shape[0]):
        if state.finished[i]:
            results.rewards[i] = 0.0
        else:
            _step_one(i, state, results, actions, rules, beams, scratch, ground, outline, errors)


@compiled
def _step_unless_finished(
    i: int,
    state: State,
    results: Results,
    actions: NDArray[np.float32],
    rules: Rules,
    beams: Beams,
    ground: Ground | None,
    outline: NDArray[np.float64] | None,
    errors: Errors | None,
) -> None:
    if state.finished[i]:
        results.rewards[i] = 0.0
    else:
        _step_one(i, state, results, actions, rules, beams, np.empty(beams.sectors), ground, outline, errors)


@compiled_parallel
def step_all_parallel(
    state: State,
    results: Results,
    actions: NDArray[np.float32],
    rules: Rules,
    beams: Beams,
    ground: Ground | None = None,
    outline: NDArray[np.float64] | None = None,
    errors: Errors | None = None,
) -> None:
    """One control step of every environment, on all of Numba's threads."""
    for i in numba.prange(state.poses.shape[0]):
        # Everything in a called function: Numba 0.68 loses a parallel loop's own writes to arrays inside tuples.
        _step_unless_finished(i, state, results, actions, rules, beams, ground, outline, errors)


@compiled
def start_episodes(
    which: NDArray[np.int64],
    state: State,
    observations: NDArray[np.float32],
    rules: Rules,
    beams: Beams,
    ground: Ground | None = None,
    outline: NDArray[np.float64] | None = None,
    errors: Errors | None = None,
) -> None:
    """Put the named environments at the start of the scenes in their rows and observe them."""
    scratch = np.empty(beams.sectors)
    for i in which:
        row = state.rows[i]
        for k in range(3):
            state.poses[i, k] = row[START_X + k]
        state.paths[i, 0, 0], state.paths[i, 0, 1] = row[START_X], row[START_Y]
        state.steps[i] = 0
        state.finished[i] = False
        state.commands[i] = 0.0
        state.largest_jerk[i] = 0.0
        if outline is not None:
            corners = body_corners(outline, row[START_X], row[START_Y], row[START_YAW])
            state.obstacle_clearance[i] = body_surface_gap(row, corners, ground)
        else:
            state.obstacle_clearance[i] = surface_distance(row, row[START_X], row[START_Y], ground) - rules.robot_radius
        state.human_distance[i] = person_distance(row, row[START_X], row[START_Y])
        observe(row, state.poses[i], 0.0, 0.0, rules, beams, scratch, observations[i], ground, errors)


@compiled
def path_area(path: NDArray[np.float64], goal_x: float, goal_y: float) -> float:
    """Area (m^2) between a path (points, 2) and the straight line from its first point to the goal.

    Lobes on either side of the line count with their absolute areas; the last is closed by the perpendicular from
    the path's end onto the line. 0 where start and goal coincide.
    """
    ux, uy = goal_x - path[0, 0], goal_y - path[0, 1]
    length = math.sqrt(ux * ux + uy * uy)
    if length < 1e-9:
        return 0.0
    ux, uy = ux / length, uy / length
    total, lobe = 0.0, 0.0
    along, aside = 0.0, 0.0
    for k in range(1, path.shape[0]):
        dx, dy = path[k, 0] - path[0, 0], path[k, 1] - path[0, 1]
        next_along, next_aside = dx * ux + dy * uy, dy * ux - dx * uy
        if aside * next_aside < 0.0:
            crossing = along + (next_along - along) * aside / (aside - next_aside)
            total += abs(lobe + (crossing - along) * aside / 2)
            lobe = (next_along - crossing) * next_aside / 2
        else:
            lobe += (next_along - along) * (aside + next_aside) / 2
            if next_aside == 0.0:
                total, lobe = total + abs(lobe), 0.0
        along, aside = next_along, next_aside
    return total + abs(lobe)


# --- planning -------------------------------------------------------------------------------------------------------


@compiled
def mark_free(
    row: Row, places: NDArray[np.float64], radius: float, free: NDArray[np.bool_], ground: Ground | None = None
) -> None:
    """Write into `free` (columns, lines) where of the places (columns, lines, 2) a disc of that radius (m) fits."""
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            x, y = places[i, j, 0], places[i, j, 1]
            apart = person_distance(row, x, y) - row[PERSON_RADIUS]
            free[i, j] = min(apart, surface_distance(row, x, y, ground)) >= radius


@compiled
def way_costs(
    row: Row,
    low_x: float,
    low_y: float,
    cell: float,
    radius: float,
    wanted: float,
    blocked: float,
    costs: NDArray[np.float32],
    ground: Ground | None = None,
) -> None:
    """Write into `costs` (columns, lines), cells of a grid with that corner (m), what it costs to drive through them: 1
    where a body of that radius (m) has the room that is wanted beside it (m), up to 3 with less, `blocked` without any.
    """
    for i in range(costs.shape[0]):
        x = low_x + (i + 0.5) * cell
        for j in range(costs.shape[1]):
            y = low_y + (j + 0.5) * cell
            apart = math.inf if ground is None else ground_distance(ground, x, y)
            if row[ROOM_HALF_X] > 0.0:
                apart = min(apart, row[ROOM_HALF_X] - abs(x), row[ROOM_HALF_Y] - abs(y))
            costs[i, j] = min(apart, person_distance(row, x, y) - row[PERSON_RADIUS])
    for b in range(int(row[BOX_COUNT])):  # each in the cells near it: a look at all boxes from all cells takes longest
        o = FIRST_BOX + BOX_COLUMNS * b
        far = math.sqrt(row[o + BOX_HALF_LENGTH] ** 2 + row[o + BOX_HALF_WIDTH] ** 2) + radius + wanted
        left, right = (row[o + BOX_X] - far - low_x) / cell, (row[o + BOX_X] + far - low_x) / cell + 1.0
        under, over = (row[o + BOX_Y] - far - low_y) / cell, (row[o + BOX_Y] + far - low_y) / cell + 1.0
        for i in range(max(int(left), 0), min(int(right), costs.shape[0])):
            for j in range(max(int(under), 0), min(int(over), costs.shape[1])):
                apart = box_distance(row, o, low_x + (i + 0.5) * cell, low_y + (j + 0.5) * cell)
                costs[i, j] = min(costs[i, j], apart)
    for i in range(costs.shape[0]):
        for j in range(costs.shape[1]):
            spare = costs[i, j] - radius
            costs[i, j] = blocked if spare < 0.0 else 1.0 + 2.0 * max(wanted - spare, 0.0) / wanted


@compiled
def best_command(
    speeds: NDArray[np.float64],
    turns: NDArray[np.float64],
    goal: NDArray[np.float64],
    points: NDArray[np.float64],
    steps: int,
    dt: float,
    radius: float,
    enough: float,
    weights: NDArray[np.float64],
) -> tuple[float, float]:
    """Of all speeds (m/s) and turn rates (rad/s): the command of the highest score, for the dynamic window approach.

    goal (2,) and points (n, 2) of a lidar scan, metres, in the robot's frame. Each command is kept up for `steps` of
    `dt` seconds; more clearance than `enough` (m) of a body of that `radius` earns nothing. weights (3,): of heading,
    clearance and speed. Where every arc hits something, the one that hits latest.
    """
    best, chosen_v, chosen_w = -1e9, speeds[0], turns[0]
    for v in speeds:
        for w in turns:
            clearance, x, y, free_steps = enough, 0.0, 0.0, steps
            for t in range(1, steps + 1):
                x, y = arc(0.0, 0.0, 0.0, v * t * dt, w * t * dt)
                nearest = 1e9
                for p in range(points.shape[0]):
                    dx, dy = points[p, 0] - x, points[p, 1] - y
                    nearest = min(nearest, dx * dx + dy * dy)
                clearance = min(clearance, math.sqrt(nearest) - radius)
                if clearance < 0.0:
                    free_steps = t
                    break
                if (goal[0] - x) ** 2 + (goal[1] - y) ** 2 < 0.04:
                    break
            if clearance < 0.0:
                score = -1e6 + free_steps
            else:
                bearing = wrap(math.atan2(goal[1] - y, goal[0] - x) - w * steps * dt)
                score = (
                    weights[0] * (1.0 - abs(bearing) / math.pi)
                    + weights[1] * clearance / enough
                    + weights[2] * v / speeds[-1]
                )
            if score > best:
                best, chosen_v, chosen_w = score, v, w
    return chosen_v, chosen_w
