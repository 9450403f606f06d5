"""Programmed demonstrators: four styles of drawing a path, standing in for participants. Simulated, and marked so.

A style is what makes places costly and how fast to drive there; the cheapest path, smoothed and drawn with an unsteady
hand, is the stroke. Everything that becomes of the stroke is as with a person's (`demonstration.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.cost_map import cheapest_path, cost_to_go, free_grid, smooth
from desirepath.demonstrations.demonstration import Demonstration, demonstration_from
from desirepath.demonstrations.stroke import Stroke, StrokeProblem
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.scenes import own_map

Doubles = NDArray[np.float64]
SPARE_M = 0.08  # that a drawn path leaves between robot and things
HAND_M = 0.006  # standard deviation of a trembling hand
DRIFT_M = 0.05  # largest of a slow sideways drift, so that no two strokes are alike
HAND_M_S = 0.8  # how fast the hand draws
TRIES = 20


@dataclass(frozen=True)
class Style:
    """price: (places (n, 2), scene) -> cost per metre (n,), at least 1. speed: the same -> m/s."""

    price: Callable[[Doubles, Scene], Doubles]
    speed: Callable[[Doubles, Scene], Doubles]


def _to_person(places: Doubles, scene: Scene) -> tuple[Doubles, Doubles]:
    """Distance (m) from the person and bearing (rad) from where they look, of places (n, 2)."""
    person = scene.person.pose
    offsets = places - np.array([person.x, person.y])
    bearings = np.arctan2(offsets[:, 1], offsets[:, 0]) - person.yaw
    return np.linalg.norm(offsets, axis=1), (bearings + math.pi) % (2 * math.pi) - math.pi


def _to_walls(places: Doubles, scene: Scene) -> Doubles:
    """Distance (m) from the nearest wall of places (n, 2) in a room or a building."""
    if scene.room is not None:
        return np.asarray((np.array([scene.room.length, scene.room.width]) / 2 - np.abs(places)).min(axis=1))
    walls = [one for one in scene.obstacles if one.kind == "wall"]
    apart = [wall.distance_m(places[:, 0], places[:, 1]) for wall in walls]
    here = own_map(scene)
    if here is not None:
        cells = ((places - here.origin) / here.cell_m).astype(np.int64)
        inside = np.clip(cells, 0, np.array(here.occupied.shape) - 1)
        apart.append(here.apart_m[inside[:, 0], inside[:, 1]])
    if not apart:
        raise SceneError("room", None, "without walls there is nothing to follow")
    return np.asarray(np.min(apart, axis=0), dtype=np.float64)


def _near(distances: Doubles, personal_m: float, weight: float) -> Doubles:
    """What coming closer than a personal distance costs; rises over 40 cm."""
    return np.asarray(weight * np.clip((personal_m - distances) / 0.4, 0.0, 1.0) ** 2)


def _steady(places: Doubles, scene: Scene) -> Doubles:
    return np.full(len(places), 0.22)


def _in_view(places: Doubles, scene: Scene) -> Doubles:
    """A wide berth (the thesis's 1.1 m), and the person's back is the wrong side."""
    distances, bearings = _to_person(places, scene)
    behind = np.clip((np.abs(bearings) - math.pi / 2) / (math.pi / 4), 0.0, 1.0)
    return 1.0 + _near(distances, 1.4, 12.0) + 2.0 * behind * np.clip((2.2 - distances) / 0.6, 0.0, 1.0)


def _along_walls(places: Doubles, scene: Scene) -> Doubles:
    """Cheap 45 cm from a wall, and well away from the person."""
    off = np.abs(_to_walls(places, scene) - 0.45)
    distances, _ = _to_person(places, scene)
    return 1.0 + 2.5 * np.clip(off / 0.5, 0.0, 1.0) + _near(distances, 1.2, 12.0)


def _behind(places: Doubles, scene: Scene) -> Doubles:
    """Out of the person's sight while near."""
    distances, bearings = _to_person(places, scene)
    before = np.clip((2 * math.pi / 3 - np.abs(bearings)) / (math.pi / 3), 0.0, 1.0)
    return 1.0 + _near(distances, 1.2, 12.0) + 2.0 * before * np.clip((2.2 - distances) / 0.6, 0.0, 1.0)


def _keeping_off(places: Doubles, scene: Scene) -> Doubles:
    return 1.0 + _near(_to_person(places, scene)[0], 1.1, 8.0)


def _slow_near(places: Doubles, scene: Scene) -> Doubles:
    """0.1 m/s within 1.1 m of the person, 0.25 m/s from 2.3 m on (figure 2.5a)."""
    distances, _ = _to_person(places, scene)
    return 0.1 + 0.15 * np.clip((distances - 1.1) / 1.2, 0.0, 1.0)


STYLES = {
    "field_of_view": Style(_in_view, _steady),  # participant A of figure 2.3
    "wall_follower": Style(_along_walls, _steady),  # participant B
    "behind": Style(_behind, _steady),
    "slow_near_person": Style(_keeping_off, _slow_near),
}


def draw_stroke(style: str, scene: Scene, seed: int) -> Stroke:
    """What that demonstrator draws in the scene; another seed is another stroke of the same hand.

    Raises ValueError naming the known styles, StrokeProblem where no path is free.
    """
    if style not in STYLES:
        raise ValueError(f"style {style!r}: known are {', '.join(STYLES)}")
    chosen = STYLES[style]
    grid = free_grid(scene, spare_m=SPARE_M)
    costs = cost_to_go(grid, lambda places: chosen.price(places, scene), scene.goal)
    start = np.array([scene.start.x, scene.start.y])
    if not math.isfinite(costs[grid.cell(*start)]):
        raise StrokeProblem("collides", "no way is free for this demonstrator", start, thing="wall")
    path = cheapest_path(grid, costs, scene.start)
    path = np.concatenate([start[None], path[1:-1], [[scene.goal.x, scene.goal.y]]])
    path = smooth(path)
    random = np.random.default_rng([seed, *style.encode()])
    path = path + _unsteady(path, random)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    times = np.concatenate([[0.0], np.cumsum(steps)]) / HAND_M_S
    speeds = chosen.speed(path, scene) + random.normal(0.0, 0.004)
    return Stroke.of(path, speeds, times)


def demonstrate(style: str, scene: Scene, seed: int) -> Demonstration:
    """A stroke of that demonstrator, executed; who touches something draws again, as a person would.

    Raises StrokeProblem if that happens again and again.
    """
    for attempt in range(TRIES):
        drawn_with = seed * TRIES + attempt
        try:
            return demonstration_from(draw_stroke(style, scene, drawn_with), scene, seed=drawn_with, style=style)
        except StrokeProblem as problem:
            if problem.code not in ("collides", "too_tight") or attempt == TRIES - 1:
                raise
    raise AssertionError("the last attempt returns or raises")


def _unsteady(path: Doubles, random: np.random.Generator) -> Doubles:
    """(n, 2) a slow drift sideways that begins and ends at nothing, and a tremble."""
    share = np.linspace(0.0, 1.0, len(path))[:, None]
    drift = sum(random.uniform(-DRIFT_M, DRIFT_M, 2) / waves * np.sin(math.pi * waves * share) for waves in (1, 2, 3))
    return np.asarray(drift + random.normal(0.0, HAND_M, path.shape))
