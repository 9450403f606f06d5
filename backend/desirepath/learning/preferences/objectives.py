"""The objectives: what people may prefer in a robot's driving, one line of a table each.

Everything that is ordered by them, posterior, conditioned policies, rewards, words and figures, takes its order from
here. How much each matters to somebody are preference weights: learned in `posterior.py`, what policies are conditioned
on in `conditioned.py`. All ours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError, OppositeWeights
from desirepath.learning.preferences import bounds, step_terms
from desirepath.learning.preferences.bounds import SceneBounds
from desirepath.learning.preferences.measures import CROWD_TABLE, TABLE
from desirepath.learning.preferences.step_terms import Steps
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import Setup, check_names, get_setup

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


_PLACES = {measure.name: k for table in (TABLE, CROWD_TABLE) for k, measure in enumerate(table)}


@dataclass(frozen=True)
class Objective:
    """One thing that people may prefer more of.

    name: also the key of its words (`shared.objectives.NAME`, `flow.objectives.NAME`). measured_by: one of MEASURES,
    whose table knows unit and typical difference; sign: +1 for more of that, -1 for less. step_term: (n,) in [-1, 0],
    what a policy is rewarded by. bound: the best value of its measure that a scene allows. share: where a setup's
    file gives no scale, what its step term costs the base policy per trajectory at full weight, in parts of what the
    goal is worth; about as in the shipped setups. opposite: what nobody prefers at the
    same time; mirrored: what it is in a world with left and right exchanged, itself where there is no side to it.
    """

    name: str
    measured_by: str
    sign: int
    step_term: Callable[[Steps], Floats]
    bound: Callable[[SceneBounds], float]
    share: float
    opposite: str = ""
    mirrored: str = ""

    @property
    def measure(self) -> int:
        """Its place among the measures of its setups."""
        return _PLACES[self.measured_by]


OBJECTIVES = (
    Objective("farther", "min_human_distance_m", +1, step_terms.too_near, bounds.ceiling_m, 1.5, "closer"),
    Objective("closer", "min_human_distance_m", -1, step_terms.too_far, bounds.contact_m, 1.5, "farther"),
    Objective(
        "person_on_left",
        "passing_side",
        +1,
        step_terms.person_on_right,
        bounds.straight_left,
        0.3,
        opposite="person_on_right",
        mirrored="person_on_right",
    ),
    Objective(
        "person_on_right",
        "passing_side",
        -1,
        step_terms.person_on_left,
        bounds.straight_right,
        0.3,
        opposite="person_on_left",
        mirrored="person_on_left",
    ),
    Objective("clearance", "min_clearance_m", +1, step_terms.near_obstacle, bounds.start_clearance_m, 0.5),
    Objective("shorter", "path_length_m", -1, step_terms.detour, bounds.straight_way_m, 0.15),
    Objective("smoother", "accumulated_angle_rad", -1, step_terms.turning, bounds.turn_to_goal_rad, 0.4),
    Objective("slower_near_person", "speed_near_person_m_s", -1, step_terms.fast_near_person, bounds.standing_m_s, 1.6),
    Objective("faster", "time_s", -1, step_terms.every_step, bounds.full_speed_s, 1.6),
)


CROWD_OBJECTIVES = (
    Objective("farther", "min_human_distance_m", +1, step_terms.too_near, bounds.nearest_ceiling_m, 1.5, "closer"),
    Objective("closer", "min_human_distance_m", -1, step_terms.too_far, bounds.touching_m, 1.5, "farther"),
    Objective("cuts_in_front", "ahead_of_people", +1, step_terms.behind_people, bounds.always, 2.0, "passes_behind"),
    Objective(
        "passes_behind", "ahead_of_people", -1, step_terms.ahead_of_people, bounds.always_behind, 2.0, "cuts_in_front"
    ),
    Objective("follows", "following", +1, step_terms.after_nobody, bounds.always, 3.0),
    Objective("waits", "moving_beside_people", -1, step_terms.moving_beside_people, bounds.never, 2.0),
    Objective("smoother", "accumulated_angle_rad", -1, step_terms.turning, bounds.turn_to_goal_rad, 0.5),
    Objective("slower_near_person", "speed_near_person_m_s", -1, step_terms.fast_near_person, bounds.standing_m_s, 2.0),
    Objective("faster", "time_s", -1, step_terms.every_step, bounds.full_speed_s, 3.0),
)
"""Among pedestrians. Each stands in the place of one of OBJECTIVES with the same sign and place of its measure, so that
posterior, rewards and policies treat them alike; `objectives_of` says which a setup has."""
NAMES = tuple(objective.name for objective in OBJECTIVES)
CROWD_NAMES = tuple(objective.name for objective in CROWD_OBJECTIVES)
SIZE = len(OBJECTIVES)
OPPOSITES = tuple(
    (k, NAMES.index(objective.opposite))
    for k, objective in enumerate(OBJECTIVES)
    if objective.opposite in NAMES[k + 1 :]
)
"""Pairs of objectives that nobody prefers at once, as indices."""
MIRRORED = np.array([NAMES.index(objective.mirrored or objective.name) for objective in OBJECTIVES])
"""weights[MIRRORED]: the same preference in a world with left and right exchanged."""


def objectives_of(setup: str) -> tuple[Objective, ...]:
    """The nine that people may prefer in that setup, in the order of everything that is ordered by them."""
    return CROWD_OBJECTIVES if get_setup(setup).pedestrians else OBJECTIVES


def names_of(setup: str) -> tuple[str, ...]:
    """(9,) names of `objectives_of`."""
    return CROWD_NAMES if get_setup(setup).pedestrians else NAMES


def mirrored_of(setup: str) -> NDArray[np.int64]:
    """weights[this]: the same preference with left and right exchanged; among pedestrians no side is preferred."""
    return np.arange(SIZE) if get_setup(setup).pedestrians else MIRRORED


def sides_of(setup: str) -> tuple[int, ...]:
    """Places of the objectives that prefer a side."""
    return tuple(k for k, row in enumerate(objectives_of(setup)) if row.measured_by == "passing_side")


def scales(setup: str) -> Mapping[str, float]:
    """Reward per step of objectives' step terms at full weight, by name, as far as the setup's file says. Raises
    SetupError for a file that names another objective."""
    own = get_setup(setup).preferences.scales
    check_names(setup, "scales", own, names_of(setup))
    return own


def preference_weights(weights: Mapping[str, float]) -> Floats:
    """(9,) float32 preference weights from objectives by name, of one person or among pedestrians; what is not named
    weighs nothing.

    Raises LearningError for an unknown name, a weight outside [0, 1] or two opposites.
    """
    names = CROWD_NAMES if any(name not in NAMES and name in CROWD_NAMES for name in weights) else NAMES
    unknown = [name for name in weights if name not in names]
    if unknown:
        among = f"; among pedestrians {', '.join(CROWD_NAMES)}" if names is NAMES else ""
        raise LearningError(f"objective {unknown[0]!r} is unknown; known are {', '.join(names)}{among}")
    return check_weights(np.array([weights.get(name, 0.0) for name in names], dtype=np.float32), names)


def parse_weights(text: str) -> Floats:
    """Preference weights from words such as `farther=1,smoother=0.5`; empty: nothing. Raises LearningError."""
    named: dict[str, float] = {}
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        try:
            named[name.strip()] = float(value)
        except ValueError:
            raise LearningError(
                f"preference weights {word!r}: write it as objective=weight, e.g. farther=1,smoother=0.5"
            ) from None
    return preference_weights(named)


def check_weights(weights: Floats, names: Sequence[str] = NAMES) -> Floats:
    """The weights (9,) of the objectives of those names as float32. Raises LearningError unless each is in [0, 1] and
    no two are opposites."""
    weights = np.asarray(weights, dtype=np.float32)
    if weights.shape != (SIZE,):
        raise LearningError(f"preference weights have shape {weights.shape}; needed is ({SIZE},)")
    for name, weight in zip(names, weights, strict=True):
        if not 0.0 <= weight <= 1.0:
            raise LearningError(f"preference weight {name} = {weight:g}: must be between 0 and 1")
    for a, b in OPPOSITES:
        if weights[a] > 0 and weights[b] > 0:
            message = f"preference weights {names[a]} and {names[b]} are opposites: only one may be above 0"
            raise OppositeWeights(message)
    return weights


def shares_of_reward(weights: Floats) -> Floats:
    """(..., 9) preference weights -> what part of the reward each is given: several together have that of one full
    weight.

    Else two objectives would ask for more than the goal is worth, and the robot stood still.
    """
    together: Floats = weights / np.maximum(weights.sum(axis=-1, keepdims=True), np.float32(1))
    return together


def gains(differences: Doubles) -> Doubles:
    """(n, 7) differences of measures -> (n, 9): how much better for each objective, in the measure's unit."""
    columns = [objective.measure for objective in OBJECTIVES]
    signs = np.array([objective.sign for objective in OBJECTIVES], dtype=np.float64)
    return differences[:, columns] * signs


def step_terms_of(actions: Floats, next_observations: Floats, setup: Setup) -> Floats:
    """(n, 9) float32 in the order of OBJECTIVES, each in [-1, 0], of the states that the steps led to."""
    steps = Steps(actions, next_observations, setup)
    return np.stack([objective.step_term(steps) for objective in objectives_of(setup.name)], axis=1).astype(np.float32)


def best_possible(scenes: Sequence[Scene]) -> Doubles:
    """(n, 9) the measure of each objective that no policy can better in that scene, whatever it gives up for it."""
    return np.array(
        [[objective.bound(SceneBounds(scene)) for objective in objectives_of(scene.setup)] for scene in scenes]
    )
