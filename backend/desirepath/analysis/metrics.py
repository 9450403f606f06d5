"""Trajectory metrics: pure functions on arrays, vectorised over many trajectories.

Statistical tests and reports live elsewhere. Trajectories of different lengths are stacked by repeating their last
pose, which adds nothing to any sum or minimum here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from desirepath.simulation import kernels
from desirepath.simulation.fast import clearance_m
from desirepath.simulation.scene import Scene
from desirepath.simulation.social_metrics import SocialMetrics, social_metrics
from desirepath.simulation.trajectory import Outcome, Trajectory

Array = NDArray[np.float64]


def success_rate(outcomes: ArrayLike) -> float:
    """Share of episodes that reached the goal, of outcomes (n,). NaN for none."""
    return _share(outcomes, Outcome.SUCCESS)


def collision_rate(outcomes: ArrayLike) -> float:
    """Share of episodes that ended by touching something, of outcomes (n,). NaN for none."""
    return _share(outcomes, Outcome.COLLISION)


def timeout_rate(outcomes: ArrayLike) -> float:
    """Share of episodes that ran out of steps, of outcomes (n,). NaN for none."""
    return _share(outcomes, Outcome.TIMEOUT)


def _share(outcomes: ArrayLike, which: Outcome) -> float:
    values = np.asarray(outcomes)
    return float((values == which).mean()) if values.size else float("nan")


def stack_poses(trajectories: Sequence[Trajectory]) -> Array:
    """The poses of all trajectories, the shorter ones held at their last pose: (n, longest + 1, 3)."""
    longest = max((len(t.poses) for t in trajectories), default=0)
    stacked = np.zeros((len(trajectories), longest, 3))
    for row, trajectory in zip(stacked, trajectories, strict=True):
        row[: len(trajectory.poses)] = trajectory.poses
        row[len(trajectory.poses) :] = trajectory.poses[-1]
    return stacked


def path_length(poses: ArrayLike) -> Array:
    """Path length in metres, of poses (n, T + 1, 2 or more): (n,)."""
    return np.asarray(np.linalg.norm(np.diff(np.asarray(poses, dtype=float)[..., :2], axis=1), axis=2).sum(axis=1))


def accumulated_angle(poses: ArrayLike) -> Array:
    """Sum of absolute heading changes (rad), of poses (n, T + 1, 3): (n,). Less than half a turn per step."""
    turns = np.diff(np.asarray(poses, dtype=float)[..., 2], axis=1)
    return np.asarray(np.abs((turns + np.pi) % (2 * np.pi) - np.pi).sum(axis=1))


def min_human_distance(poses: ArrayLike, persons: ArrayLike) -> Array:
    """Smallest centre-to-centre distance (m) between poses (n, T + 1, 2 or more) and persons: (n,).

    persons: (n, 2 or more) who stand, or (n, T + 1, 2 or more) who walk; poses of one robot, (1, T + 1, 2 or more),
    are held against all n of them.
    """
    people = np.asarray(persons, dtype=float)
    offsets = np.asarray(poses, dtype=float)[..., :2] - (people if people.ndim == 3 else people[:, None])[..., :2]
    return np.asarray(np.linalg.norm(offsets, axis=2).min(axis=1))


def min_obstacle_distance(poses: ArrayLike, scenes: Sequence[Scene]) -> Array:
    """Smallest distance (m) from the robot's surface to an obstacle or wall, the person not counted: (n,).

    poses (n, T + 1, 2 or more), one scene each, with yaw where the robot is a polygon; infinite in an empty field.
    """
    paths = np.asarray(poses, dtype=float)
    return np.array([clearance_m(scene, path) for path, scene in zip(paths, scenes, strict=True)])


def path_area(poses: ArrayLike, goals: ArrayLike) -> Array:
    """Area (m^2) between each path (n, T + 1, 2 or more) and its straight line from start to goal (n, 2): (n,).

    The "area under path" of chapter 7: lobes on either side count with their absolute areas; the perpendicular from
    the path's end closes the last one.
    """
    paths, ends = np.asarray(poses, dtype=float)[..., :2], np.asarray(goals, dtype=float)
    return np.array(
        [
            kernels.path_area(np.ascontiguousarray(path), goal[0], goal[1])
            for path, goal in zip(paths, ends, strict=True)
        ]
    )


def straight_distance(starts: ArrayLike, goals: ArrayLike) -> Array:
    """Metres from starts to goals, both (n, 2 or more): (n,)."""
    return np.asarray(
        np.linalg.norm(np.asarray(goals, dtype=float)[:, :2] - np.asarray(starts, dtype=float)[:, :2], axis=1)
    )


def relative_path_length(lengths: ArrayLike, straight: ArrayLike) -> Array:
    """Path length over straight distance, both (n,) metres: (n,), 1 for a perfect line that ends on the goal.

    A trajectory ends inside the goal radius, so values slightly below 1 are possible.
    """
    return np.asarray(np.asarray(lengths, dtype=float) / np.asarray(straight, dtype=float))


def mean_speed(lengths: ArrayLike, times: ArrayLike) -> Array:
    """Metres per second, of lengths (n,) m and times (n,) s: (n,). 0 where no time passed."""
    metres, seconds = np.asarray(lengths, dtype=float), np.asarray(times, dtype=float)
    return np.asarray(np.divide(metres, seconds, out=np.zeros_like(metres), where=seconds > 0))


def action_diversity(actions: ArrayLike) -> float:
    """Ensemble action diversity (ch. 6): mean over states and members i of sum_{j != i} ||a_i - a_j||^2.

    actions: (members, states, 2), what each member would do in the same states. Raises ValueError for fewer than two
    members or no state.
    """
    a = np.asarray(actions, dtype=float)
    if a.ndim != 3 or a.shape[0] < 2 or a.shape[1] < 1:
        raise ValueError(f"actions have shape {a.shape}, must be (members >= 2, states >= 1, action size)")
    # sum_ij |a_i - a_j|^2 = 2 m sum_i |a_i - mean|^2, so the mean over i needs no (members x members) table.
    return float(2 * ((a - a.mean(axis=0)) ** 2).sum(axis=(0, 2)).mean())


@dataclass(frozen=True)
class TrajectoryMetrics:
    """Metrics of n trajectories, each array (n,), SI units; distances as in the functions of the same names,
    min_human_distance to whoever comes nearest, NaN where no people were recorded. social: of the same trajectories."""

    outcome: NDArray[np.int8]
    steps: NDArray[np.int64]
    time: Array
    path_length: Array
    mean_speed: Array
    accumulated_angle: Array
    min_human_distance: Array
    min_obstacle_distance: Array
    path_area: Array
    straight_distance: Array
    relative_path_length: Array
    social: SocialMetrics


def measure(trajectories: Sequence[Trajectory]) -> TrajectoryMetrics:
    """All metrics of each trajectory. Raises ValueError for none."""
    if not trajectories:
        raise ValueError("trajectories: none given")
    poses = stack_poses(trajectories)
    scenes = [t.scene for t in trajectories]
    people = [t.scene.people_at(t.times) for t in trajectories]
    goals = np.array([(s.goal.x, s.goal.y) for s in scenes])
    times = np.array([t.duration_s for t in trajectories])
    outcomes = np.array([t.outcome for t in trajectories], dtype=np.int8)
    lengths, straight = path_length(poses), straight_distance(poses[:, 0], goals)
    turned = accumulated_angle(poses)
    return TrajectoryMetrics(
        outcome=outcomes,
        steps=np.array([len(t.actions) for t in trajectories]),
        time=times,
        path_length=lengths,
        mean_speed=mean_speed(lengths, times),
        accumulated_angle=turned,
        min_human_distance=np.array(
            [
                min_human_distance(t.poses[None], who).min() if len(who) else np.nan
                for t, who in zip(trajectories, people, strict=True)
            ]
        ),
        min_obstacle_distance=min_obstacle_distance(poses, scenes),
        path_area=path_area(poses, goals),
        straight_distance=straight,
        relative_path_length=relative_path_length(lengths, straight),
        social=social_metrics(
            [t.poses[:, :2].astype(float) for t in trajectories],
            scenes,
            success=outcomes == Outcome.SUCCESS,
            path_length=lengths,
            accumulated_angle=turned,
            dt=np.array([t.dt for t in trajectories]),
            people=people,
        ),
    )
