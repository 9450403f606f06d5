"""What can be attained of a preference in a scene, jointly with arriving: the best of many planned rollouts.

The planner knows the whole scene and the simulator, as no policy does; a policy's share of what is attained lives in
`headline.py`. The bounds of single measures, which mostly nobody can reach, are `bounds.py`'s. All ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.policies.steerability import Course, MeasuredRollouts
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import gains, names_of
from desirepath.simulation.fast import FastEngine
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup

Doubles = NDArray[np.float64]
WAYPOINTS = 3
POINTS = 48  # of the curve through start, waypoints and goal
ALONG, ACROSS = slice(0, WAYPOINTS), slice(WAYPOINTS, 2 * WAYPOINTS)
NEAR, FAR, GAIN, IN_PLACE, AHEAD = range(2 * WAYPOINTS, 2 * WAYPOINTS + 5)
SIZE = 2 * WAYPOINTS + 5
NEAR_M = 2.2  # where the speed beside the person begins: the measure's 2 m and a step
LOWEST_SPEED = 0.04  # of full speed; 100 s last for every scene
NOT_ARRIVED = -1e3
PATIENCE = 4.0  # times the longest straight way at full speed; who wants the robot slow waits to the end


@dataclass(frozen=True)
class PlannerConfig:
    """A cross-entropy search per scene over rollouts along a curve. copies: rollouts per round; survivors: of them,
    what the next round is drawn around."""

    rounds: int = 14
    copies: int = 40
    survivors: int = 6
    spread: float = 1.0
    seed: int = 0


@dataclass(frozen=True)
class _Curves:
    """Rollouts (n, SIZE) along curves from `starts` (n, 3) to `goals` (n, 2) around people (n, 2)."""

    genes: Doubles
    starts: Doubles
    goals: Doubles
    people: Doubles

    def curves(self) -> Doubles:
        """(n, POINTS, 2): a Catmull-Rom curve through start, waypoints and goal."""
        start, goal = self.starts[:, :2], self.goals
        way = goal - start
        length = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-6)
        side = np.stack([-way[:, 1], way[:, 0]], axis=1) / length
        parts = np.arange(1, WAYPOINTS + 1) / (WAYPOINTS + 1)
        along = parts + 0.25 * self.genes[:, ALONG]
        across = self.genes[:, ACROSS]
        inner = start[:, None] + along[..., None] * way[:, None] + across[..., None] * side[:, None]
        knots = np.concatenate([start[:, None], inner, goal[:, None]], axis=1)
        padded = np.concatenate([2 * knots[:, :1] - knots[:, 1:2], knots, 2 * knots[:, -1:] - knots[:, -2:-1]], axis=1)
        t = np.linspace(0, WAYPOINTS + 1, POINTS)
        k = np.minimum(t.astype(int), WAYPOINTS)
        u = (t - k)[None, :, None]
        p0, p1, p2, p3 = (padded[:, k + j] for j in range(4))
        curve: Doubles = 0.5 * (
            2 * p1 + (p2 - p0) * u + (2 * p0 - 5 * p1 + 4 * p2 - p3) * u**2 + (3 * p1 - p0 - 3 * p2 + p3) * u**3
        )
        return curve

    def steer(self, w_max: float) -> Callable[[FastEngine, NDArray[np.int64]], NDArray[np.float32]]:
        curves = self.curves()
        genes = self.genes
        at = np.zeros(len(genes), dtype=np.int64)
        squash = 1 / (1 + np.exp(-genes[:, [NEAR, FAR]] * 2))
        near, far = np.clip(squash * 1.3, LOWEST_SPEED, 1.0).T
        ahead = 0.25 + 0.45 / (1 + np.exp(-genes[:, AHEAD]))
        gain = 0.35 + 0.65 / (1 + np.exp(-genes[:, GAIN]))
        in_place = 0.25 + 1.3 / (1 + np.exp(-genes[:, IN_PLACE]))

        def act(engine: FastEngine, running: NDArray[np.int64]) -> NDArray[np.float32]:
            poses = engine.poses[running]
            i, reach = at[running], ahead[running]
            while True:  # the first point of the curve farther than `reach`
                offset = curves[running, i] - poses[:, :2]
                close = (np.hypot(offset[:, 0], offset[:, 1]) < reach) & (i < POINTS - 1)
                if not close.any():
                    break
                i = i + close
            at[running] = i
            error = np.arctan2(offset[:, 1], offset[:, 0]) - poses[:, 2]
            error = (error + np.pi) % (2 * np.pi) - np.pi
            turn = np.clip(gain[running] * error / (w_max * CONTROL_DT_S), -1, 1)
            apart = np.linalg.norm(poses[:, :2] - self.people[running], axis=1)
            beside = (engine.human_distance[running] if engine.setup.crowded else apart) < NEAR_M
            speed = np.where(beside, near[running], far[running])
            speed = np.where(np.abs(error) > in_place[running], 0.0, speed)
            return np.stack([2 * speed - 1, turn], axis=1).astype(np.float32)

        return act


def _beside(guides: Sequence[NDArray[np.floating[Any]]], starts: Doubles, goals: Doubles) -> Doubles:
    """(n, 2 WAYPOINTS) the waypoints of curves through these rollouts."""
    rows = []
    for guide, start, goal in zip(guides, starts, goals, strict=True):
        way = goal - start
        length = max(float(np.linalg.norm(way)), 1e-6)
        parts = np.arange(1, WAYPOINTS + 1) / (WAYPOINTS + 1)
        points = np.asarray(guide, dtype=float)[np.round(parts * (len(guide) - 1)).astype(int), :2] - start
        along = (points @ way / length**2 - parts) / 0.25
        across = points @ np.array([-way[1], way[0]]) / length
        rows.append(np.concatenate([along, across]))
    return np.stack(rows)


def plan_rollouts(
    scenes: Sequence[Scene],
    weights: Doubles,
    config: PlannerConfig | None = None,
    guides: Sequence[NDArray[np.floating[Any]]] | None = None,
) -> tuple[Doubles, MeasuredRollouts]:
    """(n,) the most that a planned rollout that arrives gains by preference weights (9,), in typical differences
    (NOT_ARRIVED where none does), and what the best rollouts measured.

    guides: (steps, 2 or more) positions per scene of somebody's drive, which the search begins beside; None: beside the
    straight way.
    """
    config = config or PlannerConfig()
    n, copies = len(scenes), config.copies
    repeated = [scene for scene in scenes for _ in range(copies)]
    course = Course(repeated, blind=True)
    setup = get_setup(scenes[0].setup)
    starts = np.array([(s.start.x, s.start.y, s.start.yaw) for s in repeated])
    goals = np.array([(s.goal.x, s.goal.y) for s in repeated])
    people = np.array([(s.person.pose.x, s.person.pose.y) for s in repeated])
    typical = typical_differences(setup.name)
    straight = np.linalg.norm(goals - starts[:, :2], axis=1).max() / setup.robot.limits.v_max / CONTROL_DT_S
    waits = [k for k, name in enumerate(names_of(setup.name)) if name in ("slower_near_person", "waits")]
    most = None if weights[waits].any() else round(PATIENCE * straight)
    random = np.random.default_rng([config.seed, 72])
    mean = np.zeros((n, 1, SIZE))
    mean[..., [NEAR, FAR]] = 1.0  # full speed, to begin with
    if guides is not None:
        mean[:, 0, : 2 * WAYPOINTS] = _beside(guides, starts[::copies, :2], goals[::copies])
    deviation = np.full((n, 1, SIZE), config.spread)
    best = np.full(n, NOT_ARRIVED)
    first_genes = mean[:, 0].copy()
    measured = np.zeros((n, len(typical)))
    crossings = np.zeros(n, dtype=np.int32)
    for _ in range(config.rounds):
        genes = mean + deviation * random.normal(size=(n, copies, SIZE))
        genes[:, 0] = first_genes
        genes[:, 1 : copies // 3] = mean + 0.3 * (genes[:, 1 : copies // 3] - mean)  # some stay close by
        curves = _Curves(genes.reshape(-1, SIZE), starts, goals, people)
        rolled_out = course.steered(curves.steer(setup.robot.limits.w_max), most)
        gained = gains(rolled_out.measured / typical) @ weights
        scores = np.where(rolled_out.success, gained, NOT_ARRIVED + 0.1 * gained.clip(-100, 100)).reshape(n, copies)
        order = np.argsort(-scores, axis=1)
        first = order[:, 0]
        rows = np.arange(n)
        better = scores[rows, first] > best
        best = np.where(better, scores[rows, first], best)
        first_genes[better] = genes[rows, first][better]
        measured[better] = rolled_out.measured.reshape(n, copies, -1)[rows, first][better]
        crossings[better] = rolled_out.self_intersections.reshape(n, copies)[rows, first][better]
        elite = np.take_along_axis(genes, order[:, : config.survivors, None], axis=1)
        mean = elite.mean(1, keepdims=True)
        deviation = np.maximum(0.85 * elite.std(1, keepdims=True) + 0.15 * deviation * 0.8, 0.02)
    arrived = best > NOT_ARRIVED / 2
    return np.where(arrived, best, NOT_ARRIVED), MeasuredRollouts(arrived.astype(np.int8), measured, crossings)
