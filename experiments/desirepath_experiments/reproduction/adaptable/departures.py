"""Where what is done for chapter 5 departs from the thesis, in sentences for cards and reports."""

from __future__ import annotations

DEPARTURES = [
    "Many environments, a third of them in each part of the triangle, in a fast kinematic engine; there three in "
    "iGibson. Half as many transitions, 20,000 updates.",
    "Discount 0.995 instead of 1: undiscounted, robots that only keep away may stand for ever. Half of the preferences "
    "trained under lie within the triangle, a third on its edges, a sixth at its corners.",
    "Random actions of the ranked rollouts are kept up for a second, and snippets of equal length are compared: "
    "single random steps average out, and of whole rollouts the longer one has more to sum.",
    "The programmed demonstration is disturbed in a part of the steps while it is recorded, and the action recorded "
    "is the demonstration's: else the clone never sees how to come back.",
    "The reward network's output is shifted and scaled so that random actions get 0 and the clone's own get 1.",
    "The clone's noisy rollouts are in the replay buffer to begin with.",
    "The actor is drawn to the demonstration's clone by the square of the demonstration's weight, except where the "
    "critic sees the clone lose an eighth of a metre of progress: beside the core reward the learned one is flat.",
    "Values are compared with the interpolated preference per metre of way to go.",
    "The kept policy averages the actor over updates: the best of several checkpoints, on scenes that nothing reports.",
    "Sizes and places of obstacles, the goal's radius and the intersection's measures are ours.",
]
