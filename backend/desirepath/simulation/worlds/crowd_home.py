"""Chapter 4: homes in which people walk, never trained in."""

from desirepath.simulation.crowds.crowd_scenes import draw_in_building
from desirepath.simulation.worlds import SceneWorld

WORLD = SceneWorld(44, draw_in_building)
