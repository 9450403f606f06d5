"""A trajectory that somebody made themselves, as by a drawn path: demonstrative.

It counts as their choice among other trajectories of the same scene that they could have made, Boltzmann rational as
any other choice (reward-rational choice, Jeon et al. 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from desirepath.learning.preferences.evidence.evidence import Doubles, Evidence, Feedback, Habits, of_best, with_lapses


@dataclass(frozen=True, eq=False)
class Demonstrated(Evidence):
    """measured: of what was made first, then of what it was chosen among."""

    feedback: ClassVar[Feedback] = "demonstrative"

    def log_likelihood(self, worth: Doubles, habits: Habits) -> Doubles:
        return with_lapses(of_best(worth), habits.lapse_rate, worth.shape[1])
