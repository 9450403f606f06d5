"""How far a robot does as it was told: in the steps in which a rule holds, the share in which it is obeyed.

What counts as obeyed, wish by wish, is in OBEYED; a zone is obeyed where the robot's body keeps out of it. A rule of
zones alone holds where one of them is somewhere: a home without a bathroom tells nothing of who keeps out of it. All
ours.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from desirepath.analysis.estimates import Estimate, mean_estimates
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.rules.homes import SETUP
from desirepath.learning.rules.obeying import ObeyingPolicy, Situation
from desirepath.learning.rules.rule import Rule, Wish
from desirepath.simulation.fast import clearance_m, rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Trajectory, arrived

BESIDE_M = 2.0  # in which sides and slowness near the person are judged


class _Step(NamedTuple):
    """speed (m/s), turning (rad/s), distance to the person (m), their bearing (rad), clearance (m), and the speed
    towards the goal as a share of the speed; of what full speed is (m/s)."""

    speed: float
    turning: float
    distance: float
    bearing: float
    clearance: float
    onward: float
    full: float


OBEYED: Mapping[str, Callable[[_Step], bool]] = {
    "farther": lambda step: step.distance >= 1.2,
    "closer": lambda step: step.distance <= 1.5,
    "person_on_left": lambda step: step.distance > BESIDE_M or step.bearing > 0,
    "person_on_right": lambda step: step.distance > BESIDE_M or step.bearing < 0,
    "clearance": lambda step: step.clearance >= 0.35,
    "shorter": lambda step: step.onward >= 0.8,
    "smoother": lambda step: step.turning <= 0.8,
    "slower_near_person": lambda step: step.distance > BESIDE_M or step.speed <= 0.5 * step.full,
    "faster": lambda step: step.speed >= 0.8 * step.full,
}
SLOW_SHARE = 0.55
"""Of full speed, below which a robot drives slowly."""


def _is_obeyed(wish: Wish, step: _Step) -> bool:
    if wish.objective == "faster" and not wish.more:
        return step.speed <= SLOW_SHARE * step.full
    return OBEYED[wish.objective](step) == wish.more


def obeyed_steps(rule: Rule, trajectory: Trajectory, place: int = 0) -> tuple[int, int]:
    """(steps in which the rule held, those of them in which it was obeyed)."""
    scene, setup = trajectory.scene, get_setup(trajectory.scene.setup)
    poses = trajectory.poses.astype(np.float64)
    held = obeyed = 0
    for number in range(len(trajectory.actions)):
        moment = Situation.at(scene, poses[number], number * CONTROL_DT_S, place)
        areas = [area for zone in rule.zones for area in moment.areas(zone)]
        if not moment.in_force([rule]) or not (areas or rule.wishes):
            continue
        held += 1
        before, after = poses[number], poses[number + 1]
        to_goal = [math.dist(at[:2], (scene.goal.x, scene.goal.y)) for at in (before, after)]
        moved = math.dist(before[:2], after[:2])
        x, y, _ = moment.person
        step = _Step(
            moved / CONTROL_DT_S,
            abs(math.remainder(after[2] - before[2], 2 * math.pi)) / CONTROL_DT_S,
            math.dist(after[:2], (x, y)),
            math.remainder(math.atan2(y - after[1], x - after[0]) - after[2], 2 * math.pi),
            clearance_m(scene, poses[number + 1 : number + 2]) if rule.wishes else math.inf,
            (to_goal[0] - to_goal[1]) / max(moved, 1e-6),
            setup.robot.limits.v_max,
        )
        outside = all(float(area.distance_m(*after[:2])) >= setup.robot.radius_m for area in areas)
        obeyed += outside and all(_is_obeyed(wish, step) for wish in rule.wishes)
    return held, obeyed


@dataclass(frozen=True)
class Obedience:
    """Of one rule: homes in which it held; the share obeyed, without the rule, and by how much that differs; the
    share of all homes in which the robot arrived, with and without."""

    homes: int
    obeyed: Estimate
    without: Estimate
    difference: Estimate
    arrived: float
    arrived_without: float


def measure_obedience(rule: Rule, scenes: Sequence[Scene], usual: Sequence[Trajectory] | None = None) -> Obedience:
    """The rule in those homes, against the same policy without rules (`usual`: its rollouts, where they are there)."""
    usual = usual if usual is not None else drive_by([], scenes)
    told = drive_by([rule], scenes)
    pairs = []
    for own, other in zip(told, usual, strict=True):
        (held, did), (held_before, did_before) = obeyed_steps(rule, own), obeyed_steps(rule, other)
        if held and held_before:
            pairs.append((did / held, did_before / held_before))
    with_it, without = np.array(pairs).reshape(-1, 2).T
    columns = mean_estimates({"with": with_it, "without": without, "difference": with_it - without})
    return Obedience(
        len(pairs),
        columns["with"],
        columns["without"],
        columns["difference"],
        float(arrived(told).mean()),
        float(arrived(usual).mean()),
    )


@lru_cache(maxsize=1)
def _conditioned() -> ConditionedPolicy:
    return load_conditioned(f"{SETUP}/conditioned")


def drive_by(rules: Sequence[Rule], scenes: Sequence[Scene], places: Sequence[int] | None = None) -> list[Trajectory]:
    """Rollouts in homes. places: which place each is, for zones drawn there; None: each the first."""
    policy = ObeyingPolicy(_conditioned(), {}, rules, places)
    return rollout(get_setup(SETUP), policy, list(scenes))
