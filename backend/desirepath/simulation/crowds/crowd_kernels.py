"""One control step of robots among cuboid pedestrians, compiled: walking, driving, contact, lidar, path and reward.

Whom pedestrians avoid is in `avoidance_kernels.py`; what is made of two scans in `descriptor_kernels.py`. Compiled
functions of one file only: see `kernels.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled, inlined

Doubles = NDArray[np.float64]
Ints = NDArray[np.int64]

RUNNING, SUCCESS, COLLISION, TIMEOUT = 0, 1, 2, 3  # trajectory.Outcome
SUBSTEPS = 4  # of a control step: at 1 m/s nobody moves more than 5 cm between two looks for contact
HELD_UP_S, HELD_UP_SHARE = 2.0, 0.1  # who avoids others turns back after so long below that share of their speed
ARRIVED_M = 0.3  # who avoids others heads for the next place of the route when this near


class CrowdRules(NamedTuple):
    """Numbers of a setup and its reward, as the compiled step needs them: s, m, rad, m/s, rad/s."""

    dt: float
    radius: float
    v_min: float
    v_max: float
    w_max: float
    max_steps: int
    goal_radius: float
    range_m: float
    beams: int
    sectors: int
    noise: float
    depth: float  # half of a pedestrian's, along its heading
    width: float
    points: int
    spacing: float
    ahead: float
    near: float
    collision: float
    guide: float
    proximity: float


class World(NamedTuple):
    """n environments. boxes (n, B, 6): x, y, half length, half width, cosine, sine; the first box_count (n,) count.

    routes (n, P, R, 2) with knots (n, P) places each, speeds (n, P), people (n,) of them. paths (n, R, 2) of the robots
    with path_knots (n,). people_xy, people_v (n, P, 2) m, m/s; facing (n, P, 2) cosine, sine; heading_for (n, P) the
    place of the route they walk to next; turn (n, P) +1 forth, -1 back; held_up (n, P) s that who avoids others has
    been below HELD_UP_SHARE of their speed towards it. robots (n, 3) x, y, yaw; steps, finished (n,); seeds (n,) of the
    sensor's noise.
    """

    boxes: Doubles
    box_count: Ints
    routes: Doubles
    knots: Ints
    speeds: Doubles
    people: Ints
    paths: Doubles
    path_knots: Ints
    people_xy: Doubles
    people_v: Doubles
    facing: Doubles
    heading_for: Ints
    turn: Ints
    held_up: Doubles
    robots: Doubles
    steps: Ints
    finished: NDArray[np.bool_]
    seeds: Ints


class Seen(NamedTuple):
    """What a step leaves. ranges (n, sectors) m, points (n, sectors, 2) m in the robot's frame, of the nearest beam.

    path_points (n, points, 2) m in the robot's frame; rewards (n,); outcomes (n,) int8; lidar_min
    (n,) m.
    """

    ranges: Doubles
    points: Doubles
    path_points: Doubles
    rewards: Doubles
    outcomes: NDArray[np.int8]
    lidar_min: Doubles


@compiled
def box_gap(x: float, y: float, bx: float, by: float, length: float, width: float, cos: float, sin: float) -> float:
    """Distance (m) from a point to a box's surface; negative inside."""
    dx, dy = x - bx, y - by
    along = abs(dx * cos + dy * sin) - length
    across = abs(dy * cos - dx * sin) - width
    if along > 0.0 and across > 0.0:
        return math.sqrt(along * along + across * across)
    return max(along, across)


@compiled
def walk_routes(world: World, i: int, seconds: float) -> None:
    """Everybody of environment i goes on along their own route, turning back at its ends; nobody avoids anybody."""
    for p in range(world.people[i]):
        if world.speeds[i, p] <= 0.0 or world.knots[i, p] < 2:
            continue
        left = world.speeds[i, p] * seconds
        x, y = world.people_xy[i, p, 0], world.people_xy[i, p, 1]
        for _ in range(8):
            target = world.heading_for[i, p]
            dx, dy = world.routes[i, p, target, 0] - x, world.routes[i, p, target, 1] - y
            away = math.sqrt(dx * dx + dy * dy)
            if away > 1e-9:
                world.facing[i, p, 0], world.facing[i, p, 1] = dx / away, dy / away
            if away > left:
                x, y = x + dx / away * left, y + dy / away * left
                break
            x, y, left = x + dx, y + dy, left - away
            next_place(world, i, p)
        world.people_v[i, p, 0] = world.speeds[i, p] * world.facing[i, p, 0]
        world.people_v[i, p, 1] = world.speeds[i, p] * world.facing[i, p, 1]
        world.people_xy[i, p, 0], world.people_xy[i, p, 1] = x, y


@compiled
def next_place(world: World, i: int, p: int) -> None:
    """Head for the next place of the route, or turn back at its end."""
    ahead = world.heading_for[i, p] + world.turn[i, p]
    if ahead < 0 or ahead >= world.knots[i, p]:
        world.turn[i, p] = -world.turn[i, p]
        ahead = world.heading_for[i, p] + world.turn[i, p]
    world.heading_for[i, p] = ahead


@compiled
def follow_velocities(world: World, i: int, seconds: float) -> None:
    """Everybody of environment i moves by the velocity that was chosen for them; heads for the next place if near.

    Who is held up turns back, as pedestrians of the iGibson challenge choose a new goal after 2 s: else two who meet in
    a door stand there for ever.
    """
    for p in range(world.people[i]):
        if world.speeds[i, p] <= 0.0 or world.knots[i, p] < 2:
            continue
        vx, vy = world.people_v[i, p, 0], world.people_v[i, p, 1]
        world.people_xy[i, p, 0] += vx * seconds
        world.people_xy[i, p, 1] += vy * seconds
        speed = math.sqrt(vx * vx + vy * vy)
        if speed > 0.05:
            world.facing[i, p, 0], world.facing[i, p, 1] = vx / speed, vy / speed
        target = world.heading_for[i, p]
        dx = world.routes[i, p, target, 0] - world.people_xy[i, p, 0]
        dy = world.routes[i, p, target, 1] - world.people_xy[i, p, 1]
        away = math.sqrt(dx * dx + dy * dy)
        nearing = (vx * dx + vy * dy) / max(away, 1e-9)
        world.held_up[i, p] = world.held_up[i, p] + seconds if nearing < HELD_UP_SHARE * world.speeds[i, p] else 0.0
        held_up = world.held_up[i, p] > HELD_UP_S - seconds / 2  # a sum of rounded seconds
        if held_up:
            world.turn[i, p] = -world.turn[i, p]
        if held_up or away < ARRIVED_M:
            world.held_up[i, p] = 0.0
            next_place(world, i, p)


@compiled
def nearest_person(world: World, i: int, rules: CrowdRules) -> float:
    """Distance (m) from the robot's centre to the nearest pedestrian's surface; infinite without any."""
    nearest = math.inf
    x, y = world.robots[i, 0], world.robots[i, 1]
    for p in range(world.people[i]):
        px, py = world.people_xy[i, p, 0], world.people_xy[i, p, 1]
        gap = box_gap(x, y, px, py, rules.depth, rules.width, world.facing[i, p, 0], world.facing[i, p, 1])
        nearest = min(nearest, gap)
    return nearest


@compiled
def nearest_wall(world: World, i: int) -> float:
    """Distance (m) from the robot's centre to the nearest wall or obstacle."""
    nearest = math.inf
    x, y = world.robots[i, 0], world.robots[i, 1]
    for b in range(world.box_count[i]):
        o = world.boxes[i, b]
        nearest = min(nearest, box_gap(x, y, o[0], o[1], o[2], o[3], o[4], o[5]))
    return nearest


@inlined
def _see_side(
    ax: float, ay: float, bx: float, by: float, rules: CrowdRules, directions: Doubles, inverse: Doubles
) -> None:
    """Note a wall from a to b (m, robot's frame, a to the right of b as seen from the robot) in 1 / range of beams."""
    area = ax * by - ay * bx
    if area <= 1e-12:
        return
    per_radian = rules.beams / (2 * math.pi)
    begin = math.atan2(ay, ax) * per_radian
    end = math.atan2(by, bx) * per_radian
    if end < begin:
        end += rules.beams
    # a beam (c, s) meets the line where range = area / (c * (by - ay) - s * (bx - ax))
    across, along = (by - ay) / area, (bx - ax) / area
    for k in range(math.ceil(begin), math.floor(end) + 1):
        beam = k % rules.beams
        near = directions[beam, 0] * across - directions[beam, 1] * along
        if near > inverse[beam]:
            inverse[beam] = near


@inlined
def _see_box(
    x: float,
    y: float,
    cos: float,
    sin: float,
    o: Doubles,
    rules: CrowdRules,
    directions: Doubles,
    inverse: Doubles,
) -> None:
    """Note those sides of a box (x, y, half length, half width, cosine, sine) that face the robot."""
    dx, dy = o[0] - x, o[1] - y
    reach = rules.range_m + o[2] + o[3]
    if dx * dx + dy * dy > reach * reach:
        return
    mx, my = dx * cos + dy * sin, dy * cos - dx * sin  # its middle in the robot's frame
    ux, uy = o[4] * cos + o[5] * sin, o[5] * cos - o[4] * sin  # its own x axis there
    for corner in range(4):
        # a to b runs around the box counter-clockwise: of a side that faces the robot, a is to the left of b
        sa, ta = (1.0 if corner in (0, 3) else -1.0), (1.0 if corner in (0, 1) else -1.0)
        sb, tb = (1.0 if corner in (3, 2) else -1.0), (1.0 if corner in (3, 0) else -1.0)
        ax, ay = mx + sa * o[2] * ux - ta * o[3] * uy, my + sa * o[2] * uy + ta * o[3] * ux
        bx, by = mx + sb * o[2] * ux - tb * o[3] * uy, my + sb * o[2] * uy + tb * o[3] * ux
        _see_side(bx, by, ax, ay, rules, directions, inverse)


@compiled
def _noise(seed: int, step: int, beam: int) -> float:
    """A number in [-1, 1) that depends on these three alone (splitmix64)."""
    z = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(step) * np.uint64(0xD1B54A32D192ED03)
    z += np.uint64(beam) * np.uint64(0x8CB92BA72F3D8DD7)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) / 4503599627370496.0 - 1.0


@compiled
def cast_beams(world: World, i: int, rules: CrowdRules, directions: Doubles, inverse: Doubles) -> None:
    """1 / range of every beam of robot i into `inverse` (beams,), without noise."""
    inverse[:] = 1.0 / rules.range_m
    x, y, yaw = world.robots[i, 0], world.robots[i, 1], world.robots[i, 2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    for b in range(world.box_count[i]):
        _see_box(x, y, cos, sin, world.boxes[i, b], rules, directions, inverse)
    body = np.empty(6)
    for p in range(world.people[i]):
        body[0], body[1] = world.people_xy[i, p, 0], world.people_xy[i, p, 1]
        body[2], body[3] = rules.depth, rules.width
        body[4], body[5] = world.facing[i, p, 0], world.facing[i, p, 1]
        _see_box(x, y, cos, sin, body, rules, directions, inverse)


@compiled
def look(world: World, i: int, seen: Seen, rules: CrowdRules, directions: Doubles, inverse: Doubles) -> None:
    """The pooled scan of robot i with its noise: of each sector the nearest beam, where that beam really points.

    Keeping the beam's own direction (ours) puts points onto surfaces; a sector's middle would put them beside.
    """
    cast_beams(world, i, rules, directions, inverse)
    per = rules.beams // rules.sectors
    step = world.steps[i]
    for sector in range(rules.sectors):
        best, beam = rules.range_m, sector * per + per // 2
        for k in range(sector * per, (sector + 1) * per):
            distance = 1.0 / inverse[k]
            if distance < rules.range_m * (1.0 - 1e-9):
                distance += rules.noise * _noise(world.seeds[i], step, k)
                if distance < best:
                    best, beam = distance, k
        seen.ranges[i, sector] = best
        seen.points[i, sector, 0] = best * directions[beam, 0]
        seen.points[i, sector, 1] = best * directions[beam, 1]
    seen.lidar_min[i] = seen.ranges[i].min()


@compiled
def progress_on(world: World, i: int) -> tuple[int, float]:
    """Where the robot's path is nearest to it: (number of the piece, metres into it)."""
    x, y = world.robots[i, 0], world.robots[i, 1]
    best, piece, into = math.inf, 0, 0.0
    for k in range(world.path_knots[i] - 1):
        ax, ay = world.paths[i, k, 0], world.paths[i, k, 1]
        ux, uy = world.paths[i, k + 1, 0] - ax, world.paths[i, k + 1, 1] - ay
        length = math.sqrt(ux * ux + uy * uy)
        along = min(max(((x - ax) * ux + (y - ay) * uy) / max(length, 1e-9), 0.0), length)
        px, py = ax + ux * along / max(length, 1e-9), ay + uy * along / max(length, 1e-9)
        away = (px - x) * (px - x) + (py - y) * (py - y)
        if away < best - 1e-12:
            best, piece, into = away, k, along
    return piece, into


@compiled
def ahead_on(world: World, i: int, piece: int, into: float, ahead: float) -> tuple[float, float]:
    """The place so far ahead (m) on the robot's path; its end where the path ends earlier."""
    left = into + ahead
    for k in range(piece, world.path_knots[i] - 1):
        ax, ay = world.paths[i, k, 0], world.paths[i, k, 1]
        ux, uy = world.paths[i, k + 1, 0] - ax, world.paths[i, k + 1, 1] - ay
        length = math.sqrt(ux * ux + uy * uy)
        if left <= length:
            return ax + ux * left / max(length, 1e-9), ay + uy * left / max(length, 1e-9)
        left -= length
    last = world.path_knots[i] - 1
    return world.paths[i, last, 0], world.paths[i, last, 1]


@compiled
def look_ahead(world: World, i: int, spacing: float, out: Doubles) -> None:
    """The next places (points, 2) of the path, `spacing` metres apart from the nearest on, in the robot's frame."""
    x, y, yaw = world.robots[i, 0], world.robots[i, 1], world.robots[i, 2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    piece, into = progress_on(world, i)
    for k in range(out.shape[0]):
        px, py = ahead_on(world, i, piece, into, spacing * k)
        dx, dy = px - x, py - y
        out[k, 0], out[k, 1] = dx * cos + dy * sin, dy * cos - dx * sin


@compiled
def step_crowds(
    world: World,
    seen: Seen,
    actions: NDArray[np.float32],
    reactive: NDArray[np.bool_],
    rules: CrowdRules,
    directions: Doubles,
) -> None:
    """One control step of every environment that runs. reactive (n,): whose pedestrians follow chosen velocities."""
    inverse = np.empty(rules.beams)
    for i in range(world.robots.shape[0]):
        if world.finished[i]:
            seen.rewards[i] = 0.0
            continue
        v = (min(max(actions[i, 0], -1.0), 1.0) + 1) / 2 * (rules.v_max - rules.v_min) + rules.v_min
        w = min(max(actions[i, 1], -1.0), 1.0) * rules.w_max
        part = rules.dt / SUBSTEPS
        hit = False
        for _ in range(SUBSTEPS):
            if reactive[i]:
                follow_velocities(world, i, part)
            else:
                walk_routes(world, i, part)
            yaw = world.robots[i, 2]
            # a short arc, as its chord
            world.robots[i, 0] += v * part * math.cos(yaw + w * part / 2)
            world.robots[i, 1] += v * part * math.sin(yaw + w * part / 2)
            world.robots[i, 2] = math.atan2(math.sin(yaw + w * part), math.cos(yaw + w * part))
            if min(nearest_person(world, i, rules), nearest_wall(world, i)) < rules.radius:
                hit = True
                break
        world.steps[i] += 1
        look(world, i, seen, rules, directions, inverse)
        look_ahead(world, i, rules.spacing, seen.path_points[i])
        piece, into = progress_on(world, i)
        gx, gy = ahead_on(world, i, piece, into, rules.ahead)
        x, y = world.robots[i, 0], world.robots[i, 1]
        reward = -rules.guide * math.sqrt((gx - x) * (gx - x) + (gy - y) * (gy - y))
        reward -= rules.proximity * max(0.0, rules.near - seen.lidar_min[i])
        last = world.path_knots[i] - 1
        to_goal_x, to_goal_y = world.paths[i, last, 0] - x, world.paths[i, last, 1] - y
        outcome = RUNNING
        if hit:
            outcome = COLLISION
            reward -= rules.collision
        elif to_goal_x * to_goal_x + to_goal_y * to_goal_y <= rules.goal_radius * rules.goal_radius:
            outcome = SUCCESS
        elif world.steps[i] >= rules.max_steps:
            outcome = TIMEOUT
        seen.rewards[i] = reward
        seen.outcomes[i] = outcome
        world.finished[i] = outcome != RUNNING


@compiled
def begin_crowds(which: Ints, world: World, seen: Seen, rules: CrowdRules, directions: Doubles) -> None:
    """Look around at the start of an episode in the named environments."""
    inverse = np.empty(rules.beams)
    for i in which:
        world.steps[i] = 0
        world.finished[i] = False
        look(world, i, seen, rules, directions, inverse)
        look_ahead(world, i, rules.spacing, seen.path_points[i])


@compiled
def scan_ranges(world: World, rules: CrowdRules, directions: Doubles, sectors: int, out: Doubles) -> None:
    """The scans of all robots pooled into another number of sectors, without noise: out (n, sectors), m."""
    inverse = np.empty(rules.beams)
    for i in range(world.robots.shape[0]):
        cast_beams(world, i, rules, directions, inverse)
        for sector in range(sectors):
            first, last = sector * rules.beams // sectors, (sector + 1) * rules.beams // sectors
            out[i, sector] = 1.0 / inverse[first:last].max()


@compiled
def path_left(world: World, out: Doubles) -> None:
    """How long the paths still are from where the robots are on them: out (n,) m."""
    for i in range(world.robots.shape[0]):
        piece, into = progress_on(world, i)
        left = -into
        for k in range(piece, world.path_knots[i] - 1):
            ax, ay = world.paths[i, k, 0], world.paths[i, k, 1]
            ux, uy = world.paths[i, k + 1, 0] - ax, world.paths[i, k + 1, 1] - ay
            left += math.sqrt(ux * ux + uy * uy)
        out[i] = left


@compiled
def path_points(world: World, spacing: float, out: Doubles) -> None:
    """The next places on the paths of all robots at another spacing: out (n, points, 2) m, in the robots' frames."""
    for i in range(world.robots.shape[0]):
        look_ahead(world, i, spacing, out[i])
