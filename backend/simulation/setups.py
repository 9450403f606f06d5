"""The setups: a scene generator, robot limits, observation layout and core reward that belong together.

A policy, buffer or query set belongs to exactly one setup; `require_same` refuses a mix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

CONTROL_DT_S = 0.2  # 5 Hz everywhere, spec 00
ROBOT_RADIUS_M = 0.18  # Kobuki TurtleBot 2, spec 01


class SetupError(ValueError):
    """An unknown setup, or things of two setups mixed."""


@dataclass(frozen=True)
class Limits:
    """Robot command limits: v in [v_min, v_max] m/s, w in [-w_max, w_max] rad/s. Never backwards."""

    v_min: float
    v_max: float
    w_max: float = math.pi


@dataclass(frozen=True)
class Lidar:
    """`beams` rays over 360 degrees from straight ahead, counter-clockwise, pooled by minimum into `sectors`."""

    beams: int
    sectors: int
    range_m: float
    height_m: float = 0.3


@dataclass(frozen=True)
class CoreReward:
    """The task reward r of a setup, without any preference and without the training-only progress term."""

    goal: float
    collision: float
    timeout: float
    self_intersection: float
    time_per_step: float = 0.0
    jerk_weight: float = 0.0


@dataclass(frozen=True)
class Setup:
    """Everything a policy is bound to. Observation: float32 vector of

    [goal distance / distance_scale_m, goal bearing / pi, person distance / distance_scale_m, person bearing / pi,
     (v / v_max, w / w_max if with_velocity), sector ranges / lidar range ...].
    """

    name: str
    limits: Limits
    lidar: Lidar
    reward: CoreReward
    goal_radius_m: float
    max_steps: int
    gamma: float
    with_velocity: bool
    distance_scale_m: float = 10.0
    self_intersection_min_age_steps: int = 4

    @property
    def polar_size(self) -> int:
        """Length of the task part of the observation (everything before the lidar)."""
        return 6 if self.with_velocity else 4

    @property
    def observation_size(self) -> int:
        return self.polar_size + self.lidar.sectors

    def observation_layout(self) -> list[dict[str, object]]:
        """One entry per input, in order: name, unit, scale that was applied; written into every policy's manifest."""
        polar: list[dict[str, object]] = [
            {"name": "goal_distance", "unit": "m", "divided_by": self.distance_scale_m},
            {"name": "goal_bearing", "unit": "rad", "divided_by": math.pi},
            {"name": "person_distance", "unit": "m", "divided_by": self.distance_scale_m},
            {"name": "person_bearing", "unit": "rad", "divided_by": math.pi},
        ]
        if self.with_velocity:
            polar += [
                {"name": "linear_velocity", "unit": "m/s", "divided_by": self.limits.v_max},
                {"name": "angular_velocity", "unit": "rad/s", "divided_by": self.limits.w_max},
            ]
        return polar + [
            {"name": f"lidar_{i}", "unit": "m", "divided_by": self.lidar.range_m} for i in range(self.lidar.sectors)
        ]


OPEN_FIELD = Setup(
    name="open_field",  # ch. 6; table 6.1
    limits=Limits(0.0, 0.5),
    lidar=Lidar(beams=360, sectors=30, range_m=6.0),
    reward=CoreReward(goal=20.0, collision=-1.2, timeout=-20.0, self_intersection=-2.0),
    goal_radius_m=0.4,
    max_steps=500,
    gamma=0.98,
    with_velocity=False,
)
STUDY_ROOM = Setup(
    name="study_room",  # ch. 7; equation 7.1 and the public code
    limits=Limits(0.0, 1.0),
    lidar=Lidar(beams=720, sectors=60, range_m=6.0),
    reward=CoreReward(
        goal=20.0,
        collision=-20.0,
        timeout=-1.0,
        self_intersection=-2.0,
        time_per_step=-0.001,
        jerk_weight=0.0005,
    ),
    goal_radius_m=0.36,
    max_steps=500,
    gamma=0.98,
    with_velocity=True,
)
SETUPS = {setup.name: setup for setup in (OPEN_FIELD, STUDY_ROOM)}


def get_setup(name: str) -> Setup:
    """The setup of that name. Raises SetupError listing the known ones."""
    try:
        return SETUPS[name]
    except KeyError:
        raise SetupError(f"unknown setup {name!r}; known: {', '.join(SETUPS)}") from None


def require_same(**named: str) -> str:
    """The one setup that all the named things share. Raises SetupError naming who differs."""
    if len(set(named.values())) != 1:
        raise SetupError("setups differ: " + ", ".join(f"{who} is {name}" for who, name in named.items()))
    return next(iter(named.values()))
