"""Any policy explained, for pages and the command line: by what moved its network, or by whom it looked at."""

from __future__ import annotations

from desirepath.explain.explanation_files import attended_files, explanation_files
from desirepath.explain.flow_files import FigureFiles
from desirepath.explain.flow_words import ENGLISH_EXPLANATION, ExplanationWords
from desirepath.explain.methods import check_method
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.policy import DrivingPolicy, Policy
from desirepath.simulation.scene import Scene


def explain_policy(
    policy: DrivingPolicy,
    scene: Scene,
    *,
    name: str,
    method: str,
    command: str,
    at_s: float | None,
    words: ExplanationWords = ENGLISH_EXPLANATION,
) -> FigureFiles:
    """explanation.png, .svg and .csv. Of a policy with attention the method is its own. Raises AttributionError for an
    unknown method, command or moment, LearningError for a policy that nothing explains."""
    which, what = check_method(method, command)
    if not isinstance(policy, Policy | ForeignPolicy):
        return attended_files(*policy.attended(scene), name=name, command=what, at_s=at_s, words=words)
    from desirepath.learning.policies.torch_actor import actor_of

    actor, acts = actor_of(policy), policy.rollout_policy
    return explanation_files(actor, acts, scene, name=name, method=which, command=what, at_s=at_s, words=words)
