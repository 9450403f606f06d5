"""Weights of what somebody prefers, as a conditioned policy takes them while it drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
PREFERENCES, SHARES = "preferences", "shares"
"""Each weight in [0, 1], no two opposites at once; or all together 1."""
SLOWER = "slower_near_person"
"""By whose weight a rule of slowing is as strict."""
SUMS_TO_ONE = 1e-3


class WeightsError(ValueError):
    """Weights that a policy does not take; names them, and what it takes."""


@dataclass(frozen=True)
class Conditioning:
    """What a policy is conditioned on. kind: PREFERENCES or SHARES; opposites: pairs of objectives that nobody prefers
    at once; strengths: objectives by name that enter so many times as strongly where nothing else is preferred."""

    kind: str
    objectives: tuple[str, ...]
    opposites: tuple[tuple[str, str], ...] = ()
    strengths: Mapping[str, float] = field(default_factory=dict)

    def checked(self, weights: Mapping[str, float]) -> dict[str, float]:
        """All of them by name; what is not named is 0, of shares nothing at all equal ones. Raises WeightsError."""
        names, known = ", ".join(self.objectives), set(self.objectives)
        if unknown := sorted(set(map(str, weights)) - known):
            raise WeightsError(f"weights name {unknown[0][:60]!r}; the policy knows {names}")
        found = {name: float(weights.get(name, 0.0)) for name in self.objectives}
        for name, weight in found.items():
            if not 0 <= weight <= 1:
                raise WeightsError(f"weight {name} = {weight:g}: must be between 0 and 1")
        if self.kind == SHARES:
            if not any(found.values()):
                return dict.fromkeys(found, 1 / len(found))
            if abs(sum(found.values()) - 1) > SUMS_TO_ONE:
                raise WeightsError(f"weights of {names} sum to {sum(found.values()):g}: must sum to 1")
        for one, other in self.opposites:
            if found[one] > 0 and found[other] > 0:
                raise WeightsError(f"weights {one} and {other} are opposites: only one may be above 0")
        return found

    def entering(self, weights: Mapping[str, float]) -> Floats:
        """(k,) what the network is given for these weights."""
        values = np.array([weights.get(name, 0.0) for name in self.objectives], dtype=np.float32)
        factors = np.array([self.strengths.get(name, 1.0) for name in self.objectives], dtype=np.float32)
        return strengthened(values, factors)


def strengthened(weights: Floats, factors: Floats) -> Floats:
    """(k,) weights, each times its factor where it is all that is preferred, times 1 where the others weigh as much
    together, linear between."""
    others = (weights.sum() - weights) / np.maximum(weights, np.float32(1e-6))
    entering: Floats = weights * (np.float32(1) + (factors - np.float32(1)) * np.clip(np.float32(1) - others, 0, 1))
    return entering
