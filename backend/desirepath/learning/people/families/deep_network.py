"""Family `deep_network`: a reward network built as those that are fitted to people's answers, over all inputs as they
are. Held out of all tuning."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from desirepath.learning.measures.steps import SeenSteps, reference
from desirepath.learning.people.families.base import Doubles, Family, StepFamilyMember


@dataclass(frozen=True)
class DeepNetworkMember(StepFamilyMember):
    """r(s, a) = tanh(W_n ... leaky ReLU(W_1 x + b_1)). scale: of each group's inputs, so that groups have equal parts;
    muted: groups that count as if they stood at their mean."""

    layers: tuple[tuple[Doubles, Doubles], ...]
    scale: dict[str, float]
    leak: float
    muted: frozenset[str] = frozenset()

    def step_scores(self, steps: SeenSteps) -> Doubles:
        inputs = steps.scaled_inputs
        values = np.concatenate(
            [inputs[name] * (0.0 if name in self.muted else scale) for name, scale in self.scale.items()], axis=1
        )
        for weights, bias in self.layers[:-1]:
            values = values @ weights + bias
            values = np.where(values > 0, values, self.leak * values)
        weights, bias = self.layers[-1]
        return np.tanh((values @ weights + bias)[:, 0])


class DeepNetworkFamily(Family):
    """layers: units of the hidden layers. leak: slope below zero."""

    layers: tuple[int, ...]
    leak: float

    def draw(self, setup: str, random: np.random.Generator) -> DeepNetworkMember:
        groups = {name: len(mean) for name, (mean, _) in reference(setup).inputs.items()}
        widths = (sum(groups.values()), *self.layers, 1)
        layers = tuple(
            (random.normal(0, math.sqrt(2 / before), (before, after)), random.normal(0, 0.3, after))
            for before, after in pairwise(widths)
        )
        scale = {name: math.sqrt(widths[0] / len(groups) / size) for name, size in groups.items()}
        drawn = DeepNetworkMember(layers, scale, self.leak)
        # The output uses the middle of tanh: what it saturates on would be one threshold.
        before = np.arctanh(np.clip(drawn.step_scores(reference(setup).steps), -1 + 1e-9, 1 - 1e-9))
        (weights, bias), spread = layers[-1], max(float(before.std()), 1e-6)
        return DeepNetworkMember((*layers[:-1], (weights / spread, (bias - before.mean()) / spread)), scale, self.leak)
