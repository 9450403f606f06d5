"""Several put in order, or the best of several picked: comparative (Plackett 1975, Luce 1959)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from desirepath.learning.preferences.evidence.evidence import Doubles, Evidence, Feedback, Habits, of_best, with_lapses


@dataclass(frozen=True, eq=False)
class Ranking(Evidence):
    """measured: of the alternatives, the best first. said: how many places were said; 1: the best of them alone."""

    feedback: ClassVar[Feedback] = "comparative"
    said: int

    def log_likelihood(self, worth: Doubles, habits: Habits) -> Doubles:
        """Place by place: the best of those that are left, or any of them without looking."""
        together = np.zeros(len(worth))
        for place in range(min(self.said, worth.shape[1] - 1)):
            left = worth[:, place:]
            together += with_lapses(of_best(left), habits.lapse_rate, left.shape[1])
        return together
