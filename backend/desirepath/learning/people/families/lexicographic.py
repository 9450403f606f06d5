"""Family `lexicographic`: the first criterion decides where it differs noticeably, else the second, else the third."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.families.base import Doubles, Family, FamilyMember
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath.simulation.trajectory import Trajectory

LEVELS = 30.0  # more than any criterion has noticeable steps
LOWEST = {"nearest_person_m": "person_m", "nearest_obstacle_m": "clearance_m", "least_free_ahead_m": "free_ahead_m"}
MEANS = ("jerk", "turning", "off_course", "standing")


def criterion(name: str, steps: SeenSteps) -> Doubles:
    """(trajectories,) more is better."""
    if name in LOWEST:
        return steps.lowest(steps.words[LOWEST[name]])
    if name in MEANS:
        return -steps.means(steps.words[name])
    if name == "time_s":
        return -CONTROL_DT_S * np.bincount(steps.of).astype(np.float64)
    raise ValueError(f"criterion {name!r} is unknown; known are {', '.join((*LOWEST, *MEANS, 'time_s'))}")


@dataclass(frozen=True)
class LexicographicMember(FamilyMember):
    """criteria: by name the noticeable step, the most important one first."""

    criteria: tuple[tuple[str, float], ...]

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        steps = SeenSteps.of_trajectories(trajectories)
        ranked = np.zeros(len(trajectories))
        for place, (name, step) in enumerate(self.criteria):
            levels = np.clip(criterion(name, steps) / step, -LEVELS / 2, LEVELS / 2)
            last = place == len(self.criteria) - 1
            ranked = ranked * LEVELS + (levels if last else np.floor(levels))
        return ranked / LEVELS ** (len(self.criteria) - 1)


class LexicographicFamily(Family):
    """criteria: how many. steps: what is noticeable of each."""

    criteria: int
    steps: dict[str, float]

    def draw(self, setup: str, random: np.random.Generator) -> LexicographicMember:
        names = [sorted(self.steps)[k] for k in random.choice(len(self.steps), self.criteria, replace=False)]
        return LexicographicMember(tuple((name, self.steps[name]) for name in names))
