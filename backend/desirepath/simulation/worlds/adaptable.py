"""Chapter 5: three boxes in the open."""

from desirepath.simulation import kernels as k
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(5, k.draw_adaptable, ("box",) * 3)
