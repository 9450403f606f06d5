"""Rollouts that can be differentiated: the engine drives, and beside it the same motion is written down in torch.

What gradients are taken of, and what is trained by them, lives in `sharpening.py`. The lidar is seen as it is, without
a gradient of its own; goal, person and velocities have theirs. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from desirepath.learning.preferences.measures import CLEARANCE_CAP_M, MEASURES, NEAR_PERSON_M, NEAREST_BAND_M
from desirepath.simulation import kernels as k
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath.simulation.trajectory import Outcome

Act = Callable[[Tensor, Tensor], Tensor]
"""(task part (n, polar), lidar (n, sectors)) -> actions (n, 2) in [-1, 1]."""


class _PassedBack(torch.autograd.Function):
    """The state between two steps. Going back through many steps gradients grow beyond all measure where a policy
    wobbles: each robot's is cut at `most`, and weakened by `kept` per step."""

    @staticmethod
    def forward(context: Any, state: Tensor, most: float, kept: float) -> Tensor:
        context.most, context.kept = most, kept
        return state.view_as(state)

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        gradient = torch.nan_to_num(gradients[0], 0.0, 0.0, 0.0)
        size = gradient.norm(dim=1, keepdim=True).clamp(min=1e-12)
        return gradient * torch.clamp(context.most / size, max=1.0) * context.kept, None, None


class Rolled(NamedTuple):
    """n robots over T steps. measured (n, 7): in the order of MEASURES; path length and time as far as they are in the
    driver's hand (what is straight ahead is taken as given). outcomes (n,): Outcome. running (T, n): 1 until the
    episode ended. clearance, person (T, n): metres from the robot's surface. progress (T, n): metres towards the goal.
    rest (n,): metres to the goal's edge at the end. observed: (task part, lidar) of every step. actions (T, n, 2).
    """

    measured: Tensor
    outcomes: Tensor
    running: Tensor
    clearance: Tensor
    person: Tensor
    progress: Tensor
    rest: Tensor
    observed: list[tuple[Tensor, Tensor]]
    actions: Tensor


def surface_distances(rows: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """(n,) metres from points to the nearest box or wall of their scenes (rows: `scene_to_row`), 1000 where none is."""
    nearest = torch.full_like(x, 1e3)
    walls = torch.minimum(rows[:, k.ROOM_HALF_X] - x.abs(), rows[:, k.ROOM_HALF_Y] - y.abs())
    nearest = torch.where(rows[:, k.ROOM_HALF_X] > 0, walls, nearest)
    count = int(rows[:, k.BOX_COUNT].max())
    if not count:
        return nearest
    boxes = rows[:, k.FIRST_BOX : k.FIRST_BOX + k.BOX_COLUMNS * count].reshape(len(rows), count, k.BOX_COLUMNS)
    dx, dy = x[:, None] - boxes[:, :, k.BOX_X], y[:, None] - boxes[:, :, k.BOX_Y]
    cosine, sine = boxes[:, :, k.BOX_COS], boxes[:, :, k.BOX_SIN]
    along = (dx * cosine + dy * sine).abs() - boxes[:, :, k.BOX_HALF_LENGTH]
    across = (dy * cosine - dx * sine).abs() - boxes[:, :, k.BOX_HALF_WIDTH]
    corner = torch.sqrt(along.clamp(min=1e-6) ** 2 + across.clamp(min=1e-6) ** 2)
    distances = torch.where((along > 0) & (across > 0), corner, torch.maximum(along, across))
    there = torch.arange(count)[None] < rows[:, k.BOX_COUNT : k.BOX_COUNT + 1]
    return torch.minimum(nearest, torch.where(there, distances, torch.full_like(distances, 1e3)).min(1).values)


def roll_out(engine: FastEngine, act: Act, most_steps: int, *, cut: float, kept: float) -> Rolled:
    """Drive the engine's robots from where they stand until nearly all have ended, at most `most_steps`.

    cut, kept: of gradients from step to step (`_PassedBack`).
    """
    setup, n, polar = engine.setup, engine.n_envs, engine.setup.polar_size
    radius = setup.robot.radius_m
    rows = torch.tensor(engine.rows, dtype=torch.float32)
    person_x, person_y, goal_x, goal_y = (rows[:, c] for c in (k.PERSON_X, k.PERSON_Y, k.GOAL_X, k.GOAL_Y))
    reach = rows[:, k.PERSON_RADIUS] + radius
    x, y, yaw = torch.tensor(engine.poses, dtype=torch.float32).unbind(1)
    v, w = torch.zeros(n), torch.zeros(n)
    distances, sides = [torch.hypot(person_x - x, person_y - y)], [torch.sin(_bearing(person_x, person_y, x, y, yaw))]
    clearances = [surface_distances(rows, x, y) - radius]
    progress, turns, detours, speeds, running, actions = ([] for _ in range(6))
    observed: list[tuple[Tensor, Tensor]] = []
    alive = torch.ones(n)
    to_goal = torch.hypot(goal_x - x, goal_y - y)
    for _ in range(most_steps):
        to_goal = torch.hypot(goal_x - x, goal_y - y)
        task = [
            to_goal / setup.distance_scale_m,
            _wrapped(_bearing(goal_x, goal_y, x, y, yaw)) / math.pi,
            torch.hypot(person_x - x, person_y - y) / setup.distance_scale_m,
            _wrapped(_bearing(person_x, person_y, x, y, yaw)) / math.pi,
        ]
        task += [v / setup.robot.limits.v_max, w / setup.robot.limits.w_max] if setup.with_velocity else []
        seen = (torch.stack(task, 1), torch.from_numpy(engine.observations[:, polar:].copy()))
        action = act(*seen)
        engine.step(action.detach().numpy())
        v = (action[:, 0] + 1) / 2 * (setup.robot.limits.v_max - setup.robot.limits.v_min) + setup.robot.limits.v_min
        w = action[:, 1] * setup.robot.limits.w_max
        travel, turn = v * CONTROL_DT_S, w * CONTROL_DT_S
        half = turn / 2
        bent = half.abs() > 1e-4
        chord = travel * torch.where(bent, torch.sin(half) / torch.where(bent, half, torch.ones(n)), 1 - half**2 / 6)
        then = torch.stack([x + chord * torch.cos(yaw + half), y + chord * torch.sin(yaw + half), yaw + turn], 1)
        true = torch.tensor(engine.poses, dtype=torch.float32)
        new_x, new_y, new_yaw = (true + then - then.detach()).unbind(1)
        distances.append(torch.hypot(person_x - new_x, person_y - new_y) + (1 - alive) * 1e3)
        sides.append(torch.sin(_bearing(person_x, person_y, new_x, new_y, new_yaw)))
        clearances.append(surface_distances(rows, new_x, new_y) - radius + (1 - alive) * 1e3)
        nearer = to_goal - torch.hypot(goal_x - new_x, goal_y - new_y)
        progress.append(nearer * alive)
        detours.append((chord.abs() - nearer) * alive)
        turns.append(turn.abs() * alive)
        speeds.append(v)
        running.append(alive)
        actions.append(action)
        observed.append(seen)
        moved = alive > 0
        state = [torch.where(moved, new, old) for new, old in ((new_x, x), (new_y, y), (new_yaw, yaw))]
        to_goal = torch.hypot(goal_x - state[0], goal_y - state[1])
        passed = _PassedBack.apply(torch.stack([*state, v, w], 1), cut, kept)  # type: ignore[no-untyped-call]
        x, y, yaw, v, w = passed.unbind(1)
        alive = torch.from_numpy((~engine.dones).astype(np.float32))
        if alive.mean() < 0.02:
            break
    apart, clear = torch.stack(distances), torch.stack(clearances)
    on, forward = torch.stack(running), torch.stack(progress)
    nearest, when = apart.min(0)
    near = ((apart[1:] <= torch.clamp(nearest.detach() + NEAREST_BAND_M, min=NEAR_PERSON_M)) & (on > 0)).float()
    columns = {
        "min_human_distance_m": nearest,
        "passing_side": torch.stack(sides).gather(0, when[None])[0],
        "min_clearance_m": clear.min(0).values.clamp(max=CLEARANCE_CAP_M),
        "path_length_m": torch.stack(detours).sum(0),
        "accumulated_angle_rad": torch.stack(turns).sum(0),
        "speed_near_person_m_s": (torch.stack(speeds) * near).sum(0) / near.sum(0).clamp(min=1),
        # Steps are counted, not differentiated; who comes nearer to the goal in one needs fewer of them.
        "time_s": on.sum(0) * CONTROL_DT_S - (forward - forward.detach()).sum(0) / setup.robot.limits.v_max,
    }
    outcomes = torch.from_numpy(engine.outcomes.astype(np.int64))
    return Rolled(
        torch.stack([columns[name] for name in MEASURES], 1),
        torch.where(alive > 0, int(Outcome.RUNNING), outcomes),
        on,
        clear[1:],
        apart[1:] - reach,
        forward,
        to_goal - rows[:, k.GOAL_RADIUS],
        observed,
        torch.stack(actions),
    )


def _bearing(to_x: Tensor, to_y: Tensor, x: Tensor, y: Tensor, yaw: Tensor) -> Tensor:
    return torch.atan2(to_y - y, to_x - x) - yaw


def _wrapped(angle: Tensor) -> Tensor:
    return torch.atan2(torch.sin(angle), torch.cos(angle))
