"""The planner that is told where everybody will be: what can be reached among pedestrians at most, nearly.

The search is `simulation/crowds/foresight_kernels.py`'s; planners that know less are in `crowd_planners.py`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from backend.simulation.crowds import foresight_kernels as search
from backend.simulation.crowds.crowd_engine import CrowdEngine
from backend.simulation.crowds.crowd_maps import boxes_of
from backend.simulation.crowds.crowd_setups import PED_DEPTH_M, PED_WIDTH_M
from backend.simulation.scene import Scene
from backend.simulation.setups import CONTROL_DT_S, ROBOT_RADIUS_M

Floats = NDArray[np.float32]
STEPS_AHEAD = 25  # 5 s: of 40 more time out, as who waits at a distance costs nothing
DIRECTIONS = 16
CELL_M = 0.1


def foresight(engine: CrowdEngine) -> Floats:
    """(n, 2) actions in [-1, 1]. Who avoids others is foreseen as if they walked their routes straight on."""
    w, limits = engine.world, engine.setup.limits
    bodies = search.Bodies(ROBOT_RADIUS_M, PED_DEPTH_M / 2, PED_WIDTH_M / 2, limits.w_max, CONTROL_DT_S)
    actions = np.zeros((engine.n_envs, 2), np.float32)
    for i in np.flatnonzero(~engine.dones):
        scene, people = engine.scenes[i], int(w.people[i])
        if scene is None:
            continue
        places, faces = np.zeros((2, STEPS_AHEAD + 1, people, 2))
        search.foresee(
            w.routes[i], w.knots[i], w.speeds[i, :people], w.people_xy[i], w.facing[i], w.heading_for[i], w.turn[i],
            CONTROL_DT_S, places, faces,
        )  # fmt: skip
        v, turn = search.best_first_command(w.robots[i], ground_of(scene), bodies, places, faces, DIRECTIONS)
        actions[i] = 2 * (v - limits.v_min) / (limits.v_max - limits.v_min) - 1, turn / limits.w_max
    return actions


@lru_cache(maxsize=512)
def ground_of(scene: Scene) -> search.Ground:
    """A scene's walls and the length of the way to its goal from everywhere, around who stands. Raises ValueError for
    a scene without a room."""
    if scene.room is None:
        raise ValueError("scene.room is missing; foresight needs walls")
    boxes, goal = boxes_of(scene), scene.goal
    standing = [(p.route[0], p.yaw) for p in (scene.crowd.pedestrians if scene.crowd else ()) if p.speed <= 0]
    pose = scene.person.pose
    stands = [
        (x, y, PED_DEPTH_M / 2, PED_WIDTH_M / 2, np.cos(yaw), np.sin(yaw))
        for (x, y), yaw in (((pose.x, pose.y), pose.yaw), *standing)
    ]
    sides = scene.room.length, scene.room.width
    xs, ys = (np.arange(-side / 2 - CELL_M, side / 2 + 2 * CELL_M, CELL_M) for side in sides)
    cell = (round((goal.x - xs[0]) / CELL_M), round((goal.y - ys[0]) / CELL_M))
    length = search.lengths_to_goal(np.concatenate([boxes, np.array(stands)]), ROBOT_RADIUS_M, cell, xs, ys)
    return search.Ground(boxes, length, xs[0], ys[0], CELL_M, goal.x, goal.y, scene.goal_radius)
