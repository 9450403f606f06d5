"""A policy driven in another manner: slower, swerving, hesitating, keeping to free space, ... Trajectories of such
policies differ in more than the nine objectives.

Nothing is learned here: a manner changes what a policy does, drawn at random. The numbers are ours; they were chosen so
that about as many trajectories arrive as without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from desirepath.simulation.acting import ActFunction, EpisodeActs, EpisodicPolicy, Floats, Rows
from desirepath.simulation.setups import Setup


@dataclass(frozen=True)
class Manner:
    """speed: factor on the forward speed; near: another one within near_m of the person; last: another one on the
    second half of the way. wave: turning to and fro, with a period in steps; swerve: turning so much for so many steps
    at first, then back. stop: share of the speed that is missing for stop_steps of every stop_period. free, person:
    turning towards more free space, and towards (above 0) or away from the person. jerk: how much every other action
    differs."""

    speed: float = 1.0
    near: float = 1.0
    near_m: float = 2.0
    last: float = 1.0
    wave: float = 0.0
    wave_steps: float = 8.0
    swerve: float = 0.0
    swerve_steps: int = 6
    stop: float = 0.0
    stop_period: int = 12
    stop_steps: int = 3
    free: float = 0.0
    person: float = 0.0
    jerk: float = 0.0

    @classmethod
    def drawn(cls, random: np.random.Generator) -> Manner:
        """One at random: each part is as usual in about half of them."""
        return cls(
            speed=random.uniform(0.5, 1.0) if random.random() < 0.6 else 1.0,
            near=random.uniform(0.3, 1.0) if random.random() < 0.4 else 1.0,
            near_m=random.uniform(1.2, 2.5),
            last=random.uniform(0.5, 1.0) if random.random() < 0.3 else 1.0,
            wave=random.uniform(0.1, 0.6) if random.random() < 0.4 else 0.0,
            wave_steps=random.uniform(3, 16),
            swerve=random.uniform(-0.6, 0.6) if random.random() < 0.4 else 0.0,
            swerve_steps=int(random.integers(3, 12)),
            stop=random.uniform(0.3, 0.9) if random.random() < 0.35 else 0.0,
            stop_period=int(random.integers(6, 20)),
            stop_steps=int(random.integers(2, 4)),
            free=random.normal(0, 0.6) if random.random() < 0.5 else 0.0,
            person=random.normal(0, 0.8) if random.random() < 0.5 else 0.0,
            jerk=random.uniform(0.1, 0.4) if random.random() < 0.3 else 0.0,
        )


class MannerPolicy(EpisodicPolicy):
    """A policy that acts as another one does, in a manner."""

    def __init__(self, setup: Setup, usual: ActFunction, manner: Manner) -> None:
        self._setup, self._usual, self.manner = setup, usual, manner

    def act(self, observations: Floats) -> Floats:
        return self._usual(observations)

    def begin(self, episodes: int) -> EpisodeActs:
        passed = np.zeros(episodes, dtype=np.int64)
        way_m = np.zeros(episodes)

        def steer(observations: Floats, rows: Rows) -> Floats:
            step = passed[rows]
            passed[rows] += 1
            goal_m = observations[:, 0] * self._setup.distance_scale_m
            way_m[rows] = np.where(step == 0, goal_m, way_m[rows])
            return self._changed(observations, self._usual(observations), step, goal_m < way_m[rows] / 2)

        return steer

    def _changed(self, observations: Floats, actions: Floats, step: Rows, second_half: np.ndarray) -> Floats:
        manner, polar = self.manner, self._setup.polar_size
        speed, turn = (actions[:, 0].astype(np.float64) + 1) / 2, actions[:, 1].astype(np.float64)
        person_m, bearing = observations[:, 2] * self._setup.distance_scale_m, observations[:, 3] * math.pi
        lidar = observations[:, polar:]
        sectors = (np.arange(lidar.shape[1]) + 0.5) * 2 * math.pi / lidar.shape[1]
        speed = speed * manner.speed * np.where(person_m < manner.near_m, manner.near, 1.0)
        speed *= np.where(second_half, manner.last, 1.0)
        speed *= np.where(step % manner.stop_period < manner.stop_steps, 1 - manner.stop, 1.0)
        turn += manner.wave * np.sin(2 * math.pi * step / manner.wave_steps)
        turn += manner.swerve * (step < manner.swerve_steps)
        turn -= manner.swerve * ((step >= manner.swerve_steps) & (step < 2 * manner.swerve_steps))
        turn += 4 * manner.free * (lidar * np.sin(sectors) * (np.cos(sectors) > 0)).mean(1)
        turn += manner.person * np.sin(bearing) * np.clip(1.5 - person_m / 2, 0, 1) * (np.cos(bearing) > 0)
        turn += manner.jerk * np.where(step % 2 == 0, 1, -1)
        speed += 0.5 * manner.jerk * np.where(step % 4 < 2, 1, -1)
        return np.clip(np.stack([2 * speed - 1, turn], axis=1), -1, 1).astype(np.float32)
