"""Driving slowly beside the person, by a rule: what a policy commands there is scaled down, forwards and turning alike.

A function of what is observed, so every engine has it at once. Who drives by it, and how slowly, is the policies'.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.setups import Setup, SetupError

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Slowing:
    """At most the share `most` of full speed within `near_m` of the person, all of it from `free_m` on, linear between.

    Turning is scaled as forward speed is, so that the robot drives about the same way, only later. Lengths in metres
    between the centres. Ours.
    """

    near_m: float = 2.0
    free_m: float = 3.0
    most: float = 0.3

    def __post_init__(self) -> None:
        if not 0 < self.near_m <= self.free_m:
            raise SetupError(
                f"slowing near_m = {self.near_m:g}, free_m = {self.free_m:g}: 0 < near_m <= free_m is needed"
            )
        if not 0 < self.most <= 1:
            raise SetupError(f"slowing most = {self.most:g}: a share of full speed above 0, at most 1, is needed")

    def weighted(self, weight: float) -> Slowing | None:
        """The rule for who gives slowness this weight in [0, 1]; None at 0: nothing is slowed."""
        if weight <= 0:
            return None
        return Slowing(self.near_m, self.free_m, weight * self.most + (1 - weight))

    def limited(self, actions: Floats, observations: Floats, setup: Setup) -> Floats:
        """(n, 2) actions in [-1, 1] and the (n, obs) states they are taken in -> the actions with this limit.

        Raises SetupError where the person's distance is not observed, or where the slowest speed is not standing.
        """
        place = person_distance_input(setup)
        distance = observations[:, place] * np.float32(setup.distance_scale_m)
        far = (distance - self.near_m) / max(self.free_m - self.near_m, 1e-6)
        limit = self.most + (1 - self.most) * np.clip(far, 0, 1)
        forward = (actions[:, 0] + 1) / 2  # of full speed
        fast = forward > limit
        limited = actions.copy()
        limited[fast, 0] = (2 * limit - 1)[fast]
        limited[fast, 1] *= (limit / np.maximum(forward, 1e-6))[fast]
        return limited

    def as_dict(self) -> dict[str, Any]:
        """For files, manifests and cards."""
        return asdict(self)


def person_distance_input(setup: Setup) -> int:
    """Where the person's distance is observed. Raises SetupError where it is not, or where a robot cannot stand."""
    if setup.person_inputs is None:
        raise SetupError(f"setup {setup.name}: the person's distance is not observed, so nothing can be slowed by it")
    if setup.robot.limits.v_min != 0:
        raise SetupError(
            f"setup {setup.name}: v_min = {setup.robot.limits.v_min}; shares of full speed begin at standing"
        )
    return setup.person_inputs[0]
