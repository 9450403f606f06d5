"""Oracles: programmed participants that answer queries, each by one taste and with a person's weaknesses.

Simulated answers stay marked as such by their source. What is learned from answers lives in `posterior.py` and the
reward models; they were tuned on the TUNING tastes only, the HELD_OUT ones were looked at when everything was fixed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.analysis.metrics import min_human_distance, path_length
from backend.learning.errors import LearningError
from backend.learning.preferences.preferences import Preference
from backend.learning.preferences.spans import beginning
from backend.learning.preferences.vocabulary import MEASURES, NAMES, gains, measures, typical_differences
from backend.learning.queries.queries import Query
from backend.simulation.setups import get_setup, require_same
from backend.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
Value = Callable[[Sequence[Trajectory]], Doubles]
"""(n,) what a taste thinks of n drives of one setup, more is better, in units of typical differences."""
KEEP_AWAY_M = 1.5


def min_human_distance_m(trajectory: Trajectory) -> float:
    """Smallest centre-to-centre distance (m) to the person over the drive's poses."""
    person = trajectory.scene.person.pose
    return float(min_human_distance(trajectory.poses[None], [(person.x, person.y)])[0])


def path_length_m(trajectory: Trajectory) -> float:
    """Length (m) of the drive."""
    return float(path_length(trajectory.poses[None])[0])


@dataclass(frozen=True)
class Taste:
    """What an oracle wants more of. wants: the objectives it stands for, the dominant one first; none: not of them."""

    value: Value
    wants: tuple[str, ...] = ()


def _typical(drives: Sequence[Trajectory]) -> Doubles:
    """(7,) typical differences of the drives' setup."""
    return typical_differences(require_same(**{f"drive {k}": drive.scene.setup for k, drive in enumerate(drives)}))


def _of_objectives(**weights: float) -> Taste:
    """A weighted sum of the vocabulary's gains."""
    row = np.array([weights.get(name, 0.0) for name in NAMES])

    def value(drives: Sequence[Trajectory]) -> Doubles:
        worth: Doubles = gains(measures(drives) / _typical(drives)) @ row
        return worth

    return Taste(value, tuple(sorted(weights, key=lambda name: -weights[name])))


def _keep_away_else_short(drives: Sequence[Trajectory]) -> Doubles:
    """Within 1.5 m of the person nothing else counts, beyond it only the length."""
    judged, typical = measures(drives), _typical(drives)
    too_near = np.maximum(KEEP_AWAY_M - judged[:, MEASURES.index("min_human_distance_m")], 0.0) / typical[0]
    length = judged[:, MEASURES.index("path_length_m")] / typical[MEASURES.index("path_length_m")]
    worth: Doubles = np.where(too_near > 0, -1e3 - too_near, -length)
    return worth


def _seconds_to_person(drives: Sequence[Trajectory]) -> Doubles:
    """Distance over speed near the person: a product, which no weighted sum of measures is."""
    judged, typical = measures(drives), _typical(drives)
    near, speed = (MEASURES.index(name) for name in ("min_human_distance_m", "speed_near_person_m_s"))
    full_speed = get_setup(drives[0].scene.setup).limits.v_max
    worth: Doubles = judged[:, near] / np.maximum(judged[:, speed] / full_speed, 0.1) / typical[near]
    return worth


def _faces_person(drives: Sequence[Trajectory]) -> Doubles:
    """How much the robot looks towards the person on its way, -1 to 1, in units of 0.1: nothing of the vocabulary."""
    return np.array([np.cos(drive.next_observations[:, 3] * np.pi).mean() for drive in drives]) / 0.1


TUNING: dict[str, Taste] = {
    "min-human-distance": _of_objectives(farther=1.0),  # the thesis's oracle (6.4.2)
    "closer": _of_objectives(closer=1.0),
    "person-on-left": _of_objectives(person_on_left=1.0),
    "person-on-right": _of_objectives(person_on_right=1.0),
    "clearance": _of_objectives(clearance=1.0),
    "shortest": _of_objectives(shorter=1.0),
    "smoothest": _of_objectives(smoother=1.0),
    "slow-near-person": _of_objectives(slower_near_person=1.0),
    "fastest": _of_objectives(faster=1.0),
    "far-and-smooth": _of_objectives(farther=0.65, smoother=0.35),
    "left-and-slow": _of_objectives(slower_near_person=0.6, person_on_left=0.4),
}
HELD_OUT: dict[str, Taste] = {
    "clear-and-fast": _of_objectives(clearance=0.6, faster=0.4),
    "right-and-far": _of_objectives(person_on_right=0.6, farther=0.4),
    "keep-away-else-short": Taste(_keep_away_else_short),
    "seconds-to-person": Taste(_seconds_to_person),
    "faces-person": Taste(_faces_person),
}
TASTES = TUNING | HELD_OUT
ORACLES = (*TASTES, "random")


@dataclass(frozen=True)
class Habits:
    """How answers stray from a taste.

    noise: share of answers that are flipped (mistakes). indifference: a smaller difference, in units of typical ones,
    is not noticed and answered at random. myopia_s: only so many seconds of each drive are judged, from the start on;
    None: all.
    """

    noise: float = 0.0
    indifference: float = 0.0
    myopia_s: float | None = None


ALWAYS_RIGHT = Habits()


@dataclass
class Oracle:
    """Answers queries by one taste."""

    name: str
    habits: Habits
    random: np.random.Generator

    def choices(self, queries: Sequence[Query]) -> list[int]:
        """0 for trajectory A, 1 for B, of each query in order. Drives of equal worth are chosen between at random."""
        if self.name == "random":
            return [int(self.random.integers(2)) for _ in queries]
        return self.decide(self.advantages(queries))

    def advantages(self, queries: Sequence[Query]) -> Doubles:
        """(n,) how much better B is by the taste, as far as it is looked at (myopia), in typical differences."""
        drives = [drive for query in queries for drive in (query.trajectory_a, query.trajectory_b)]
        if self.habits.myopia_s is not None:
            drives = [beginning(drive, self.habits.myopia_s) for drive in drives]
        worth = TASTES[self.name].value(drives) if drives else np.zeros(0)
        better: Doubles = worth[1::2] - worth[0::2]
        return better

    def decide(self, advantages: Doubles) -> list[int]:
        """0 for A, 1 for B, by how much better B is, mistakes and indifference included."""
        return [self._choice(float(better)) for better in advantages]

    def _choice(self, b_better_by: float) -> int:
        wrong, coin = self.random.random() < self.habits.noise, int(self.random.integers(2))
        if b_better_by == 0 or abs(b_better_by) < self.habits.indifference:
            return coin
        choice = int(b_better_by > 0)
        return 1 - choice if wrong else choice

    def choose(self, query: Query) -> int:
        """0 for trajectory A, 1 for B."""
        return self.choices([query])[0]

    def answer(self, queries: Sequence[Query]) -> list[Preference]:
        """One marked preference per query, in order."""
        return [
            Preference.of(query, choice, source=f"oracle:{self.name}")
            for query, choice in zip(queries, self.choices(queries), strict=True)
        ]


def make_oracle(
    name: str, *, noise: float = 0.0, seed: int = 0, indifference: float = 0.0, myopia_s: float | None = None
) -> Oracle:
    """The oracle of that name. Raises LearningError for an unknown one, a noise outside [0, 1], a negative
    indifference or a myopia of no time."""
    if name not in ORACLES:
        raise LearningError(f"oracle = {name!r}: known are {', '.join(ORACLES)}")
    if not 0.0 <= noise <= 1.0:
        raise LearningError(f"noise = {noise}: a share of flipped answers lies between 0 and 1")
    if indifference < 0:
        raise LearningError(f"indifference = {indifference}: in units of typical differences, at least 0")
    if myopia_s is not None and myopia_s <= 0:
        raise LearningError(f"myopia = {myopia_s}: seconds of a drive that are judged, more than 0")
    return Oracle(name, Habits(noise, indifference, myopia_s), np.random.default_rng([seed, 15]))
