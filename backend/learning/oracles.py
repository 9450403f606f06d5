"""Oracles: programmed participants that answer queries. Simulated answers stay marked as such by their source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from backend.analysis.metrics import min_human_distance, path_length
from backend.learning.errors import LearningError
from backend.learning.preferences import Preference
from backend.learning.queries import Query
from backend.simulation.trajectory import Trajectory

Taste = Callable[[Trajectory], float]
"""What an oracle wants more of."""


def min_human_distance_m(trajectory: Trajectory) -> float:
    """Smallest centre-to-centre distance (m) to the person over the drive's poses."""
    person = trajectory.scene.person.pose
    return float(min_human_distance(trajectory.poses[None], [(person.x, person.y)])[0])


def path_length_m(trajectory: Trajectory) -> float:
    """Length (m) of the drive."""
    return float(path_length(trajectory.poses[None])[0])


TASTES: dict[str, Taste] = {
    "min-human-distance": min_human_distance_m,  # the thesis's oracle (6.4.2)
    "shortest": lambda trajectory: -path_length_m(trajectory),
}
ORACLES = (*TASTES, "random")


@dataclass
class Oracle:
    """Answers queries by one taste; with probability `noise` an answer is flipped."""

    name: str
    noise: float
    random: np.random.Generator

    def choose(self, query: Query) -> int:
        """0 for trajectory A, 1 for B."""
        if self.name == "random":
            return int(self.random.integers(2))
        taste = TASTES[self.name]
        choice = int(taste(query.trajectory_b) > taste(query.trajectory_a))
        return 1 - choice if self.random.random() < self.noise else choice

    def answer(self, queries: Sequence[Query]) -> list[Preference]:
        """One marked preference per query, in order."""
        return [Preference.of(query, self.choose(query), source=f"oracle:{self.name}") for query in queries]


def make_oracle(name: str, *, noise: float = 0.0, seed: int = 0) -> Oracle:
    """The oracle of that name. Raises LearningError for an unknown one or a noise outside [0, 1]."""
    if name not in ORACLES:
        raise LearningError(f"oracle = {name!r}: known are {', '.join(ORACLES)}")
    if not 0.0 <= noise <= 1.0:
        raise LearningError(f"noise = {noise}: a share of flipped answers lies between 0 and 1")
    return Oracle(name, noise, np.random.default_rng([seed, 15]))
