"""Oracles: programmed participants that answer queries, each by one preference and through a response model.

Preferences are of this file, or of the families outside the list (`learning/people`), by name. Simulated answers stay
marked as such by their source. What is learned from answers lives in `posterior.py` and the reward models; they
were tuned on the TUNING preferences only, the HELD_OUT ones were looked at when everything was fixed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from desirepath.analysis.metrics import min_human_distance, path_length
from desirepath.learning.errors import LearningError
from desirepath.learning.people.card import FAMILIES, is_member, member, parse_person
from desirepath.learning.preferences.measures import MEASURES, measures, typical_differences
from desirepath.learning.preferences.objectives import CROWD_NAMES, NAMES, gains, names_of
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.preferences.spans import PEAK_S, beginning, moments, part_measures
from desirepath.learning.queries.queries import Query
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
Value = Callable[[Sequence[Trajectory]], Doubles]
"""(n,) how a preference values n trajectories of one setup, more is better, in units of typical differences."""
KEEP_AWAY_M = 1.5


def min_human_distance_m(trajectory: Trajectory) -> float:
    """Smallest centre-to-centre distance (m) to anybody over the trajectory's poses."""
    people = trajectory.scene.people_at(trajectory.times)
    return float(min_human_distance(trajectory.poses[None], people).min())


def path_length_m(trajectory: Trajectory) -> float:
    """Length (m) of the trajectory."""
    return float(path_length(trajectory.poses[None])[0])


@dataclass(frozen=True)
class OraclePreference:
    """What an oracle prefers. objectives: those that it consists of, the dominant one first; none: it is not made of
    them. weights: (9,) what each weighs then, in the order of `names`. later: what it prefers instead after so many
    answers, where its mind changes.
    """

    value: Value
    objectives: tuple[str, ...] = ()
    weights: Doubles | None = None
    later: Callable[[int], Value] | None = None
    names: tuple[str, ...] = NAMES

    def after(self, answers: int) -> Value:
        """What it prefers once so many questions were answered."""
        return self.value if self.later is None else self.later(answers)


def _typical(trajectories: Sequence[Trajectory]) -> Doubles:
    """(7,) typical differences of the trajectories' setup."""
    return typical_differences(
        require_same(**{f"trajectory {k}": trajectory.scene.setup for k, trajectory in enumerate(trajectories)})
    )


def _of_objectives(**weights: float) -> OraclePreference:
    """A weighted sum of the objectives' gains."""
    names = NAMES if all(name in NAMES for name in weights) else CROWD_NAMES
    row = np.array([weights.get(name, 0.0) for name in names])

    def value(trajectories: Sequence[Trajectory]) -> Doubles:
        setup = trajectories[0].scene.setup
        unknown = [name for name in weights if name not in names_of(setup)]
        if unknown:
            raise LearningError(f"oracle prefers {unknown[0]!r}; in {setup} there are {', '.join(names_of(setup))}")
        value: Doubles = gains(measures(trajectories) / _typical(trajectories)) @ row
        return value

    return OraclePreference(value, tuple(sorted(weights, key=lambda name: -weights[name])), row, names=names)


def _keep_away_else_short(trajectories: Sequence[Trajectory]) -> Doubles:
    """Within 1.5 m of the person nothing else counts, beyond it only the length."""
    judged, typical = measures(trajectories), _typical(trajectories)
    too_near = np.maximum(KEEP_AWAY_M - judged[:, MEASURES.index("min_human_distance_m")], 0.0) / typical[0]
    length = judged[:, MEASURES.index("path_length_m")] / typical[MEASURES.index("path_length_m")]
    value: Doubles = np.where(too_near > 0, -1e3 - too_near, -length)
    return value


def _seconds_to_person(trajectories: Sequence[Trajectory]) -> Doubles:
    """Distance over speed near the person: a product, which no weighted sum of measures is."""
    judged, typical = measures(trajectories), _typical(trajectories)
    near, speed = (MEASURES.index(name) for name in ("min_human_distance_m", "speed_near_person_m_s"))
    full_speed = get_setup(trajectories[0].scene.setup).robot.limits.v_max
    value: Doubles = judged[:, near] / np.maximum(judged[:, speed] / full_speed, 0.1) / typical[near]
    return value


def _faces_person(trajectories: Sequence[Trajectory]) -> Doubles:
    """How much the robot looks towards the person on its way, -1 to 1, in units of 0.1: no objective says that."""
    return np.array([np.cos(trajectory.next_observations[:, 3] * np.pi).mean() for trajectory in trajectories]) / 0.1


TUNING: dict[str, OraclePreference] = {
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
HELD_OUT: dict[str, OraclePreference] = {
    "clear-and-fast": _of_objectives(clearance=0.6, faster=0.4),
    "right-and-far": _of_objectives(person_on_right=0.6, farther=0.4),
    "keep-away-else-short": OraclePreference(_keep_away_else_short),
    "seconds-to-person": OraclePreference(_seconds_to_person),
    "faces-person": OraclePreference(_faces_person),
}
ORACLE_PREFERENCES = TUNING | HELD_OUT
CROWD_PREFERENCES: dict[str, OraclePreference] = {
    "pass-behind": _of_objectives(passes_behind=1.0),
    "cut-in-front": _of_objectives(cuts_in_front=1.0),
    "follow": _of_objectives(follows=1.0),
    "wait": _of_objectives(waits=1.0),
    "behind-and-slow": _of_objectives(passes_behind=0.6, slower_near_person=0.4),
    "far-and-waiting": _of_objectives(farther=0.6, waits=0.4),
}
"""What only somebody among pedestrians can prefer."""
JUDGING_CROWDS = (
    "min-human-distance", "closer", "pass-behind", "cut-in-front", "follow", "wait", "smoothest", "slow-near-person",
    "fastest", "far-and-smooth", "behind-and-slow", "far-and-waiting",
)  # fmt: skip
"""Those that are made of the objectives among pedestrians."""
ORACLES = (*ORACLE_PREFERENCES, *CROWD_PREFERENCES, "random")
OUTSIDE = tuple(f"{family}:0" for family in FAMILIES)
"""Somebody of each family outside the list."""


def preference_of(name: str) -> OraclePreference:
    """What the oracle of that name prefers: one of ORACLE_PREFERENCES, or somebody of a family such as `network:3`.

    Raises LearningError for an unknown one.
    """
    for known in (ORACLE_PREFERENCES, CROWD_PREFERENCES):
        if name in known:
            return known[name]
    if not is_member(name):
        raise LearningError(f"oracle = {name!r}: known are {', '.join(ORACLES)}; or somebody as {', '.join(OUTSIDE)}")
    parse_person(name)

    def later(answers: int) -> Value:
        def value(trajectories: Sequence[Trajectory]) -> Doubles:
            setup = trajectories[0].scene.setup
            drawn = member(name, setup)
            return drawn.after(answers).scores(trajectories) / drawn.unit(setup)

        return value

    return OraclePreference(later(0), later=later)


@dataclass(frozen=True)
class ResponseModel:
    """How answers stray from a preference. lapse_rate: one minus the psychometric function's upper asymptote. peak_end:
    both moments count equally."""

    lapse_rate: Annotated[float, Field(ge=0, le=1, description="Chance that an answer is the wrong one.")] = 0.0
    indifference: Annotated[
        float, Field(ge=0, description="A smaller difference, in typical ones, is answered at random.")
    ] = 0.0
    myopia_s: Annotated[
        float | None, Field(ge=0.2, description="Only so many seconds of each rollout are judged; default all.")
    ] = None
    peak_end: Annotated[
        bool, Field(description="Each rollout's most extreme second and its last one are judged, not the whole.")
    ] = False


ALWAYS_RIGHT = ResponseModel()


@dataclass
class Oracle:
    """Answers queries by one preference. answered: how many so far, for those whose mind changes."""

    name: str
    response_model: ResponseModel
    random: np.random.Generator
    answered: int = 0

    def choices(self, queries: Sequence[Query]) -> list[int]:
        """0 for trajectory A, 1 for B, of each query in order. Between equals it chooses at random."""
        if self.name == "random":
            return [int(self.random.integers(2)) for _ in queries]
        if preference_of(self.name).later is None:
            return self.decide(self.advantages(queries))
        return [self._next_choice(query) for query in queries]

    def _next_choice(self, query: Query) -> int:
        choice = self.decide(self.advantages([query]))[0]
        self.answered += 1
        return choice

    def advantages(self, queries: Sequence[Query]) -> Doubles:
        """(n,) how much better B is by the preference of now, as it is looked at (myopia, peak and end), in typical
        differences."""
        trajectories = [trajectory for query in queries for trajectory in (query.trajectory_a, query.trajectory_b)]
        if not trajectories:
            return np.zeros(0)
        value = judged(preference_of(self.name).after(self.answered), trajectories, self.response_model)
        return value[1::2] - value[0::2]

    def worth_of_parts(self, parts: Sequence[Trajectory]) -> Doubles:
        """(n,) what parts of a trajectory are worth by the preference of now, in typical differences of wholes."""
        preference = preference_of(self.name)
        if preference.weights is None:
            return preference.after(self.answered)(parts)
        worth: Doubles = gains(part_measures(parts)[:, 0] / _typical(parts)) @ preference.weights
        return worth

    def decide(self, advantages: Doubles) -> list[int]:
        """0 for A, 1 for B, by how much better B is, lapses and indifference included."""
        return [self._choice(float(better)) for better in advantages]

    def _choice(self, b_better_by: float) -> int:
        wrong, coin = self.random.random() < self.response_model.lapse_rate, int(self.random.integers(2))
        if b_better_by == 0 or abs(b_better_by) < self.response_model.indifference:
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


def judged(value: Value, trajectories: Sequence[Trajectory], response_model: ResponseModel) -> Doubles:
    """(n,) what trajectories are worth to somebody who looks at them like that: lapses and indifference are of
    answers, not of this."""
    if response_model.myopia_s is not None:
        trajectories = [beginning(trajectory, response_model.myopia_s) for trajectory in trajectories]
    return _peak_and_end(value, trajectories) if response_model.peak_end else value(trajectories)


def _peak_and_end(value: Value, trajectories: Sequence[Trajectory]) -> Doubles:
    """(n,) mean value of the most extreme moment and the last one; extreme: farthest from the whole's."""
    scores = np.zeros(len(trajectories))
    for k, (trajectory, whole) in enumerate(zip(trajectories, value(trajectories), strict=True)):
        values = value(moments(trajectory, PEAK_S))
        scores[k] = (values[np.abs(values - whole).argmax()] + values[-1]) / 2
    return scores


def make_oracle(
    name: str,
    *,
    lapse_rate: float = 0.0,
    seed: int = 0,
    indifference: float = 0.0,
    myopia_s: float | None = None,
    peak_end: bool = False,
) -> Oracle:
    """The oracle of that name. Raises LearningError for an unknown one, a lapse rate outside [0, 1], a negative
    indifference or a myopia of no time."""
    if name != "random":
        preference_of(name)
    if not 0.0 <= lapse_rate <= 1.0:
        raise LearningError(f"lapse_rate = {lapse_rate}: a share of flipped answers lies between 0 and 1")
    if indifference < 0:
        raise LearningError(f"indifference = {indifference}: in units of typical differences, at least 0")
    if myopia_s is not None and myopia_s <= 0:
        raise LearningError(f"myopia = {myopia_s}: seconds of a trajectory that are judged, more than 0")
    return Oracle(name, ResponseModel(lapse_rate, indifference, myopia_s, peak_end), np.random.default_rng([seed, 15]))
