"""Who of several policies drives: what whoever decides hears of a drive, and says.

Deciding takes an engine and what somebody answered, which a robot's own program has not: it comes from outside
(`learning/policies/robot_choice.py`). Without, the usual policy drives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.inputs import Odometry, Person, Pose, Scan

Floats = NDArray[np.float32]


class Decider(Protocol):
    """Of one bundle. It hears every step, and is asked after it."""

    def begin(self, laser: Pose) -> None:
        """Another drive begins, by the usual policy. laser: where the lidar is, in the robot's frame."""
        ...

    def stepped(
        self,
        scan: Scan,
        odometry: Odometry,
        goal: tuple[float, float],
        people: Sequence[Person],
        observation: Floats,
        action: Floats,
    ) -> None:
        """What was heard in a step, observed (obs,), and done (2,) in [-1, 1]."""
        ...

    def ask(self) -> Callable[[], int] | None:
        """A function that says the place of the policy that drives from now on; None: it is not time to decide. Asking
        takes no time; the function does, and may be called in another thread."""
        ...
