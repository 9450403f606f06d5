"""TD3 with demonstrations (ch. 2): a demonstration buffer that never changes, behavioural cloning, the goal's boost.

One controller per participant and environment. `loss.py` states what is learned and holds the three parts that make it
more than TD3, `configuration.py` every number with its source; then where episodes begin, returns of several steps, and
the training loop with its choice of a checkpoint. How a controller is judged: `demonstrations/judging.py`.
"""
