"""A small ranking set for tests: the study room's base policy in rooms of five things."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from desirepath.explain.methods import AttributionError
from desirepath.explain.ranking_sets import ExplainedRollout, RankingSet, explain_rollout
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.scene import Scene

FIVE = (0, 2, 3, 5, 6)  # of the study room's eight: three boxes and two pillars


def five_things() -> Iterator[Scene]:
    for scene in scene_set("study_room", 400, purpose=Purpose.FIGURE, seed=17):
        yield replace(scene, obstacles=tuple(scene.obstacles[i] for i in FIVE))


@cache
def small_ranking_set(count: int = 8, practice: int = 2) -> RankingSet:
    """`count` rollouts and some for practice, each with three things at least that told the policy something."""
    policy = load_policy("study_room/base")
    found: list[ExplainedRollout] = []
    for scene in five_things():
        if len(found) == count + practice:
            break
        try:
            one = explain_rollout(actor_of(policy), policy.rollout_policy, scene)
        except AttributionError:
            continue
        if (one.scores[-1] > 0).sum() >= 3:
            found.append(replace(one, practice=len(found) >= count))
    return RankingSet("study_room", tuple(found), "study_room/base", "saliency", "speed")
