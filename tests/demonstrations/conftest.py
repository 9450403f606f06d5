"""Demonstrations that many tests look at: one style, each pair of the room once."""

from __future__ import annotations

import pytest

from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.simulation.demonstration_scenes import demonstration_scenes


@pytest.fixture(scope="session")
def slow_ones() -> list[Demonstration]:
    """Programmed `slow_near_person`, twice in each pair of the room."""
    return [demonstrate("slow_near_person", scene, seed) for scene in demonstration_scenes("room") for seed in (0, 1)]
