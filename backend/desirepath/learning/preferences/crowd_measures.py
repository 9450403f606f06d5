"""What a person compares two trajectories among pedestrians by: seven measures, read from what the robot observed.

They stand in the places of `measures.TABLE` whose units and signs the objectives need: distance to the nearest, whose
way is cut, following, moving on beside people, turning, speed beside people, time. All ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.setups import Setup
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.floating[Any]]
Doubles = NDArray[np.float64]

WALKS_M_S = 0.1  # slower counts as standing
BESIDE_M = 2.5  # from there on a walking person's way can be cut
FOLLOWING_M, FOLLOWING_BAND_M = 1.3, 1.0  # behind somebody at this distance, give or take
MOVES_M_S = 0.3  # from this speed on a robot counts as moving on
NEAR_M, BAND_M = 2.0, 0.5  # as `measures.near_person_m`


@dataclass(frozen=True)
class Surroundings:
    """The pedestrians that a robot is told of, of n observations: (n, K) each, the nearest first.

    away: m, centre to centre; ahead: where the robot is as the pedestrian sees it, cosine, +1 straight ahead of who
    walks, -1 behind, 0 of who stands; along: cosine between both headings; walks: whether they do.
    """

    observations: Floats
    setup: Setup

    @cached_property
    def _of_each(self) -> tuple[Doubles, Doubles, Doubles, Doubles]:
        """away (m), bearing (rad), motion along and across the robot's heading (m/s)."""
        first, count = 2, self.setup.pedestrians
        block = self.observations[:, first : first + 4 * count].reshape(-1, count, 4).astype(np.float64)
        return block[..., 0] * self.setup.distance_scale_m, block[..., 1] * np.pi, block[..., 2], block[..., 3]

    @property
    def away(self) -> Doubles:
        return self._of_each[0]

    @cached_property
    def pace(self) -> Doubles:
        return np.hypot(self._of_each[2], self._of_each[3])

    @property
    def walks(self) -> NDArray[np.bool_]:
        return np.asarray(self.pace > WALKS_M_S)

    @cached_property
    def ahead(self) -> Doubles:
        _, bearing, along, across = self._of_each
        cosine = -(np.cos(bearing) * along + np.sin(bearing) * across) / np.maximum(self.pace, 1e-9)
        return np.where(self.walks, cosine, 0.0)

    @cached_property
    def along(self) -> Doubles:
        return np.where(self.walks, self._of_each[2] / np.maximum(self.pace, 1e-9), 0.0)

    @cached_property
    def beside(self) -> Doubles:
        """How near who walks is: 1 at contact, 0 from 2.5 m on, and for who stands."""
        return np.where(self.walks, np.square(np.clip(1 - self.away / BESIDE_M, 0, 1)), 0.0)

    @cached_property
    def in_front(self) -> Doubles:
        """(n,) in [0, 1]: how much the robot is in somebody's way: straight ahead, the nearer the more."""
        return np.asarray((np.sqrt(self.beside) * np.clip(self.ahead, 0, 1)).max(axis=1))

    @cached_property
    def behind(self) -> Doubles:
        """(n,) in [0, 1]: how much it is behind somebody."""
        return np.asarray((np.sqrt(self.beside) * np.clip(-self.ahead, 0, 1)).max(axis=1))

    @cached_property
    def followed(self) -> Doubles:
        """(n,) in [0, 1]: how much the robot walks after somebody, at 1.3 m, heading as they do."""
        spaced = np.clip(1 - np.abs(self.away - FOLLOWING_M) / FOLLOWING_BAND_M, 0, 1)
        each = spaced * np.clip(-self.ahead, 0, 1) * np.clip(self.along, 0, 1)
        return np.asarray(each.max(axis=1))

    @cached_property
    def nearest_walking(self) -> Doubles:
        """(n,) m, infinite where nobody whom the robot is told of walks."""
        return np.asarray(np.where(self.walks, self.away, np.inf).min(axis=1))


class CrowdRecord:
    """What the measures read of the steps of n robots, each noted once, then judged as a whole."""

    def __init__(self, setup: Setup, steps: int, robots: int) -> None:
        self._setup = setup
        shape = (steps, robots)
        self._ahead, self._beside, self._followed = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._speeds, self._running = np.zeros(shape), np.zeros(shape, np.bool_)
        self._nearest, self._walking = np.full(shape, np.inf), np.full(shape, np.inf)

    def note(
        self, step: NDArray[np.int64] | int, robots: NDArray[np.int64] | int, seen: Floats, speeds: Doubles
    ) -> None:
        """seen: observations that a step led to; speeds: m/s, as moved; steps and robots: where they belong."""
        around, at = Surroundings(seen, self._setup), (step, robots)
        self._nearest[at], self._walking[at] = around.away[:, 0], around.nearest_walking
        self._ahead[at] = (around.ahead * around.beside).sum(axis=1)
        self._beside[at] = around.beside.sum(axis=1)
        self._followed[at], self._speeds[at], self._running[at] = around.followed, speeds, True

    def columns(self) -> dict[str, Doubles]:
        """The measures that need them, (n,) each, by name."""
        return {
            "ahead_of_people": self._ahead.sum(axis=0) / np.maximum(self._beside.sum(axis=0), 1e-9),
            "following": self._followed.sum(axis=0) / np.maximum(self._running.sum(axis=0), 1),
            "moving_beside_people": _mean_near(np.clip(self._speeds / MOVES_M_S, 0, 1), self._walking),
            "speed_near_person_m_s": _mean_near(self._speeds, self._nearest),
        }

    @property
    def nearest_m(self) -> Doubles:
        """(n,) least distance to a pedestrian after a step."""
        return np.asarray(self._nearest.min(axis=0))


def _mean_near(values: Doubles, away: Doubles) -> Doubles:
    """(n,) mean over the steps (T, n) in which somebody was near, 0 where nobody ever was seen."""
    near = (away <= np.maximum(NEAR_M, away.min(axis=0) + BAND_M)) & np.isfinite(away)
    return np.asarray((values * near).sum(axis=0) / np.maximum(near.sum(axis=0), 1))


def crowd_columns(trajectories: Sequence[Trajectory], setup: Setup) -> Mapping[str, Doubles]:
    """All seven measures, (n,) each, by name."""
    n = len(trajectories)
    lengths = np.array([len(trajectory.actions) for trajectory in trajectories])
    record = CrowdRecord(setup, int(lengths.max()), n)
    turned, first = np.zeros(n), np.zeros(n)
    for k, trajectory in enumerate(trajectories):
        poses = trajectory.poses.astype(np.float64)
        moved = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
        record.note(np.arange(lengths[k]), k, trajectory.next_observations, moved / trajectory.dt)
        turns = np.diff(poses[:, 2])
        turned[k] = np.abs((turns + np.pi) % (2 * np.pi) - np.pi).sum()
        first[k] = trajectory.observations[0, 2] * setup.distance_scale_m
    return {
        **record.columns(),
        "min_human_distance_m": np.minimum(first, record.nearest_m),
        "accumulated_angle_rad": turned,
        "time_s": np.array([trajectory.duration_s for trajectory in trajectories]),
    }
