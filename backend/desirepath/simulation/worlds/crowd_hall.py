"""Ours: a hall with nothing but people."""

from desirepath.simulation.crowds.crowd_scenes import draw_in_building
from desirepath.simulation.worlds import SceneWorld

WORLD = SceneWorld(45, draw_in_building)
