"""Chapter 7: a room with boxes and pillars."""

from desirepath.simulation import kernels as k
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(7, k.draw_study_room, ("box",) * 4 + ("pillar",) * 4)
