"""A moment that somebody marks while a trajectory plays: evaluative, of a part of it (critiques, Cui and Niekum 2018).

Its part is the worst of the trajectory's parts, or the best, as a choice among them (Luce 1959). What parts are worth
to whoever judges whole trajectories is the posterior's own model, of what `spans.part_measures` measures. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from desirepath.learning.preferences.evidence.evidence import Doubles, Evidence, Feedback, Habits, of_best, with_lapses


@dataclass(frozen=True, eq=False)
class MarkedMoment(Evidence):
    """measured: of the marked part first, then of those that were not marked so. better: marked as good."""

    feedback: ClassVar[Feedback] = "evaluative"
    better: bool = False

    def log_likelihood(self, worth: Doubles, habits: Habits) -> Doubles:
        careful = of_best(worth if self.better else -worth)
        return with_lapses(careful, habits.lapse_rate, worth.shape[1])
