"""Any policy explained, for pages, stages and the command line: by what moved its network, or by whom it looked at."""

from __future__ import annotations

from desirepath.explain.explanation_files import attended_files, explanation_files
from desirepath.explain.flow_files import FigureFiles
from desirepath.explain.flow_words import ENGLISH_EXPLANATION, ExplanationWords
from desirepath.explain.methods import Command, Method, check_method
from desirepath.explain.shown_explanation import Scores, ShownExplanation
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.policy import DrivingPolicy, Policy
from desirepath.simulation.scene import Scene
from desirepath.simulation.trajectory import Trajectory


def explain_along(
    policy: Policy | ForeignPolicy, trajectory: Trajectory, *, method: Method, command: Command
) -> tuple[tuple[str, ...], Scores, ShownExplanation]:
    """Things and their scores, a row per moment, along a way that may be another's, and the scene's objects among them
    for the stage."""
    from desirepath.explain.attribution import explain  # torch comes with it: only where somebody looks
    from desirepath.explain.sight import sight_of, thing_names
    from desirepath.learning.policies.torch_actor import actor_of

    found = explain(actor_of(policy), sight_of(trajectory), method=method, command=command)
    scores = tuple(tuple(float(score) for score in row) for row in found.scores)
    objects = tuple(thing_names(trajectory.scene)[: len(trajectory.scene.obstacles)])
    of_objects = tuple(row[: len(objects)] for row in (*scores, scores[-1]))
    return found.things, scores, ShownExplanation(objects, of_objects, outlines=True, lidar=True)


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
    policy = policy.in_scene(scene)
    if not isinstance(policy, Policy | ForeignPolicy):
        return attended_files(*policy.attended(scene), name=name, command=what, at_s=at_s, words=words)
    from desirepath.learning.policies.torch_actor import actor_of

    actor, acts = actor_of(policy), policy.rollout_policy
    return explanation_files(actor, acts, scene, name=name, method=which, command=what, at_s=at_s, words=words)
