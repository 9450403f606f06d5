"""The compiled depth camera: depths along its axis of upright boxes and cylinders, capsules and the floor.

Plain arrays only; what furniture and people are made of stands in `depth_shapes.py`, the camera in `depth_camera.py`.

A pinhole that looks level makes every column of the picture one vertical plane through the world. Rays are followed by
their depth d along the camera's axis: at d, all pixels of a column are above the same point of the floor. So the span
of d that lies inside an upright body is found once per column, and its rows follow from the body's heights. Nothing is
seen behind a wall that nothing overtops: `hidden` (columns,) is the depth of the nearest of those drawn so far.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Frames = NDArray[np.float32]

BOX_NUMBERS = 8  # x, y, cosine and sine of the yaw, half length, half width, lowest and highest z
CYLINDER_NUMBERS = 5  # x, y, radius, lowest and highest z
CAPSULE_NUMBERS = 7  # both ends of the axis, radius
NEAREST_M = 1e-3

Compiled = TypeVar("Compiled")


def _compiled(function: Compiled) -> Compiled:
    return cast(
        Compiled,
        numba.njit(cache=True, fastmath={"nsz", "arcp", "contract", "afn", "reassoc"}, error_model="numpy")(function),
    )


class Lens(NamedTuple):
    """What the pictures are taken with. left (columns,), up (rows,): tangents of the pixels' angles to the axis."""

    left: Doubles
    up: Doubles
    focal: float  # pixels
    height: float  # of the camera above the floor, m
    ahead: float  # of the robot's centre, m
    range_m: float


@_compiled
def _upright(column: Any, lens: Lens, near: float, far: float, low: float, high: float) -> None:
    """Draw into one column what lies between depths near and far from height low to high, where nothing is nearer."""
    rows = column.shape[0]
    middle = rows / 2 - 0.5
    below, above = low - lens.height, high - lens.height
    if near > NEAREST_M:
        first = max(0, math.ceil(middle - lens.focal * above / near))
        last = min(rows - 1, math.floor(middle - lens.focal * below / near))
        for v in range(first, last + 1):
            if near < column[v]:
                column[v] = near
    near = max(near, NEAREST_M)
    if above < 0.0:  # its top is seen
        first = max(0, math.ceil(middle - lens.focal * above / far))
        last = min(rows - 1, math.floor(middle - lens.focal * above / near))
        for v in range(first, last + 1):
            depth = above / lens.up[v]
            if 0.0 < depth < column[v]:
                column[v] = depth
    if below > 0.0:  # its underside is seen
        first = max(0, math.ceil(middle - lens.focal * below / near))
        last = min(rows - 1, math.floor(middle - lens.focal * below / far))
        for v in range(first, last + 1):
            depth = below / lens.up[v]
            if 0.0 < depth < column[v]:
                column[v] = depth


@_compiled
def _columns(lens: Lens, low: float, high: float) -> tuple[int, int]:
    """First and last column between two tangents to the left of the axis."""
    columns = lens.left.shape[0]
    middle = columns / 2 - 0.5
    first = max(0.0, min(float(columns), math.ceil(middle - lens.focal * high - 1e-9)))
    last = max(-1.0, min(columns - 1.0, math.floor(middle - lens.focal * low + 1e-9)))
    return int(first), int(last)


@_compiled
def _draw_box(
    picture: Any, hidden: Doubles, tallest: float, lens: Lens, box: Doubles, x: float, y: float, c: float, s: float
) -> None:
    dx, dy = box[0] - x, box[1] - y
    ahead, aside = dx * c + dy * s, dy * c - dx * s
    reach = math.sqrt(box[4] * box[4] + box[5] * box[5])
    if ahead + reach < 0.0 or ahead - reach > lens.range_m:
        return
    turned_c, turned_s = box[2] * c + box[3] * s, box[3] * c - box[2] * s  # the box's own x axis, seen by the camera
    low, high, whole = math.inf, -math.inf, False
    for corner in range(4):
        a = box[4] if corner < 2 else -box[4]
        b = box[5] if corner % 2 == 0 else -box[5]
        at = ahead + a * turned_c - b * turned_s
        if at < 0.01:
            whole = True
            break
        left = (aside + a * turned_s + b * turned_c) / at
        low, high = min(low, left), max(high, left)
    first, last = (0, lens.left.shape[0] - 1) if whole else _columns(lens, low, high)
    from_x, from_y = -(ahead * turned_c + aside * turned_s), -(aside * turned_c - ahead * turned_s)
    hides = box[6] <= 0.0 and box[7] >= tallest
    for u in range(first, last + 1):
        if ahead - reach >= hidden[u]:
            continue
        left = lens.left[u]
        along, across = turned_c + left * turned_s, left * turned_c - turned_s  # per metre of depth, in the box's frame
        near, far = -math.inf, math.inf
        if abs(along) > 1e-12:
            t, v = (-box[4] - from_x) / along, (box[4] - from_x) / along
            near, far = max(near, min(t, v)), min(far, max(t, v))
        elif abs(from_x) > box[4]:
            continue
        if abs(across) > 1e-12:
            t, v = (-box[5] - from_y) / across, (box[5] - from_y) / across
            near, far = max(near, min(t, v)), min(far, max(t, v))
        elif abs(from_y) > box[5]:
            continue
        if near < far and far > NEAREST_M and near < hidden[u]:
            _upright(picture[u], lens, near, far, box[6], box[7])
            if hides:
                hidden[u] = max(near, NEAREST_M)


@_compiled
def _draw_cylinder(
    picture: Any, hidden: Doubles, lens: Lens, cylinder: Doubles, x: float, y: float, c: float, s: float
) -> None:
    dx, dy = cylinder[0] - x, cylinder[1] - y
    ahead, aside, radius = dx * c + dy * s, dy * c - dx * s, cylinder[2]
    if ahead + radius < 0.0 or ahead - radius > lens.range_m:
        return
    first, last = 0, lens.left.shape[0] - 1
    if ahead - radius > 0.01:
        near, far = ahead - radius, ahead + radius
        low, high = aside - radius, aside + radius
        first, last = _columns(lens, min(low / near, low / far), max(high / near, high / far))
    for u in range(first, last + 1):
        if ahead - radius >= hidden[u]:
            continue
        left = lens.left[u]
        squared = 1.0 + left * left
        half = (ahead + left * aside) / squared
        inside = half * half - (ahead * ahead + aside * aside - radius * radius) / squared
        if inside <= 0.0:
            continue
        root = math.sqrt(inside)
        if half + root > NEAREST_M and half - root < hidden[u]:
            _upright(picture[u], lens, half - root, half + root, cylinder[3], cylinder[4])


@_compiled
def _capsule_column(
    column: Any, up: Any, left: float, ax: float, ay: float, az: float, bx: float, by: float, bz: float, radius: float
) -> None:
    """Draw into a part of one column, seen under the tangents `up`, the capsule from a to b (camera's frame).

    Rays (1, left, up) times depth: depth at the endless cylinder around the axis where that lies between the ends, else
    at the ball around the nearer end. Without branches, so that it is compiled for several pixels at once.
    """
    vx, vy, vz = bx - ax, by - ay, bz - az
    axis, from_a = vx * vx + vy * vy + vz * vz, -(vx * ax + vy * ay + vz * az)
    at_a, at_b = ax * ax + ay * ay + az * az - radius * radius, bx * bx + by * by + bz * bz - radius * radius
    constant = axis * at_a - from_a * from_a
    along_0, a_0, b_0, ray_0 = vx + vy * left, ax + left * ay, bx + left * by, 1.0 + left * left
    for v in range(column.shape[0]):
        ray, along, to_a = ray_0 + up[v] * up[v], along_0 + vz * up[v], a_0 + az * up[v]
        a, b = axis * ray - along * along, -axis * to_a - from_a * along
        inside = b * b - a * constant
        depth = (-b - math.sqrt(max(inside, 0.0))) / a
        place = from_a + depth * along
        to_end = to_a if place <= 0.0 else b_0 + bz * up[v]
        at_end = at_a if place <= 0.0 else at_b
        ball = to_end * to_end - ray * at_end
        of_ball = (to_end - math.sqrt(max(ball, 0.0))) / ray
        between = place > 0.0 and place < axis
        found = depth if between else of_ball
        hit = inside >= 0.0 and (between or ball > 0.0) and found > NEAREST_M
        column[v] = min(column[v], np.float32(found)) if hit else column[v]


@_compiled
def _draw_capsule(
    picture: Any, hidden: Doubles, lens: Lens, ends: Doubles, x: float, y: float, c: float, s: float
) -> None:
    """ends (7,): in the world."""
    ax, ay = (ends[0] - x) * c + (ends[1] - y) * s, (ends[1] - y) * c - (ends[0] - x) * s
    bx, by = (ends[3] - x) * c + (ends[4] - y) * s, (ends[4] - y) * c - (ends[3] - x) * s
    az, bz, radius = ends[2] - lens.height, ends[5] - lens.height, ends[6]
    near, far = min(ax, bx) - radius, max(ax, bx) + radius
    if far < 0.0 or near > lens.range_m:
        return
    rows = lens.up.shape[0]
    first, last, top, bottom = 0, lens.left.shape[0] - 1, 0, rows - 1
    if near > 0.01:
        low, high = min(ay, by) - radius, max(ay, by) + radius
        first, last = _columns(lens, min(low / near, low / far), max(high / near, high / far))
        low, high = min(az, bz) - radius, max(az, bz) + radius
        low, high = min(low / near, low / far), max(high / near, high / far)
        middle = rows / 2 - 0.5
        top = int(max(0.0, min(float(rows), math.ceil(middle - lens.focal * high))))
        bottom = int(max(-1.0, min(rows - 1.0, math.floor(middle - lens.focal * low))))
    for u in range(first, last + 1):
        if near >= hidden[u]:
            continue
        part = picture[u, top : bottom + 1]
        _capsule_column(part, lens.up[top : bottom + 1], lens.left[u], ax, ay, az, bx, by, bz, radius)


@_compiled
def take_pictures(
    lens: Lens,
    poses: Doubles,
    places: NDArray[np.int64],
    boxes: Doubles,
    box_counts: NDArray[np.int64],
    cylinders: Doubles,
    cylinder_counts: NDArray[np.int64],
    people: Doubles,
    body: Doubles,
    out: Frames,
) -> None:
    """One picture per robot: out (n, rows, columns), metres along the axis, at most the range.

    poses (n, 3); places (n,): which of the sets of boxes (sets, most, 8) and cylinders (sets, most, 5) each robot is
    in; people (n, 4): x, y, yaw, height, NaN where nobody is; body (capsules, 7): a person 1 m tall who faces +x.
    """
    rows, columns = lens.up.shape[0], lens.left.shape[0]
    picture = np.empty((columns, rows), dtype=np.float32)
    floor = np.empty(rows, dtype=np.float32)
    for v in range(rows):
        floor[v] = min(lens.range_m, -lens.height / lens.up[v]) if lens.up[v] < 0.0 else lens.range_m
    limb, hidden = np.empty(7), np.empty(columns)
    for i in range(poses.shape[0]):
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        x, y = poses[i, 0] + lens.ahead * c, poses[i, 1] + lens.ahead * s
        for u in range(columns):
            picture[u] = floor
        here = places[i]
        tallest = lens.height if math.isnan(people[i, 0]) else max(lens.height, people[i, 3])
        for b in range(box_counts[here]):
            tallest = max(tallest, boxes[here, b, 7])
        for b in range(cylinder_counts[here]):
            tallest = max(tallest, cylinders[here, b, 4])
        hidden[:] = lens.range_m
        for b in range(box_counts[here]):
            _draw_box(picture, hidden, tallest, lens, boxes[here, b], x, y, c, s)
        for b in range(cylinder_counts[here]):
            _draw_cylinder(picture, hidden, lens, cylinders[here, b], x, y, c, s)
        if not math.isnan(people[i, 0]) and (people[i, 0] - x) ** 2 + (people[i, 1] - y) ** 2 < (lens.range_m + 2) ** 2:
            pc, ps, tall = math.cos(people[i, 2]), math.sin(people[i, 2]), people[i, 3]
            for b in range(body.shape[0]):
                for end in (0, 3):
                    limb[end] = people[i, 0] + tall * (body[b, end] * pc - body[b, end + 1] * ps)
                    limb[end + 1] = people[i, 1] + tall * (body[b, end] * ps + body[b, end + 1] * pc)
                    limb[end + 2] = tall * body[b, end + 2]
                limb[6] = tall * body[b, 6]
                _draw_capsule(picture, hidden, lens, limb, x, y, c, s)
        for v in range(rows):
            for u in range(columns):
                out[i, v, u] = picture[u, v]


@_compiled
def add_noise(
    clean: Frames,
    bits: NDArray[np.uint32],
    quantiles: Frames,
    grain: float,
    dropout: float,
    edge_m: float,
    edge_dropout: float,
    nearest: float,
    range_m: float,
    out: Frames,
) -> None:
    """What a stereo camera makes of clean frames (n, rows, columns); 0 where it sees nothing.

    bits: random, of the frames' shape: the lower half of each number says whether the pixel is lost, the upper how far
    off it is, a place in `quantiles` (65,536) of the normal distribution; drawing normal numbers would take longer than
    the picture. The error's standard deviation is grain * depth^2 (triangulation); pixels are lost at random (dropout)
    and, more often, left of a jump of more than edge_m, where one of the two lenses looks past the nearer thing
    (edge_dropout); nearer than `nearest` and at the range nothing is found.
    """
    for i in range(clean.shape[0]):
        for v in range(clean.shape[1]):
            for u in range(clean.shape[2]):
                depth = clean[i, v, u]
                ahead = clean[i, v, min(u + 2, clean.shape[2] - 1)]
                lost = edge_dropout if depth - ahead > edge_m else dropout
                chance = bits[i, v, u]
                if (chance & np.uint32(0xFFFF)) < lost * 65536.0 or depth < nearest:
                    out[i, v, u] = 0.0
                    continue
                if depth >= range_m:
                    out[i, v, u] = range_m
                    continue
                seen = depth + grain * depth * depth * quantiles[chance >> np.uint32(16)]
                out[i, v, u] = min(max(math.floor(seen * 1000.0 + 0.5) / 1000.0, 0.0), range_m)
