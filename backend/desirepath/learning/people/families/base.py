"""What a simulated person outside the list is, and what a family of them is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from desirepath.learning.measures.steps import SeenSteps, reference
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]


class FamilyMember(ABC):
    """Somebody who prefers, of two trajectories of a setup, the one with the higher score."""

    @abstractmethod
    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        """(n,) the value of each trajectory, more is better, on a scale of the member's own."""

    def score(self, trajectory: Trajectory) -> float:
        """The value of one trajectory."""
        return float(self.scores([trajectory])[0])

    def after(self, answers: int) -> FamilyMember:
        """Who it is once so many questions were answered: somebody else only where minds change."""
        del answers
        return self

    def unit(self, setup: str) -> float:
        """Standard deviation of its score's difference within the reference's pairs: its typical difference."""
        scores = self.scores(reference(setup).trajectories)
        return float((scores[0::2] - scores[1::2]).std()) or 1.0


class StepFamilyMember(FamilyMember):
    """Somebody who values every step; a trajectory's value is their mean."""

    @abstractmethod
    def step_scores(self, steps: SeenSteps) -> Doubles:
        """(n,) the value of each step."""

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        steps = SeenSteps.of_trajectories(trajectories)
        return steps.means(self.step_scores(steps))


class Family(BaseModel):
    """A family's parameters on the card."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def draw(self, setup: str, random: np.random.Generator) -> FamilyMember:
        """One member. The same random stream gives the same one."""
        raise NotImplementedError


Span = tuple[float, float]
