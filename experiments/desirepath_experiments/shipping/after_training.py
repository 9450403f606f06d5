"""What a trained conditioned policy is given afterwards, chosen on selection scenes: how strongly an objective enters,
and a rule that slows the robot down beside the person. The networks stay as they are.

What the rule does is `simulation/slowing.py`'s, training `conditioned_training.py`'s. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from desirepath.deploy.steering import Slowing
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.steerability import Course, MeasuredRollouts
from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import gains, preference_weights
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.setups import require_same

FIRST_ADDED_SEED = 720  # selection scenes that nothing else was chosen on
TIME = MEASURES.index("time_s")
Preference = Mapping[str, float]


@dataclass(frozen=True)
class At:
    """Where something is tried. conditioned_on: weights. judged_by: what somebody prefers of whom answers said these;
    None: the same."""

    conditioned_on: Preference
    judged_by: Preference | None = None

    @property
    def preferred(self) -> Preference:
        return self.judged_by or self.conditioned_on


@dataclass(frozen=True)
class AddedConfig:
    """strengths: tried for full `strengthened`, from weak to strong. most: shares of full speed tried beside the
    person, from fast to slow, within near_m of them; from free_m on nothing is slowed.

    The last that does no harm is kept, and nothing beyond the first that does: nowhere where it is tried may success
    fall by more than max_loss, self-intersections per rollout rise above most_crossings (one robot that circles makes
    ten), or what is preferred be less than without by more than the tolerance (typical differences, about two standard
    errors); a rule may not make the median rollout longer than longest_s in the first place, since people watch it.
    """

    setup: str
    seed: int = 0
    strengthened: str = "clearance"
    strengths: tuple[float, ...] = (1.25, 1.375, 1.5, 1.75)
    strengths_tried_at: tuple[At, ...] = (
        At({"clearance": 1.0}),
        At({"clearance": 1.0}, {"clearance": 1.0, "faster": 0.67}),  # answers often find one of two
        At({"clearance": 1.0, "faster": 0.37}),
        At({"clearance": 1.0, "faster": 0.67}),
        At({"clearance": 1.0, "farther": 0.5}),
        At({"clearance": 1.0, "slower_near_person": 0.5}),
    )
    near_m: float = 2.0
    free_m: float = 3.0
    most: tuple[float, ...] = (0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2)
    most_tried_at: tuple[At, ...] = (
        At({"slower_near_person": 1.0}),
        At({"slower_near_person": 1.0, "person_on_left": 0.67}),
        At({"slower_near_person": 1.0, "clearance": 0.7}),
    )
    scenes: int = 2_000
    max_loss: float = 0.003
    most_crossings: float = 0.02
    tolerance: float = 0.02
    longest_s: float = 30.0

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


ADDED = {"open_field": AddedConfig("open_field")}
"""By setup, what is added to its shipped conditioned policy. The study room's slows down by itself, and stand-ins and
other studies' numbers are of it as it is."""


@dataclass(frozen=True)
class Tried:
    """A policy at one place on the selection scenes. gained: of the preference against before, where both arrive
    (typical differences)."""

    at: At
    success: float
    self_intersections: float
    gained: float
    median_s: float


@dataclass(frozen=True)
class Added:
    """The policy with what was added, and all that was tried, the kept ones among them."""

    policy: ConditionedPolicy
    tried: dict[str, list[list[Tried]]] = field(default_factory=dict)

    def kept(self) -> dict[str, Any]:
        """What the policy has now beyond what its network learned."""
        rule = self.policy.slowing
        return {"strengths": dict(self.policy.strengths), "slowing": rule.as_dict() if rule else None}

    def report(self) -> dict[str, Any]:
        """For the card."""
        return {name: [[asdict(tried) for tried in of] for of in lines] for name, lines in self.tried.items()}


def add_after_training(trained: ConditionedPolicy, config: AddedConfig) -> Added:
    """Choose a strength, then the slowing rule. Raises SetupError for a policy of another setup."""
    require_same(policy=trained.setup, config=config.setup)
    scenes = scene_set(config.setup, config.scenes, purpose=Purpose.SELECT, seed=FIRST_ADDED_SEED + config.seed)
    course = Course(scenes)
    stronger = [replace(trained, strengths={config.strengthened: strength}) for strength in config.strengths]
    added, strengths = _last_harmless(trained, stronger, config.strengths_tried_at, course, config, math.inf)
    slower = [replace(added, slowing=Slowing(config.near_m, config.free_m, most)) for most in config.most]
    added, slowings = _last_harmless(added, slower, config.most_tried_at, course, config, config.longest_s)
    return Added(added, {"strengths": strengths, "slowings": slowings})


def _last_harmless(
    before: ConditionedPolicy,
    tried: Sequence[ConditionedPolicy],
    places: Sequence[At],
    course: Course,
    config: AddedConfig,
    longest_s: float,
) -> tuple[ConditionedPolicy, list[list[Tried]]]:
    """The last of those tried before the first that harms, and what was found of each, `before` first."""
    usual = [_roll_out(before, place, course) for place in places]
    lines = [[_try(place, rolled, rolled, config) for place, rolled in zip(places, usual, strict=True)]]
    harmless = before
    for policy in tried:
        of_policy = [
            _try(place, _roll_out(policy, place, course), rolled, config)
            for place, rolled in zip(places, usual, strict=True)
        ]
        lines.append(of_policy)
        if of_policy[0].median_s > longest_s or any(
            _harms(each, without, config) for each, without in zip(of_policy, lines[0], strict=True)
        ):
            break
        harmless = policy
    return harmless, lines


def _harms(tried: Tried, without: Tried, config: AddedConfig) -> bool:
    return (
        tried.success < without.success - config.max_loss
        or tried.self_intersections > max(config.most_crossings, without.self_intersections)
        or tried.gained < -config.tolerance
    )


def _roll_out(policy: ConditionedPolicy, at: At, course: Course) -> MeasuredRollouts:
    return course.rollout(policy.at(preference_weights(at.conditioned_on)).without_critic())


def _try(at: At, own: MeasuredRollouts, before: MeasuredRollouts, config: AddedConfig) -> Tried:
    both = own.success & before.success
    better = gains((own.measured - before.measured)[both] / typical_differences(config.setup))
    return Tried(
        at,
        float(own.success.mean()),
        float(own.self_intersections.mean()),
        float((better @ preference_weights(at.preferred).astype(np.float64)).mean()),
        float(np.median(own.measured[own.success, TIME])),
    )
