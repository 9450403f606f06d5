"""Learning to move among pedestrians (chapter 4): attention networks, their baselines; imitation of a search, DDPG
and TD3; planners.

Scenes, lidar and descriptors live in `desirepath.simulation.crowds`.
"""
