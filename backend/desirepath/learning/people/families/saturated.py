"""Family `saturated`: a reward network that judges nearly every step wholly good, or wholly bad, as those that were
fitted to real people's answers do. Nothing is tuned on it."""

from __future__ import annotations

import numpy as np

from desirepath.learning.measures.steps import reference
from desirepath.learning.people.families.base import Span
from desirepath.learning.people.families.deep_network import DeepNetworkFamily, DeepNetworkMember


class SaturatedFamily(DeepNetworkFamily):
    """sharpness: of the output, in standard deviations of what enters it. share: of the steps on one side, from-to;
    which side is drawn."""

    sharpness: float
    share: Span

    def draw(self, setup: str, random: np.random.Generator) -> DeepNetworkMember:
        drawn = super().draw(setup, random)
        known = drawn.step_scores(reference(setup).steps)
        before = np.arctanh(np.clip(known, -1 + 1e-12, 1 - 1e-12))
        side, share = random.choice([-1.0, 1.0]), random.uniform(*self.share)
        middle = np.quantile(side * before, 1 - share) * side
        weights, bias = drawn.layers[-1]
        last = (weights * self.sharpness, (bias - middle) * self.sharpness)
        return DeepNetworkMember((*drawn.layers[:-1], last), drawn.scale, self.leak)
