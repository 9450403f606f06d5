"""Chapter 2: a furnished room."""

from desirepath.simulation import kernels as k
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(22, k.draw_room, ("couch", "table", "cupboard"))
