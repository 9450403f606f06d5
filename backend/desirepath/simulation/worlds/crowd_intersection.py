"""Chapter 4: two corridors that cross, in which people walk."""

from desirepath.simulation.crowds.crowd_scenes import draw_in_building
from desirepath.simulation.worlds import SceneWorld

WORLD = SceneWorld(42, draw_in_building)
