"""Chapter 6: four cubes in an open field."""

from desirepath.simulation import kernels as k
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(6, k.draw_open_field, ("cube",) * 4)
