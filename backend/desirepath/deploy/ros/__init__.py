"""A supervised controller as a ROS 2 node, and a robot to try it on.

rclpy and its messages are asked for here only. They come with `pip install "desirepath[ros]"`, or are the robot's own.
"""
