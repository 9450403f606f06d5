"""A search among pedestrians told where everybody will be, and one told where they are and how they move.

Both are told the building, too. Where nobody avoids anybody the first says what can be reached at most, nearly; people
who avoid others do not walk as it foresees. The second is imitated by who learns: the robot senses much of what that
is told, not who is hidden or far. The search itself is
`foresight_kernels.py`'s; planners that look less far ahead are in `crowd_planners.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.pedestrians.crowd_networks import COMMANDS, actions_of_commands, scale_commands
from desirepath.simulation.crowds.crowd_engine import CrowdEngine
from desirepath.simulation.crowds.crowd_maps import boxes_of
from desirepath.simulation.crowds.crowd_setups import PED_DEPTH_M, PED_WIDTH_M
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_experiments.training.pedestrians import foresight_kernels as search

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
STEPS_AHEAD = 25  # 5 s; with 40 steps more episodes time out, as waiting at a distance costs nothing
DIRECTIONS = 16
CELL_M = 0.1
BERTH_M = 0.3  # from whom it is told where they will be
BERTH_BY_VELOCITY_M, STEPS_BY_VELOCITY = 0.6, 8  # ours; after so many steps only who stands is foreseen
BERTH_STANDING_M = 0.45  # with 0.6 it times out more often; experiments/notebook
STANDS_M_S = 0.05  # who is slower than this now, stands
_PLACE = {(turn, speed): k for k, (turn, speed) in enumerate(COMMANDS.tolist())}
MIRRORED = np.array([_PLACE.get((-turn, speed), -1) for turn, speed in COMMANDS.tolist()])
"""(24,): which of them each becomes if left and right are exchanged; -1: none, of turning about to the left."""
SEARCH_BY_VELOCITY = {
    "berth_m": BERTH_BY_VELOCITY_M,
    "steps": STEPS_BY_VELOCITY,
    "berth_standing_m": BERTH_STANDING_M,
    "steps_standing": STEPS_AHEAD,
    "stands_m_s": STANDS_M_S,
}
MOST_M = 4.0  # what a command costs above the best, at most


def foresight(engine: CrowdEngine) -> Floats:
    """(n, 2) actions in [-1, 1]. Who avoids others is foreseen as if they walked their routes straight on."""
    limits, bodies = engine.setup.robot.limits, _bodies(engine)
    actions = np.zeros((engine.n_envs, 2), np.float32)
    for i, ground in _running(engine):
        v, w = search.best_first_command(
            engine.world.robots[i], ground, bodies, _on_their_routes(engine, i), DIRECTIONS
        )
        actions[i] = scale_commands(np.array(v), np.array(w), limits)
    return actions


def constant_velocity(engine: CrowdEngine) -> Floats:
    """(n, 2) actions in [-1, 1]: the cheapest command where everybody walks on as now."""
    chosen: Floats = actions_of_commands(engine.setup.robot.limits)[costs_by_velocity(engine).argmin(axis=1)]
    return chosen


def costs_by_velocity(engine: CrowdEngine) -> Floats:
    """(n, 24) m: what each of `COMMANDS` costs above the best, with the best moves after it, at most `MOST_M`, where
    everybody walks on as now for `STEPS_BY_VELOCITY`, and who stands in this moment, pausing or not, does so for
    `STEPS_AHEAD`. 0 for who has ended."""
    bodies = _bodies(engine)
    costs = np.zeros((engine.n_envs, len(COMMANDS)))
    for i, ground in _running(engine):
        search.costs_of_commands(
            engine.world.robots[i], ground, bodies, _straight_on(engine, i), COMMANDS, MOST_M, costs[i]
        )
    return costs.astype(np.float32)


def _running(engine: CrowdEngine) -> Iterator[tuple[int, search.Ground]]:
    for i in np.flatnonzero(~engine.dones):
        scene = engine.scenes[i]
        if scene is not None:
            yield int(i), ground_of(scene)


def _bodies(engine: CrowdEngine) -> search.Bodies:
    half = PED_DEPTH_M / 2, PED_WIDTH_M / 2
    robot = engine.setup.robot
    return search.Bodies(robot.radius_m, *half, robot.limits.w_max, CONTROL_DT_S, STEPS_AHEAD)


def _on_their_routes(engine: CrowdEngine, i: int) -> search.Foreseen:
    w, people = engine.world, int(engine.world.people[i])
    places, faces = np.zeros((2, STEPS_AHEAD + 1, people, 2))
    search.foresee(
        w.routes[i], w.knots[i], w.speeds[i, :people], w.people_xy[i], w.facing[i], w.heading_for[i], w.turn[i],
        CONTROL_DT_S, places, faces,
    )  # fmt: skip
    return search.Foreseen(places, faces, np.full(people, STEPS_AHEAD), np.full(people, BERTH_M))


def _straight_on(engine: CrowdEngine, i: int) -> search.Foreseen:
    w, people = engine.world, int(engine.world.people[i])
    times, v = CONTROL_DT_S * np.arange(STEPS_AHEAD + 1)[:, None, None], w.people_v[i, :people]
    places, faces = w.people_xy[i, :people] + times * v, np.repeat(w.facing[i, None, :people], STEPS_AHEAD + 1, axis=0)
    stands = np.hypot(v[:, 0], v[:, 1]) < STANDS_M_S
    until = np.where(stands, STEPS_AHEAD, STEPS_BY_VELOCITY)
    return search.Foreseen(places, faces, until, np.where(stands, BERTH_STANDING_M, BERTH_BY_VELOCITY_M))


@lru_cache(maxsize=2_560)  # more than a pool of training scenes; 0.1 MB each
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
    length = search.lengths_to_goal(
        np.concatenate([boxes, np.array(stands)]), get_setup(scene.setup).robot.radius_m, cell, xs, ys
    )
    return search.Ground(
        boxes, length, search.downhill(length, CELL_M), xs[0], ys[0], CELL_M, goal.x, goal.y, scene.goal_radius
    )
