"""A policy on a robot: from a scan, odometry, a goal and people to a command, as in every engine.

NumPy and the standard library of Python 3.10 to 3.13 only (onnxruntime where a policy of others needs it), and nothing
of the house outside itself: an exported bundle takes these files along.
"""
