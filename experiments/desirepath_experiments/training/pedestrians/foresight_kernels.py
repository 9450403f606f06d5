"""Choosing a command among pedestrians by who is told where everybody will be, compiled: a search over first moves.

The planner that uses it, on the engine's state: `foresight.py`. Compiled functions of one file
only: see `kernels.py`.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled

Doubles = NDArray[np.float64]
Ints = NDArray[np.int64]

CLEAR_M, TOUCH_M = 0.25, 0.03  # walls nearer than the first make a way dearer, nearer than the second close it
CLOSED = 30.0  # times the length: a way out of a closed place is still found
LOOK_M = 0.3  # the way downhill is looked for this far ahead
ARRIVING_M = 0.4  # this near, the goal itself is headed for
MARGIN_PEOPLE_M, MARGIN_WALLS_M = 0.05, 0.02  # nearer counts as a collision: steps are looked at once in 0.2 s
NEAR_WALLS_M, NEAR_COST = 0.1, 3.0  # m, per metre nearer and second
CRASH = 200.0
SOONER = 0.8  # m per s by which the goal is reached before the end
TURN_GAIN = 2.5  # rad/s per rad off the wished direction
CRUISES_M_S, SIDES_M = (0.9, 0.5), (0.0, -0.15, 0.15, -0.3, 0.3, -0.45, 0.45)
FIRST_STEPS, FIRST_SPEEDS_M_S, FIRST_SIDES_M = (3, 6, 12), (0.0, 0.5, 1.0), (0.0, -0.25, 0.25)


class Ground(NamedTuple):
    """One building: boxes (n, 6) as in `crowd_kernels.World`; length (nx, ny): metres to the goal from the cells of a
    grid, dearer near walls; downhill (nx, ny): the direction in which it falls, rad; x0, y0: its first cell, m;
    cell: m; goal_x, goal_y, goal_radius: m."""

    boxes: Doubles
    length: Doubles
    downhill: Doubles
    x0: float
    y0: float
    cell: float
    goal_x: float
    goal_y: float
    goal_radius: float


class Foreseen(NamedTuple):
    """Where P people will be: places, faces (steps + 1, P, 2) m and cosine, sine, the first now. They count until a
    step (P,), after which they may be anywhere; nearer than berth (P,) m makes a way dearer."""

    places: Doubles
    faces: Doubles
    until: Ints
    berth: Doubles


class Bodies(NamedTuple):
    """m, s: the robot's radius, half a pedestrian's depth and width, its fastest turn (rad/s), a control step; steps:
    how many a way has at most."""

    radius: float
    depth: float
    width: float
    w_max: float
    dt: float
    steps: int


@compiled
def _gap(x: float, y: float, bx: float, by: float, length: float, width: float, cos: float, sin: float) -> float:
    dx, dy = x - bx, y - by
    along = abs(dx * cos + dy * sin) - length
    across = abs(dy * cos - dx * sin) - width
    if along > 0.0 and across > 0.0:
        return math.sqrt(along * along + across * across)
    return max(along, across)


@compiled
def lengths_to_goal(boxes: Doubles, radius: float, goal: tuple[int, int], xs: Doubles, ys: Doubles) -> Doubles:
    """(len(xs), len(ys)) metres to the goal's cell for a disc of that radius, by Dijkstra over 16 neighbours."""
    nx, ny = len(xs), len(ys)
    cell = xs[1] - xs[0]
    dear, length = np.ones((nx, ny)), np.full((nx, ny), 1e9)
    for i in range(nx):
        for j in range(ny):
            gap = 1e9
            for b in range(len(boxes)):
                o = boxes[b]
                gap = min(gap, _gap(xs[i], ys[j], o[0], o[1], o[2], o[3], o[4], o[5]) - radius)
            if gap < TOUCH_M:
                dear[i, j] = CLOSED
            elif gap < CLEAR_M:
                dear[i, j] = 1.0 + 1.5 * (CLEAR_M - gap) / (CLEAR_M - TOUCH_M)
    done = np.zeros((nx, ny), np.bool_)
    length[goal[0], goal[1]] = 0.0
    heap = [(0.0, goal[0], goal[1])]
    while len(heap) > 0:
        so_far, i, j = heapq.heappop(heap)
        if done[i, j]:
            continue
        done[i, j] = True
        for di in range(-2, 3):
            for dj in range(-2, 3):
                u, v = i + di, j + dj
                knight = abs(di) + abs(dj) == 3
                if not (knight or max(abs(di), abs(dj)) == 1) or u < 0 or v < 0 or u >= nx or v >= ny or done[u, v]:
                    continue
                times = 0.5 * (dear[i, j] + dear[u, v])
                if knight:  # passes between two cells: the one straight ahead counts
                    times = max(times, dear[i + int(di / 2), j + int(dj / 2)])
                total = so_far + times * cell * math.sqrt(di * di + dj * dj)
                if total < length[u, v]:
                    length[u, v] = total
                    heapq.heappush(heap, (total, u, v))
    return length


@compiled
def _length_left(length: Doubles, u: float, v: float) -> float:
    """Metres to the goal at (u, v), in cells from the first, between cells."""
    u = min(max(u, 0.0), length.shape[0] - 1.001)
    v = min(max(v, 0.0), length.shape[1] - 1.001)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    f = length
    left: float = (1 - a) * ((1 - b) * f[i, j] + b * f[i, j + 1]) + a * ((1 - b) * f[i + 1, j] + b * f[i + 1, j + 1])
    return left


@compiled
def downhill(length: Doubles, cell: float) -> Doubles:
    """(nx, ny) rad: where a step of `LOOK_M` from each cell leaves the least to go."""
    bearings = np.zeros(length.shape)
    angles = np.arange(48) * (math.pi / 24)
    along, aside = LOOK_M / cell * np.cos(angles), LOOK_M / cell * np.sin(angles)
    for i in range(length.shape[0]):
        for j in range(length.shape[1]):
            best = 1e18
            for d in range(len(angles)):
                left = _length_left(length, i + along[d], j + aside[d])
                if left < best:
                    best, bearings[i, j] = left, angles[d]
    return bearings


@compiled
def foresee(
    routes: Doubles, knots: Ints, speeds: Doubles, xy: Doubles, facing: Doubles, heading: Ints, turn: Ints, dt: float,
    places: Doubles, faces: Doubles,
) -> None:  # fmt: skip
    """Where everybody will be on their routes: places, faces (steps + 1, P, 2) m and cosine, sine, the first now."""
    for p in range(len(speeds)):
        x, y, fx, fy = xy[p, 0], xy[p, 1], facing[p, 0], facing[p, 1]
        target, way = heading[p], turn[p]
        for t in range(len(places)):
            left = speeds[p] * dt if t > 0 and knots[p] > 1 else 0.0
            for _ in range(8):
                if left <= 0.0:
                    break
                dx, dy = routes[p, target, 0] - x, routes[p, target, 1] - y
                away = math.sqrt(dx * dx + dy * dy)
                if away > 1e-9:
                    fx, fy = dx / away, dy / away
                if away > left:
                    x, y, left = x + fx * left, y + fy * left, 0.0
                    break
                x, y, left = x + dx, y + dy, left - away
                if target + way < 0 or target + way >= knots[p]:
                    way = -way
                target += way
            places[t, p, 0], places[t, p, 1] = x, y
            faces[t, p, 0], faces[t, p, 1] = fx, fy


@compiled
def _headed_for(ground: Ground, x: float, y: float, side: float) -> float:
    """The direction (rad) of the way to the goal, `side` metres beside it at `LOOK_M`."""
    dx, dy = ground.goal_x - x, ground.goal_y - y
    if dx * dx + dy * dy < ARRIVING_M * ARRIVING_M:
        return math.atan2(dy, dx)
    i = min(max(round((x - ground.x0) / ground.cell), 0), ground.downhill.shape[0] - 1)
    j = min(max(round((y - ground.y0) / ground.cell), 0), ground.downhill.shape[1] - 1)
    direction: float = ground.downhill[i, j] + math.atan2(side, LOOK_M)
    return direction


@compiled
def _try_move(
    robot: Doubles, ground: Ground, bodies: Bodies, people: Foreseen, move: Doubles, best: float, command: Doubles
) -> float:
    """What a move costs, metres still to go and nearness; given up above `best`. move: first direction (rad), speed
    (m/s) and steps, then side (m) and speed on the way to the goal. command (2,): its first v, w."""
    x, y, yaw = robot[0], robot[1], robot[2]
    steps, cost = bodies.steps, 0.0
    for t in range(1, steps + 1):
        first = t <= move[2]
        wished = move[0] if first else _headed_for(ground, x, y, move[3])
        off = math.pi - (math.pi - (wished - yaw)) % (2 * math.pi)  # half a turn is one to the left
        w = min(max(TURN_GAIN * off, -bodies.w_max), bodies.w_max)
        v = (move[1] if first else move[4]) * max(math.cos(off), 0.0) ** 2
        if t == 1:
            command[0], command[1] = v, w
        halfway = yaw + w * bodies.dt / 2
        x += v * bodies.dt * math.cos(halfway)
        y += v * bodies.dt * math.sin(halfway)
        yaw += w * bodies.dt
        nearest, closeness, walls = 1e9, 0.0, 1e9
        for p in range(len(people.until)):
            if t <= people.until[p]:
                q, f = people.places[t, p], people.faces[t, p]
                away = _gap(x, y, q[0], q[1], bodies.depth, bodies.width, f[0], f[1]) - bodies.radius
                nearest, closeness = min(nearest, away), max(closeness, people.berth[p] - away)
        for b in range(len(ground.boxes)):
            o = ground.boxes[b]
            walls = min(walls, _gap(x, y, o[0], o[1], o[2], o[3], o[4], o[5]) - bodies.radius)
        if nearest < MARGIN_PEOPLE_M or walls < MARGIN_WALLS_M:
            return cost + CRASH * (1.5 - t / (steps + 1))
        cost += NEAR_COST * bodies.dt * (closeness + max(NEAR_WALLS_M - walls, 0.0))
        if cost - SOONER * bodies.dt * (steps - t) > best:
            return cost
        dx, dy = ground.goal_x - x, ground.goal_y - y
        if dx * dx + dy * dy < ground.goal_radius * ground.goal_radius:
            return cost - SOONER * bodies.dt * (steps - t)
    return cost + _length_left(ground.length, (x - ground.x0) / ground.cell, (y - ground.y0) / ground.cell)


@compiled
def best_first_command(
    robot: Doubles, ground: Ground, bodies: Bodies, people: Foreseen, directions: int
) -> tuple[float, float]:
    """v (m/s) and w (rad/s) of the cheapest move: along the way to the goal or beside it, or first away in one of so
    many directions or standing, then along it. robot (3,): x, y, yaw."""
    best, v, w = 1e18, 0.0, 0.0
    move, command = np.zeros(5), np.zeros(2)
    for move[4] in CRUISES_M_S:
        for move[3] in SIDES_M:
            cost = _try_move(robot, ground, bodies, people, move, best, command)
            if cost < best:
                best, v, w = cost, command[0], command[1]
    move[4] = CRUISES_M_S[0]
    for move[2] in FIRST_STEPS:
        for move[1] in FIRST_SPEEDS_M_S:
            for d in range(directions if move[1] > 0.0 else 1):
                move[0] = robot[2] + 2 * math.pi * d / directions
                for move[3] in FIRST_SIDES_M:
                    cost = _try_move(robot, ground, bodies, people, move, best, command)
                    if cost < best:
                        best, v, w = cost, command[0], command[1]
    return v, w


@compiled
def costs_of_commands(
    robot: Doubles, ground: Ground, bodies: Bodies, people: Foreseen, commands: Doubles, most: float, costs: Doubles
) -> None:
    """What each first direction (rad off the robot's own) and speed (m/s) of commands (n, 2) costs with the best moves
    after it, above the best of them, at most `most`: costs (n,), m."""
    best = 1e18
    move, command = np.zeros(5), np.zeros(2)
    move[4] = CRUISES_M_S[0]
    for c in range(len(commands)):
        move[0], move[1] = robot[2] + commands[c, 0], commands[c, 1]
        costs[c] = 1e18
        for move[2] in FIRST_STEPS:
            for move[3] in FIRST_SIDES_M:
                given_up = min(costs[c], best + most)
                costs[c] = min(costs[c], _try_move(robot, ground, bodies, people, move, given_up, command))
        best = min(best, costs[c])
    for c in range(len(commands)):
        costs[c] = min(costs[c] - best, most)
