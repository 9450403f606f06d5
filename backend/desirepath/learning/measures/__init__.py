"""What a trajectory is like in the field's words, beyond the seven measures of the objectives: of every step, of the
whole, and an embedding of its steps.

Pure functions of trajectories. What somebody prefers of it is learned in `preferences/free_posterior.py`.
"""
