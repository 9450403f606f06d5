"""One of two, with how clearly it is the better one, or neither: comparative.

The cumulative link on the advantage (Agresti 1992); with "no difference" alone it is Rao and Kupper's model of ties
(1967), without either Bradley and Terry's. Degrees said as how sure somebody is are criteria on the same advantage, as
confidence in signal detection theory (Macmillan and Creelman 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from desirepath.learning.preferences.evidence.evidence import Doubles, Evidence, Feedback, Habits, of_level, with_lapses

Degree = Literal["no_difference", "slight", "clear"]
Possible = Literal[2, 3, 4, 5]
"""How many answers there were: A and B; with no difference between them; each slightly or clearly; all of that."""


@dataclass(frozen=True, eq=False)
class GradedPair(Evidence):
    """measured: of A and B. better: 1 where A is, -1 where B is, 0 for no difference; degree None where nobody was
    asked for one. Raises ValueError for an answer that was not possible."""

    feedback: ClassVar[Feedback] = "comparative"
    better: Literal[-1, 0, 1]
    degree: Degree | None
    possible: Possible

    def __post_init__(self) -> None:
        wanted = ("no_difference",) if self.better == 0 else ("slight", "clear") if self.graded else (None,)
        if self.degree not in wanted or (self.better == 0 and self.possible % 2 == 0):
            raise ValueError(f"better = {self.better}, degree = {self.degree!r}: not among {self.possible} answers")

    @property
    def graded(self) -> bool:
        return self.possible >= 4

    @property
    def level(self) -> int:
        """Its place among the possible answers, from B clearly better to A clearly better."""
        if self.better == 0:
            return self.possible // 2
        from_end = int(self.graded and self.degree == "slight")
        return self.possible - 1 - from_end if self.better > 0 else from_end

    def log_likelihood(self, worth: Doubles, habits: Habits) -> Doubles:
        noticed, clear = habits.criteria[:, :1], habits.criteria[:, 1:]
        inner = [-noticed, noticed] if self.possible in (3, 5) else [np.zeros_like(noticed)]
        criteria = [-clear, *inner, clear] if self.graded else inner
        careful = of_level(worth[:, 0] - worth[:, 1], np.concatenate(criteria, axis=1), self.level)
        return with_lapses(careful, habits.lapse_rate, self.possible)
