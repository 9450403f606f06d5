"""One trajectory on a scale of points: evaluative.

The cumulative link with criteria that spread the points evenly over what somebody has rated so far, how far it differs
for them included (range and frequency, Parducci 1965). So a scale needs no parameters of its own, and the first rating
says nothing. The spread is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from desirepath.learning.preferences.evidence.evidence import Doubles, Evidence, Feedback, Habits, of_level, with_lapses

NOISE = math.pi**2 / 3  # variance of a logistic variable


@dataclass(frozen=True, eq=False)
class Rating(Evidence):
    """measured: of all that was rated so far, the one that is rated now last. rating: 1 to `points`, more is better."""

    feedback: ClassVar[Feedback] = "evaluative"
    rating: int
    points: int

    def log_likelihood(self, worth: Doubles, habits: Habits) -> Doubles:
        position = worth[:, -1] - worth.mean(axis=1)
        spread = np.sqrt(1 + worth.var(axis=1) / NOISE)
        shares = np.arange(1, self.points) / self.points
        criteria = spread[:, None] * np.log(shares / (1 - shares))
        return with_lapses(of_level(position, criteria, self.rating - 1), habits.lapse_rate, self.points)
