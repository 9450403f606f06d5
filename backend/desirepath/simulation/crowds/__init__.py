"""Robots among pedestrians (chapter 4): scenes with crowds, their engine, what the robot is given of its lidar.

No learning. Scenes with one person, and their engine, live one floor up.
"""
