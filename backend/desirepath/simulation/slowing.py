"""Driving slowly beside the person, by a rule of `deploy/steering.py`, as a setup observes them. Who drives by it,
and how slowly, is the policies'."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.steering import Slowing
from desirepath.simulation.setups import Setup, SetupError

Floats = NDArray[np.float32]


def slowed(rule: Slowing, actions: Floats, observations: Floats, setup: Setup) -> Floats:
    """(n, 2) actions in [-1, 1] and the (n, obs) states they are taken in -> the actions with this rule's limit.

    Raises SetupError as `person_distance_input`.
    """
    distance = observations[:, person_distance_input(setup)] * np.float32(setup.distance_scale_m)
    return rule.limited(actions, distance)


def person_distance_input(setup: Setup) -> int:
    """Where the person's distance is observed. Raises SetupError where it is not, or where a robot cannot stand."""
    if setup.person_inputs is None:
        raise SetupError(f"setup {setup.name}: the person's distance is not observed, so nothing can be slowed by it")
    if setup.robot.limits.v_min != 0:
        raise SetupError(
            f"setup {setup.name}: v_min = {setup.robot.limits.v_min}; shares of full speed begin at standing"
        )
    return setup.person_inputs[0]
