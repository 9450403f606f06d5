"""People who walk planned ways through a demonstration's scene (the person modes of chapter 3). Simulated.

Walks of participants come as recordings (`desirepath.simulation.walks`); both are kept and replayed alike. Programs
that stand in for participants record theirs with `record_walk`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.cost_map import Grid, cheapest_path, cost_to_go, free_grid, smooth
from desirepath.simulation.scene import Person, Pose, Scene, SceneError
from desirepath.simulation.scenes import check_scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.walks import Walk

MODES = ("opposite", "random")
SPEED_M_S = (0.5, 0.3)  # mean and standard deviation, cut to the next line
SPEED_LIMITS_M_S = (0.1, 1.5)
SPARE_M = 0.05  # between the person and things
BESIDE_M = (0.8, 1.8)  # ours: the opposite way begins and ends so far from the robot's goal and start
SHORTEST_M = 2.0  # of a random way
SHORTEST_RECORDED_M = 1.0
RECORDED_EVERY_S = 1 / 30  # as client/walk.js
TRIES = 200


def walking_scene(scene: Scene, mode: str, seed: int) -> Scene:
    """The scene with a person who walks while the robot drives; the same seed, the same walk.

    mode: `opposite` (from beside the robot's goal to beside its start) or `random` (between free places). The way is
    the shortest around obstacles (A*'s, found by Dijkstra's search), at one speed. Raises SceneError for another mode,
    or if no way was found.
    """
    if mode not in MODES:
        raise SceneError("mode", mode, f"unknown; known: {', '.join(MODES)}")
    random = np.random.default_rng([seed, *mode.encode()])
    grid = _free_for_person(scene)
    free = grid.places()[grid.free]
    for _ in range(TRIES):
        begin, end = (_beside(free, place, random) for place in (scene.goal, scene.start))
        if mode == "random":
            begin, end = free[random.integers(len(free), size=2)]
        if begin is None or end is None or math.dist(begin, end) < SHORTEST_M:
            continue
        costs = cost_to_go(grid, lambda places: np.ones(len(places)), Pose(*end))
        path = cheapest_path(grid, costs, Pose(*begin))
        if not math.isfinite(costs[grid.cell(*begin)]) or len(path) < 3:
            continue
        walk = _walk_along(smooth(path), float(np.clip(random.normal(*SPEED_M_S), *SPEED_LIMITS_M_S)))
        walked = replace(scene, walk=walk, person=Person(Pose(*map(float, walk.poses_at([0.0])[0]))))
        try:
            check_scene(walked)
        except SceneError:
            continue  # the person would begin in the robot's way
        return walked
    raise SceneError("walk", mode, f"no way found in {TRIES} tries; use another seed")


def _free_for_person(scene: Scene) -> Grid:
    """Where the person fits, whose own place does not count."""
    spare = scene.person.radius - get_setup(scene.setup).robot.radius_m + SPARE_M  # the grid is made for the robot
    return free_grid(scene, spare_m=spare, around_person=False)


def record_walk(scene: Scene, duration_s: float, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a programmed person records who walks from where they stand to a free place and stays there: times (n,) s
    and poses (n, 3) m, rad, 30 a second for `duration_s`. Raises SceneError if no way was found.
    """
    random = np.random.default_rng([seed, *b"recorded"])
    grid = _free_for_person(scene)
    free = grid.places()[grid.free]
    begin = np.array([scene.person.pose.x, scene.person.pose.y])
    for _ in range(TRIES):
        end = free[random.integers(len(free))]
        costs = cost_to_go(grid, lambda places: np.ones(len(places)), Pose(*end))
        if math.dist(begin, end) < SHORTEST_RECORDED_M or not math.isfinite(costs[grid.cell(*begin)]):
            continue
        path = np.concatenate([begin[None], cheapest_path(grid, costs, scene.person.pose)[1:]])
        if len(path) < 3:
            continue
        walk = _walk_along(smooth(path), float(np.clip(random.normal(*SPEED_M_S), *SPEED_LIMITS_M_S)))
        times = np.arange(0.0, duration_s + RECORDED_EVERY_S, RECORDED_EVERY_S)
        return times, walk.poses_at(times)
    raise SceneError("person", scene.person.pose, f"no way found from there in {TRIES} tries; use another seed")


def _beside(free: NDArray[np.float64], place: Pose, random: np.random.Generator) -> NDArray[np.float64] | None:
    away = np.linalg.norm(free - np.array([place.x, place.y]), axis=1)
    near = free[(away >= BESIDE_M[0]) & (away <= BESIDE_M[1])]
    return near[random.integers(len(near))] if len(near) else None


def _walk_along(path: NDArray[np.float64], speed: float) -> Walk:
    steps = np.diff(path, axis=0)
    times = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1) / speed)])
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    return Walk.recorded(times, np.column_stack([path, np.append(headings, headings[-1])]))
