"""Chapter 4: a corridor in which people walk."""

from desirepath.simulation.crowds.crowd_scenes import draw_in_building
from desirepath.simulation.worlds import SceneWorld

WORLD = SceneWorld(41, draw_in_building)
