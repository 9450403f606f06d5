"""Chapter 3: furnished homes."""

from desirepath.simulation import home_interiors
from desirepath.simulation.worlds import RowWorld

WORLD = RowWorld(3, home_interiors.draw_home, home_interiors.KINDS)
