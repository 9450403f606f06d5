"""Robots of somebody else's simulator: a scene as an ir-sim world, and what drives in it. No policy is made here."""
