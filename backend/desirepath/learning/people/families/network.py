"""Family `network`: a random reward network over the inputs of a step, in which no group of inputs decides alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from desirepath.learning.measures.steps import SeenSteps, reference
from desirepath.learning.people.families.base import Doubles, Family, StepFamilyMember


@dataclass(frozen=True)
class NetworkMember(StepFamilyMember):
    """r(s, a) = v . tanh(sum over groups of W_g x_g + b). first: by group, (inputs, hidden); muted: groups that count
    as if they stood at their mean."""

    first: dict[str, Doubles]
    bias: Doubles
    last: Doubles
    muted: frozenset[str] = frozenset()

    def step_scores(self, steps: SeenSteps) -> Doubles:
        inputs = steps.scaled_inputs
        hidden = self.bias + sum(
            inputs[name] @ weights for name, weights in self.first.items() if name not in self.muted
        )
        return np.tanh(hidden) @ self.last


class NetworkFamily(Family):
    """hidden: units. gain: standard deviation of what enters them. lidar_waves: lidar weights are sums of so many waves
    over the bearing."""

    hidden: int
    gain: float
    lidar_waves: int

    def draw(self, setup: str, random: np.random.Generator) -> NetworkMember:
        groups = {name: len(mean) for name, (mean, _) in reference(setup).inputs.items()}
        first = {}
        for name, size in groups.items():
            weights = random.normal(0, 1, (size, self.hidden))
            if name == "lidar":
                bearings = (np.arange(size) + 0.5) * 2 * math.pi / size
                waves = [np.ones(size)]
                for k in range(1, self.lidar_waves + 1):
                    waves += [np.cos(k * bearings), np.sin(k * bearings)]
                weights = np.stack(waves, axis=1) @ random.normal(0, 1, (len(waves), self.hidden))
            first[name] = weights / np.linalg.norm(weights, axis=0)
        inputs = reference(setup).steps.scaled_inputs
        # Equal parts: what each group adds varies as much as what any other adds.
        first = {
            name: weights * self.gain / math.sqrt(len(groups)) / (inputs[name] @ weights).std(0)
            for name, weights in first.items()
        }
        return NetworkMember(first, random.normal(0, 0.5, self.hidden), random.normal(0, 1, self.hidden))
