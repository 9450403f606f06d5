"""Chapter 2: a corridor."""

from desirepath.simulation import kernels as k
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(21, k.draw_corridor)
