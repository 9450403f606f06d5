"""Family `thresholds`: "not nearer than 1.2 m, beyond that I don't care"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.families.base import Doubles, Family, Span, StepFamilyMember

AT_LEAST = ("person_m", "clearance_m", "free_ahead_m")
"""Words of which too little costs; of all others too much."""


@dataclass(frozen=True)
class ThresholdsMember(StepFamilyMember):
    """limits: by word, where it begins to cost and how much it costs. tie_breaker: what a second costs."""

    limits: Mapping[str, tuple[float, float]]
    tie_breaker: float

    def step_scores(self, steps: SeenSteps) -> Doubles:
        cost = np.zeros(len(steps.of))
        for word, (limit, weight) in self.limits.items():
            values = steps.words[word]
            excess = (limit - values) / limit if word in AT_LEAST else (values - limit) / (1 - limit)
            cost -= weight * np.clip(excess, 0, 1)
        # Of equals the shorter one: each step costs as much as there are steps.
        return cost - self.tie_breaker * np.bincount(steps.of)[steps.of] / 50


class ThresholdsFamily(Family):
    """how_many: thresholds, from-to. between: by word, where its threshold may lie."""

    how_many: tuple[int, int]
    between: dict[str, Span]
    tie_breaker: float

    def draw(self, setup: str, random: np.random.Generator) -> ThresholdsMember:
        count = int(random.integers(self.how_many[0], self.how_many[1] + 1))
        words = [sorted(self.between)[k] for k in random.choice(len(self.between), count, replace=False)]
        return ThresholdsMember(
            {word: (float(random.uniform(*self.between[word])), float(random.uniform(0.5, 1.0))) for word in words},
            self.tie_breaker,
        )
