"""Numbers of chapter 4 that its setups share: pedestrians, noise, path, reward, curriculum. The setups: `setups.py`.

Their flat observation (lidar, path) is for other libraries; chapter 4's networks read states of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

from desirepath.simulation.setups import Setup, SetupError, get_setup, require_plain

PED_DEPTH_M, PED_WIDTH_M, PED_HEIGHT_M = 0.4, 0.5, 1.7  # cuboids, ours: the thesis gives no size
LIDAR_NOISE_M = 0.025  # section 4.4.7, amplitude
PATH_POINTS, PATH_SPACING_M = 5, 0.3  # section 4.4.3
GUIDE_AHEAD_M = 0.6  # section 4.4.4
PROXIMITY_M = 0.5
CURRICULUM = (2, 4, 8)  # moving pedestrians at most, section 4.4.6.1
CURRICULUM_SUCCESS = 0.7


@dataclass(frozen=True)
class CrowdReward:
    """Weights of equation 4.1: collision (-1), distance to the guidance point (m), proximity (m below 0.5 m)."""

    collision: float = 10.0
    guide: float = 0.2
    proximity: float = 3.0


TRAINED_SETUPS = ("crowd_corridor", "crowd_intersection", "crowd_office")


def get_crowd_setup(name: str) -> Setup:
    """The setup of that name, in which pedestrians walk. Raises SetupError."""
    setup = get_setup(name)
    if not setup.crowded:
        raise SetupError(f"setup {name}: no pedestrians walk in it")
    require_plain(setup, "the engine of pedestrians")
    return setup
