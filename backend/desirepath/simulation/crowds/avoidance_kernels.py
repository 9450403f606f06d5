"""Pedestrians who avoid each other and the robot, compiled, for a whole batch in one call.

ORCA after van den Berg et al. 2011, "Reciprocal n-Body Collision Avoidance"; social forces after Moussaid et al. 2009
and Helbing and Molnar 1995. Walls bound both (ours). Compiled functions of one file only: see `kernels.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled

Doubles = NDArray[np.float64]
SMALL = 1e-5


class OrcaRules(NamedTuple):
    """horizon, wall_horizon: s; neighbours farther than `far` (m) are not looked at; dt: s of a control step."""

    horizon: float = 3.0
    wall_horizon: float = 0.6
    far: float = 6.0
    dt: float = 0.2


class ForceRules(NamedTuple):
    """Numbers of the extended social force model as PySocialForce has them; dt: s of a control step."""

    relaxation: float = 0.5
    social: float = 5.1
    importance: float = 2.0
    gamma: float = 0.35
    n: float = 2.0
    n_prime: float = 3.0
    walls: float = 10.0
    wall_sigma: float = 0.2
    wall_from_m: float = 3.0
    fastest: float = 1.3
    dt: float = 0.2


@compiled
def _on_line(
    lines: Doubles, number: int, radius: float, goal_x: float, goal_y: float, direction: bool
) -> tuple[bool, float, float]:
    """The best velocity on one line that keeps to all before it, in a disc: (whether there is one, vx, vy)."""
    px, py, dx, dy = lines[number, 0], lines[number, 1], lines[number, 2], lines[number, 3]
    along = px * dx + py * dy
    inside = along * along + radius * radius - (px * px + py * py)
    if inside < 0.0:
        return False, 0.0, 0.0
    root = math.sqrt(inside)
    left, right = -along - root, -along + root
    for k in range(number):
        kx, ky = lines[k, 2], lines[k, 3]
        below = dx * ky - dy * kx
        above = kx * (py - lines[k, 1]) - ky * (px - lines[k, 0])
        if abs(below) <= SMALL:
            if above < 0.0:
                return False, 0.0, 0.0
            continue
        t = above / below
        if below >= 0.0:
            right = min(right, t)
        else:
            left = max(left, t)
        if left > right:
            return False, 0.0, 0.0
    if direction:
        t = right if goal_x * dx + goal_y * dy > 0.0 else left
    else:
        t = min(max(dx * (goal_x - px) + dy * (goal_y - py), left), right)
    return True, px + t * dx, py + t * dy


@compiled
def _within(
    lines: Doubles, count: int, radius: float, goal_x: float, goal_y: float, direction: bool
) -> tuple[int, float, float]:
    """The velocity nearest to the goal on the permitted side of all lines: (first line that failed or count, v)."""
    if direction:
        x, y = goal_x * radius, goal_y * radius
    else:
        length = math.sqrt(goal_x * goal_x + goal_y * goal_y)
        scale = radius / length if length > radius else 1.0
        x, y = goal_x * scale, goal_y * scale
    for k in range(count):
        if lines[k, 2] * (lines[k, 1] - y) - lines[k, 3] * (lines[k, 0] - x) > 0.0:
            found, new_x, new_y = _on_line(lines, k, radius, goal_x, goal_y, direction)
            if not found:
                return k, x, y
            x, y = new_x, new_y
    return count, x, y


@compiled
def _least_bad(
    lines: Doubles, count: int, fixed: int, begin: int, radius: float, x: float, y: float
) -> tuple[float, float]:
    """Where not all lines can be kept: the velocity that breaks the worst of the others least; `fixed` stay kept."""
    distance = 0.0
    projected = np.empty((count, 4))
    for i in range(begin, count):
        if lines[i, 2] * (lines[i, 1] - y) - lines[i, 3] * (lines[i, 0] - x) <= distance:
            continue
        projected[:fixed] = lines[:fixed]
        n = fixed
        for j in range(fixed, i):
            below = lines[i, 2] * lines[j, 3] - lines[i, 3] * lines[j, 2]
            if abs(below) <= SMALL:
                if lines[i, 2] * lines[j, 2] + lines[i, 3] * lines[j, 3] > 0.0:
                    continue
                projected[n, 0], projected[n, 1] = (lines[i, 0] + lines[j, 0]) / 2, (lines[i, 1] + lines[j, 1]) / 2
            else:
                t = (lines[j, 2] * (lines[i, 1] - lines[j, 1]) - lines[j, 3] * (lines[i, 0] - lines[j, 0])) / below
                projected[n, 0], projected[n, 1] = lines[i, 0] + t * lines[i, 2], lines[i, 1] + t * lines[i, 3]
            ex, ey = lines[j, 2] - lines[i, 2], lines[j, 3] - lines[i, 3]
            length = math.sqrt(ex * ex + ey * ey)
            projected[n, 2], projected[n, 3] = ex / length, ey / length
            n += 1
        kept, new_x, new_y = _within(projected, n, radius, -lines[i, 3], lines[i, 2], True)
        if kept == n:
            x, y = new_x, new_y
        distance = lines[i, 2] * (lines[i, 1] - y) - lines[i, 3] * (lines[i, 0] - x)
    return x, y


@compiled
def _line_between(
    px: float, py: float, vx: float, vy: float, radii: float, own_x: float, own_y: float, rules: OrcaRules, out: Doubles
) -> None:
    """ORCA's half plane against one neighbour, at relative position p and velocity v, as point and direction."""
    away2 = px * px + py * py
    if away2 > radii * radii:
        wx, wy = vx - px / rules.horizon, vy - py / rules.horizon
        w2 = wx * wx + wy * wy
        dot = wx * px + wy * py
        if dot < 0.0 and dot * dot > radii * radii * w2:
            w = math.sqrt(w2)
            ux, uy = wx / w, wy / w
            out[2], out[3] = uy, -ux
            push = radii / rules.horizon - w
            ux, uy = push * ux, push * uy
        else:
            leg = math.sqrt(away2 - radii * radii)
            if px * wy - py * wx > 0.0:
                out[2], out[3] = (px * leg - py * radii) / away2, (px * radii + py * leg) / away2
            else:
                out[2], out[3] = -(px * leg + py * radii) / away2, -(-px * radii + py * leg) / away2
            along = vx * out[2] + vy * out[3]
            ux, uy = along * out[2] - vx, along * out[3] - vy
    else:
        wx, wy = vx - px / rules.dt, vy - py / rules.dt
        w = max(math.sqrt(wx * wx + wy * wy), 1e-12)
        ux, uy = wx / w, wy / w
        out[2], out[3] = uy, -ux
        push = radii / rules.dt - w
        ux, uy = push * ux, push * uy
    out[0], out[1] = own_x + ux / 2, own_y + uy / 2


@compiled
def orca_velocity(
    who: int,
    xy: Doubles,
    v: Doubles,
    radii: Doubles,
    wished: Doubles,
    fastest: float,
    boxes: Doubles,
    box_count: int,
    rules: OrcaRules,
) -> tuple[float, float]:
    """The new velocity of one of many. xy, v (n, 2), radii (n,), wished (2,): positions, velocities, and its own wish.

    Walls first: as far as one may come nearer to a box (n, 6) within the horizon; then the neighbours, nearest first.
    """
    n = xy.shape[0]
    lines = np.empty((box_count + n, 4))
    count = 0
    for b in range(box_count):
        gap, nx, ny = _away_from_box(xy[who, 0], xy[who, 1], boxes[b])
        gap -= radii[who]
        if gap < fastest * rules.wall_horizon:
            closing = gap / rules.wall_horizon
            lines[count, 0], lines[count, 1] = -closing * nx, -closing * ny
            lines[count, 2], lines[count, 3] = ny, -nx
            count += 1
    fixed = count
    distance = np.full(n, np.inf)
    for k in range(n):
        if k != who:
            distance[k] = (xy[k, 0] - xy[who, 0]) ** 2 + (xy[k, 1] - xy[who, 1]) ** 2
    for k in np.argsort(distance):
        if distance[k] >= rules.far * rules.far:
            break
        _line_between(
            xy[k, 0] - xy[who, 0], xy[k, 1] - xy[who, 1], v[who, 0] - v[k, 0], v[who, 1] - v[k, 1],
            radii[who] + radii[k], v[who, 0], v[who, 1], rules, lines[count],
        )  # fmt: skip
        count += 1
    kept, x, y = _within(lines, count, fastest, wished[0], wished[1], False)
    if kept < count:
        x, y = _least_bad(lines, count, fixed, kept, fastest, x, y)
    return x, y


@compiled
def _away_from_box(x: float, y: float, o: Doubles) -> tuple[float, float, float]:
    """Distance (m) from a box's surface, and the unit vector away from its nearest place."""
    dx, dy = x - o[0], y - o[1]
    along, across = dx * o[4] + dy * o[5], dy * o[4] - dx * o[5]
    far_along, far_across = abs(along) - o[2], abs(across) - o[3]
    sign_along, sign_across = (1.0 if along >= 0 else -1.0), (1.0 if across >= 0 else -1.0)
    if far_along > 0.0 and far_across > 0.0:
        gap = math.sqrt(far_along * far_along + far_across * far_across)
        a, c = sign_along * far_along / gap, sign_across * far_across / gap
    elif far_along > far_across:
        gap, a, c = far_along, sign_along, 0.0
    else:
        gap, a, c = far_across, 0.0, sign_across
    return gap, a * o[4] - c * o[5], a * o[5] + c * o[4]


@compiled
def social_velocity(
    who: int,
    xy: Doubles,
    v: Doubles,
    radii: Doubles,
    target: Doubles,
    speed: float,
    boxes: Doubles,
    box_count: int,
    rules: ForceRules,
) -> tuple[float, float]:
    """The new velocity of one of many by forces towards its target (2,) m, from the others, and from the walls.

    speed: m/s that it wishes for; never faster than that times `fastest`.
    """
    dx, dy = target[0] - xy[who, 0], target[1] - xy[who, 1]
    away = max(math.sqrt(dx * dx + dy * dy), 1e-9)
    top = speed * rules.fastest
    fx, fy = (dx / away * top - v[who, 0]) / rules.relaxation, (dy / away * top - v[who, 1]) / rules.relaxation
    for k in range(xy.shape[0]):
        if k == who:
            continue
        # As PySocialForce: the offset is one's own place minus the other's, the velocity the other's minus one's own.
        px, py = xy[who, 0] - xy[k, 0], xy[who, 1] - xy[k, 1]
        length = math.sqrt(px * px + py * py)
        if length < 1e-9:
            continue
        ex, ey = px / length, py / length
        ix = rules.importance * (v[k, 0] - v[who, 0]) + ex
        iy = rules.importance * (v[k, 1] - v[who, 1]) + ey
        interaction = math.sqrt(ix * ix + iy * iy)
        if interaction < 1e-9:
            continue
        ix, iy = ix / interaction, iy / interaction
        theta = math.atan2(iy, ix) - math.atan2(ey, ex)
        b = rules.gamma * interaction
        ahead = math.exp(-length / b - (rules.n_prime * b * theta) ** 2)
        sign = 0.0 if theta == 0.0 else math.copysign(1.0, theta)
        aside = -sign * math.exp(-length / b - (rules.n * b * theta) ** 2)
        fx += rules.social * (ahead * ix - aside * iy)
        fy += rules.social * (ahead * iy + aside * ix)
    for b_number in range(box_count):
        gap, nx, ny = _away_from_box(xy[who, 0], xy[who, 1], boxes[b_number])
        gap -= radii[who]
        if gap < rules.wall_from_m:
            push = rules.walls * math.exp(-gap / rules.wall_sigma)
            fx, fy = fx + push * nx, fy + push * ny
    x, y = v[who, 0] + rules.dt * fx, v[who, 1] + rules.dt * fy
    fast = math.sqrt(x * x + y * y)
    if fast > top:
        x, y = x / fast * top, y / fast * top
    return x, y


@compiled
def choose_velocities(
    which: NDArray[np.int64],
    forces: NDArray[np.bool_],
    people_xy: Doubles,
    people_v: Doubles,
    people: NDArray[np.int64],
    speeds: Doubles,
    targets: Doubles,
    robots: Doubles,
    robot_v: Doubles,
    boxes: Doubles,
    box_count: NDArray[np.int64],
    person_radius: float,
    robot_radius: float,
    orca: OrcaRules,
    force: ForceRules,
) -> None:
    """New velocities of all pedestrians of the named environments, from everybody's at this moment.

    forces (n,): social forces instead of ORCA. The robot is one more body: it is avoided and avoids by itself.
    """
    for i in which:
        n = people[i] + 1
        xy, v, radii = np.empty((n, 2)), np.empty((n, 2)), np.full(n, person_radius)
        xy[: n - 1], v[: n - 1] = people_xy[i, : n - 1], people_v[i, : n - 1]
        xy[n - 1], v[n - 1], radii[n - 1] = robots[i, :2], robot_v[i], robot_radius
        wished = np.empty(2)
        for p in range(n - 1):
            speed = speeds[i, p]
            if speed <= 0.0:
                continue
            if forces[i]:
                x, y = social_velocity(p, xy, v, radii, targets[i, p], speed, boxes[i], box_count[i], force)
            else:
                dx, dy = targets[i, p, 0] - xy[p, 0], targets[i, p, 1] - xy[p, 1]
                away = max(math.sqrt(dx * dx + dy * dy), 1e-9)
                step = min(speed, away / orca.dt)
                wished[0], wished[1] = dx / away * step, dy / away * step
                x, y = orca_velocity(p, xy, v, radii, wished, speed, boxes[i], box_count[i], orca)
            people_v[i, p, 0], people_v[i, p, 1] = x, y
