"""Ways to drive that tests of several engines share; no test lives here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.acting import ActFunction
from desirepath.simulation.setups import Setup


def towards_goal(setup: Setup) -> ActFunction:
    """Drive at the goal, whatever stands there: some arrive, some collide."""

    def act(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        goal = np.arctan2(observations[:, 4], observations[:, 3]) / np.pi if setup.solids else observations[:, 1]
        return np.stack([np.ones(len(goal)), np.clip(2 * goal, -1, 1)], axis=1).astype(np.float32)

    return act
