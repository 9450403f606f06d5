"""The fast engine with what real robots get wrong: a noisy lidar, late commands, wheels that slip or are slow.

For training that meets them (domain randomisation, Tobin et al. 2017) and for measuring what they cost. Scenes, rewards
and the compiled step are `FastEngine`'s: only the commands that it executes, and its lidar's errors, are others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.fast import EngineOptions, FastEngine, Floats
from desirepath.simulation.setups import CONTROL_DT_S, Setup, SetupError

LONGEST_DELAY_S = 1.0
TRACK = 1.28  # distance between the wheels, of the robot's radius: Kobuki's 0.23 m at 0.18 m


@dataclass(frozen=True)
class Disturbances:
    """noise_m: standard deviation of a lidar range, beam by beam. delay_s: from a scan to the wheels. slip: the largest
    share of a wheel's turning that moves nothing, each wheel's drawn anew in every step. slow: the share of their speed
    that wheels lack."""

    noise_m: float = 0.0
    delay_s: float = 0.0
    slip: float = 0.0
    slow: float = 0.0

    def __post_init__(self) -> None:
        most = {"noise_m": 1.0, "delay_s": LONGEST_DELAY_S, "slip": 0.9, "slow": 0.9}
        for name, largest in most.items():
            if not 0 <= getattr(self, name) <= largest:
                raise SetupError(f"{name} = {getattr(self, name):g}: must be from 0 to {largest:g}")


RANDOMISED = Disturbances(noise_m=0.03, delay_s=0.2, slip=0.3, slow=0.4)
"""The most that training with `--randomise` meets; ours, a third more than what is reported on."""


def slipping(
    v: NDArray[np.float64], w: NDArray[np.float64], radius_m: float, lost: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speeds v, w (n,) of a robot of which the left and the right wheel lose these shares (n, 2) of their turning."""
    half = TRACK * radius_m / 2
    left, right = (v - w * half) * (1 - lost[:, 0]), (v + w * half) * (1 - lost[:, 1])
    return (left + right) / 2, (right - left) / (2 * half)


class DisturbedEngine(FastEngine):
    """drawn: every episode has a delay, a slip and a slowness of its own, anywhere up to those given; else all have
    those. Lidar noise is the same in all. Observed v and w are those of the wheels at the end of a step: what odometry
    says, which sees no slip."""

    def __init__(
        self,
        setup: Setup,
        n_envs: int,
        disturbances: Disturbances,
        *,
        drawn: bool = False,
        **options: Unpack[EngineOptions],
    ) -> None:
        """Raises SetupError for a setup with pedestrians."""
        if setup.crowded:
            raise SetupError(f"setup {setup.name} has pedestrians: nothing is disturbed among them")
        self.disturbances, self._drawn = disturbances, drawn
        self._chance = np.random.default_rng([options.get("seed", 0), 0xD157])
        self._levels = np.zeros((n_envs, 3))  # delay in steps, slip, slow
        whole = int(np.ceil(LONGEST_DELAY_S / CONTROL_DT_S)) + 2
        self._told = np.zeros((n_envs, whole, 2))  # v, w, newest first
        lidar = setup.robot.lidar
        noisy = replace(lidar, noise_m=float(np.hypot(lidar.noise_m, disturbances.noise_m)))
        super().__init__(replace(setup, robot=replace(setup.robot, lidar=noisy)), n_envs, **options)

    def _start(self, which: NDArray[np.int64], rows: k.Rows) -> None:
        most = self.disturbances
        share = self._chance.random((len(which), 3)) if self._drawn else 1.0
        self._levels[which] = np.array([most.delay_s / CONTROL_DT_S, most.slip, most.slow]) * share
        self._told[which] = 0.0
        super()._start(which, rows)

    def step(self, actions: Floats) -> None:
        """As `FastEngine.step`, of what becomes of the actions."""
        setup, robots, steps = self.setup, np.arange(self.n_envs), self._levels[:, 0]
        limits, slow = setup.robot.limits, 1 - self._levels[:, 2]
        told = np.clip(np.asarray(actions, np.float64), -1, 1) * ((limits.v_max - limits.v_min) / 2, limits.w_max)
        told[:, 0] += (limits.v_max + limits.v_min) / 2
        change = np.array([limits.v_change or np.inf, limits.w_change or np.inf]) * CONTROL_DT_S
        self._told[:, 1:] = self._told[:, :-1]
        self._told[:, 0] = np.clip(told, self._told[:, 1] - change, self._told[:, 1] + change)
        late = steps.astype(np.int64)
        part = (steps - late)[:, None]
        now, before = self._told[robots, late], self._told[robots, late + 1]
        v, w = ((1 - part) * now + part * before).T  # of a step in which the command changes
        lost = 1 - slow[:, None] * (1 - self._levels[:, 1, None] * self._chance.random((self.n_envs, 2)))
        v, w = slipping(v, w, setup.robot.radius_m, lost)
        v = (v - (limits.v_max + limits.v_min) / 2) / ((limits.v_max - limits.v_min) / 2)
        super().step(np.clip(np.stack([v, w / limits.w_max], axis=1), -1, 1).astype(np.float32))
        if setup.with_velocity and not setup.solids:
            measured = (slow[:, None] * now / (limits.v_max, limits.w_max)).astype(np.float32)
            speeds = slice(setup.polar_size - 2, setup.polar_size)
            self.next_observations[:, speeds] = measured
            goes_on = ~self.dones
            self.observations[goes_on, speeds] = measured[goes_on]


def randomised_engine(setup: Setup, n_envs: int, **options: Unpack[EngineOptions]) -> DisturbedEngine:
    """As `make_engine`, with every episode disturbed in its own way, up to `RANDOMISED`: to train in. Raises SetupError
    for a setup with pedestrians."""
    return DisturbedEngine(setup, n_envs, RANDOMISED, drawn=True, **options)
