"""PD-MORL's preference interpolator (Basaklar et al. 2023; section 5.3.2): where in value space a preference points.

Built from the single-objective solutions: what each objective's return is when only one of them counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.adaptable.objectives import SIZE

Floats = NDArray[np.float32]
NARROWEST = 1e-3  # range of an objective that makes no difference to the solutions
SMALLEST = 1e-6


@dataclass(frozen=True)
class Interpolator:
    """solutions (3, 3): row k holds the objectives' mean returns per metre of way when objective k alone counts.

    Per metre (ours), so that values of a state near the goal and of one far away compare: both are asked which
    direction the rest of the way takes. Penalties are all below 0; normalised, the worst solution of an objective is 0
    and the best 1, so directions lie in the positive octant, where preferences lie.
    """

    solutions: Floats

    @property
    def low(self) -> Floats:
        return np.asarray(self.solutions.min(axis=0), dtype=np.float32)

    @property
    def span(self) -> Floats:
        return np.maximum(np.asarray(self.solutions.max(axis=0) - self.low, dtype=np.float32), NARROWEST)

    def normalised(self, returns_per_m: Floats) -> Floats:
        """(n, 3) returns per metre -> (n, 3), 0 the worst and 1 the best of the solutions; beyond them beyond these."""
        found: Floats = (returns_per_m - self.low) / self.span
        return found

    def __call__(self, preferences: Floats) -> Floats:
        """(n, 3) preferences -> (n, 3) unit vectors; at each corner the direction of that objective's solution."""
        nodes = unit(self.normalised(self.solutions))
        return unit(preferences @ nodes)


def without_solutions() -> Interpolator:
    """Before any solution is known every preference points where it is: each objective alone is best at itself."""
    return Interpolator(np.eye(SIZE, dtype=np.float32))


def unit(vectors: Floats) -> Floats:
    found: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), SMALLEST)
    return found
