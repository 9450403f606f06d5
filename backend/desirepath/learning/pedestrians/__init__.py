"""Learning to move among pedestrians (chapter 4): attention networks, their baselines; DDPG and TD3; a search
and planners.

Scenes, lidar and descriptors live in `desirepath.simulation.crowds`.
"""
