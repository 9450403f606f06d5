"""Chapter 8: a room of five different objects."""

from desirepath.simulation import kernels as k
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(8, k.draw_explained_room, ("couch", "table", "cupboard", "box", "pillar"))
