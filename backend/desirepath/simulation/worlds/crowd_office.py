"""Chapter 4: an office in which people walk."""

from desirepath.simulation.crowds.crowd_scenes import draw_in_building
from desirepath.simulation.worlds import SceneWorld

WORLD = SceneWorld(43, draw_in_building)
