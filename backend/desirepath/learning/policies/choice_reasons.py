"""Why a robot that chooses per scene drives otherwise than the usual one there: what anybody would see of it, and its
person's answers speak for most. Codes and numbers; the words are the catalogues'. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from desirepath.learning.measures.pairs import reference_differences
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.measures.steps import reference
from desirepath.learning.policies.choosing import Answers, ChoosingPolicy
from desirepath.learning.policies.reason_codes import MORE_OR_LESS, TOLD, Did, Reason
from desirepath.learning.preferences.free_posterior import SOMETHING_ELSE
from desirepath.learning.preferences.measures import MEASURES, TABLE, beside_person, measures, typical_differences
from desirepath.learning.preferences.objectives import OBJECTIVES
from desirepath.learning.preferences.step_terms import SIDE_RANGE_M
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

SIDE, NEAREST = MEASURES.index("passing_side"), MEASURES.index("min_human_distance_m")
BESIDE = 0.5  # cosine: within 60 degrees of where they look is in front of them
BESIDE_FIRST = 0.5  # of what the first reason is expected to gain: a second one that gains less is not told
GOES_WITH = 0.3  # correlation: what goes less with what is expected is no reason


def reasons_in_scene(policy: ChoosingPolicy, own: Trajectory, usual: Trajectory) -> list[Reason]:
    """own, usual: what the policy and the base policy drive in the same scene. `as_usual` alone where the base policy
    was chosen; else up to TOLD reasons, the one first that the answers let expect most of; none where nothing that
    they speak for can be seen, among pedestrians, and where several people's answers chose."""
    answers = policy.answers
    if not isinstance(answers, Answers) or get_setup(policy.setup).pedestrians:
        return []
    if policy.places([own.scene])[0] == 0:
        return [Reason("as_usual")]
    seen = visible([own, usual])
    gained = dict(enumerate(_weights(policy, answers) * (seen[0] - seen[1])))
    told = {k: reason for k in gained if gained[k] > 0 and (reason := _told(k, *seen)) is not None}
    order = sorted(told, key=lambda k: -gained[k])[:TOLD]
    return [told[k] for k in order if gained[k] >= BESIDE_FIRST * gained[order[0]]]


def visible(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, 8) the measures, then where the robot was for the person at its closest: 1 straight in front of them, -1
    behind."""
    return np.column_stack([measures(trajectories), [_ahead(one) for one in trajectories]])


def _ahead(trajectory: Trajectory) -> float:
    apart, ahead = beside_person(trajectory)
    return float(ahead[apart.argmin()])


def _told(which: int, own: Doubles, usual: Doubles) -> Reason | None:
    """None where nobody would see the difference."""
    if which in (SIDE, len(MEASURES)) and max(own[NEAREST], usual[NEAREST]) > SIDE_RANGE_M:
        return None
    if which == len(MEASURES):
        did = _place(own[which])
        return Reason(did) if did != _place(usual[which]) else None
    if which == SIDE and not own[which] * usual[which] < 0:
        return None
    difference = own[which] - usual[which]
    if abs(difference) < TABLE[which].noticeable:
        return None
    did = MORE_OR_LESS[which][int(difference < 0)]
    return Reason(did) if which == SIDE else Reason(did, float(own[which]), float(usual[which]))


def _place(ahead: float) -> Did:
    return "beside" if abs(ahead) < BESIDE else "in_front" if ahead > 0 else "behind"


def _weights(policy: ChoosingPolicy, answers: Answers) -> Doubles:
    """(8,) what the answers let expect of one unit more of what is visible. Where the nine objectives explain them,
    their expected weights; else, over the setup's reference pairs, how what is expected goes with each by itself."""
    free, by_steps = answers.believed
    weights: Doubles = np.zeros(len(MEASURES) + 1)
    if free.something_else() < SOMETHING_ELSE:
        for objective, weight in zip(OBJECTIVES, free.objectives.mean_weights(), strict=True):
            weights[objective.measure] += objective.sign * weight
        weights[: len(MEASURES)] /= typical_differences(policy.setup)
        return weights
    means = policy.basis.means(reference(policy.setup).trajectories)
    steps = policy.basis.between(means[0::2], means[1::2])
    pairs = reference_differences(policy.setup, answers.left_right_symmetry)
    expected = free.advantages(pairs)[0] / policy.scales[0] + by_steps.advantages(steps)[0] / policy.scales[1]
    seen = _reference(policy.setup)
    typical = np.maximum(np.sqrt(np.square(seen).mean(0)), 1e-9)
    weights = (seen / typical).T @ expected / len(seen)
    weights[np.abs(weights) < GOES_WITH * np.sqrt(np.square(expected).mean())] = 0.0
    if answers.left_right_symmetry:
        weights[SIDE] = 0.0
    weights /= typical
    return weights


@lru_cache(maxsize=4)
def _reference(setup: str) -> Doubles:
    seen = visible(reference(setup).trajectories)
    differences: Doubles = seen[0::2] - seen[1::2]
    return differences
