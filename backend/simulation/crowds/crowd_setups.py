"""The setups of chapter 4: one robot, one lidar, one reward; four kinds of buildings.

They stand beside `setups.SETUPS`, because their robot observes lidar points, descriptors and a path, no flat layout.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from backend.simulation.setups import CoreReward, Lidar, Limits, Setup, SetupError

PED_DEPTH_M, PED_WIDTH_M, PED_HEIGHT_M = 0.4, 0.5, 1.7  # cuboids, ours: the thesis gives no size
PED_SPEEDS_M_S = (0.5, 1.0)  # section 4.4.6.1
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


CROWD_CORRIDOR = Setup(
    name="crowd_corridor",  # ch. 4, sections 4.4.3, 4.4.6, 4.5.1; the reward is `CrowdReward`
    limits=Limits(0.0, 1.0),
    lidar=Lidar(beams=1440, sectors=180, range_m=3.5),
    reward=CoreReward(goal=0.0, collision=-10.0, timeout=0.0, self_intersection=0.0),
    goal_radius_m=0.2,
    max_steps=150,
    gamma=0.98,
    with_velocity=False,
    with_person=False,
    extractors=False,
)
CROWD_INTERSECTION = replace(CROWD_CORRIDOR, name="crowd_intersection")
CROWD_OFFICE = replace(CROWD_CORRIDOR, name="crowd_office")
TRAINED_SETUPS = (CROWD_CORRIDOR.name, CROWD_INTERSECTION.name, CROWD_OFFICE.name)
CROWD_HOME = replace(CROWD_CORRIDOR, name="crowd_home")  # never trained in: section 4.5.6
CROWD_SETUPS = {setup.name: setup for setup in (CROWD_CORRIDOR, CROWD_INTERSECTION, CROWD_OFFICE, CROWD_HOME)}


def get_crowd_setup(name: str) -> Setup:
    """The crowd setup of that name. Raises SetupError listing the known ones."""
    try:
        return CROWD_SETUPS[name]
    except KeyError:
        raise SetupError(f"unknown crowd setup {name!r}; known: {', '.join(CROWD_SETUPS)}") from None
