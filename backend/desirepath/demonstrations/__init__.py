"""Demonstrations (ch. 2): from a drawn stroke to a rollout, to a learned controller, and what it is compared with.

Scenes and engines live in `desirepath.simulation`, networks and TD3 in `desirepath.learning`, distances between paths
in `desirepath.analysis`. Nothing here knows of participants' rows or of the stage.
"""
