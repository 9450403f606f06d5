"""Family `context`: another wish near the person than far from them, or at first than at last. Held out of all
tuning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from desirepath.learning.measures.steps import WORDS, SeenSteps, scale_words
from desirepath.learning.people.families.base import Doubles, Family, StepFamilyMember


@dataclass(frozen=True)
class ContextMember(StepFamilyMember):
    """wishes: weights by word, of the one that holds near (or at first) and of the one that holds far (or at last)."""

    by: Literal["distance", "time"]
    wishes: tuple[Mapping[str, float], Mapping[str, float]]
    turning_point: float
    blur: float

    def step_scores(self, steps: SeenSteps) -> Doubles:
        values = steps.words["person_m"] if self.by == "distance" else steps.place
        first = 1 / (1 + np.exp(np.clip((values - self.turning_point) / self.blur, -50, 50)))
        first_wish, second_wish = (
            scale_words(steps, list(wish)) @ np.array(list(wish.values())) for wish in self.wishes
        )
        scores: Doubles = first * first_wish + (1 - first) * second_wish
        return scores


class ContextFamily(Family):
    """words: how many each wish has. near_m, blur_m: within how far of the person is near, and how sharply;
    turning_point: what share of the time is at first."""

    words: int
    near_m: float
    blur_m: float
    turning_point: float

    def draw(self, setup: str, random: np.random.Generator) -> ContextMember:
        def wish() -> dict[str, float]:
            chosen = [WORDS[k] for k in random.choice(len(WORDS), self.words, replace=False)]
            weights = random.normal(0, 1, self.words)
            return dict(zip(chosen, (weights / np.linalg.norm(weights)).tolist(), strict=True))

        wishes = (wish(), wish())
        if random.random() < 0.5:
            return ContextMember("distance", wishes, self.near_m, self.blur_m)
        return ContextMember("time", wishes, self.turning_point, 0.05)
