"""The choice between policies on a robot: what its topics tell, as `deciding.py` takes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from desirepath.deploy.inputs import Odometry, Person, Scan, place_laser
from desirepath.deploy.inputs import Pose as Place
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.policies.choosing import ChoosingPolicy
from desirepath.learning.policies.deciding import EVERY_S, Chooser, OnItsWay, Told
from desirepath.learning.policies.policy import Floats, PolicyError, read_policy
from desirepath.simulation.scene import Pose
from desirepath.simulation.setups import CONTROL_DT_S, get_setup


class RobotChoice:
    """A `deploy.deciding.Decider`: with the first step, and again every second, from where the last step began."""

    def __init__(self, policy: ChoosingPolicy) -> None:
        self._policy = policy
        self._chooser = Chooser(policy.setup, policy.side_by_side, policy.gains)
        self._every = max(1, round(EVERY_S / CONTROL_DT_S))
        self.begin((0.0, 0.0, 0.0))
        self._warm_up()

    @classmethod
    def read(cls, content: bytes) -> Self:
        """Of a policy's file. Raises PolicyError for another one than a choice per scene."""
        policy = read_policy(content)
        if not isinstance(policy, ChoosingPolicy):
            raise PolicyError(f"{type(policy).__name__}: is one policy; there is nothing to choose")
        return cls(policy)

    def begin(self, laser: Place) -> None:
        self._laser = laser
        self._goal: tuple[float, float] | None = None
        self._drives: OnItsWay | None = None
        self._acts: Floats | None = None

    def stepped(
        self,
        scan: Scan,
        odometry: Odometry,
        goal: tuple[float, float],
        people: Sequence[Person],
        observation: Floats,
        action: Floats,
    ) -> None:
        if self._drives is None or self._goal != goal:
            self._goal = goal
            self._drives = OnItsWay(self._chooser, goal, get_setup(self._policy.setup).goal_radius_m)
        elif self._acts is not None:
            self._drives.acted(self._acts)
        told = [Told(one.x, one.y, one.v_x, one.v_y) for one in people]
        ended = _ended(scan, odometry, self._laser, self._chooser.setup)
        self._drives.see(Pose(odometry.x, odometry.y, odometry.yaw), ended, len(scan.ranges), told, observation)
        self._acts = action

    def ask(self) -> Callable[[], int] | None:
        if self._drives is None or self._drives.steps % self._every:
            return None
        return self._drives.ask()

    def _warm_up(self) -> None:
        """Compiles what a decision needs, before anything drives."""
        setup = get_setup(self._policy.setup)
        ended = np.array([[4.0, 0.1 * k] for k in range(-20, 20)])
        nothing = np.ones(setup.observation_size, dtype=np.float32)
        for v_x in (0.0, -0.5):
            drive = OnItsWay(self._chooser, (2.0, 0.0), setup.goal_radius_m)
            drive.see(Pose(0.0, 0.0), ended, len(ended), [Told(1.0, 2.0, v_x)], nothing)
            drive.ask()()


def _ended(scan: Scan, at: Odometry, laser: Place, setup: str) -> Doubles:
    """(n, 2) where beams ended that met something within what the policies' lidar sees, in the odometry's frame."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    furthest = min(scan.range_max, get_setup(setup).robot.lidar.range_m)
    met = np.flatnonzero(np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges < furthest - 1e-3))
    x, y, yaw = place_laser((at.x, at.y, at.yaw), laser)
    angles = yaw + scan.angles[met]
    return np.column_stack([x + ranges[met] * np.cos(angles), y + ranges[met] * np.sin(angles)])
