"""What a conditioned policy would do from where the robot is: one rollout in one scene, in milliseconds.

For steps at which weights are changed by hand (`kinds/live.py`) and for analysts. Nothing is stored here; who may ask
is the routes'.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from desirepath.simulation.setup_parts import PLACES
from desirepath.store.artefacts import ArtefactStore

if TYPE_CHECKING:  # numba and the simulator come with these; a server that starts need not wait for them
    from desirepath.learning.policies.conditioned import ConditionedPolicy
    from desirepath.learning.policies.policy import DrivingPolicy, Policy
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.trajectory import Trajectory

FARTHEST_M = 100.0  # from the middle of open ground
LOOKED_AT, LEAST_LOOKED = 2, 0.1  # ours: things that are named, and the mean score below which none is


@dataclass(frozen=True)
class LivePath:
    """track: rows of [t s, x m, y m, yaw rad]; arrives: whether the robot comes to the goal."""

    track: list[list[float]]
    arrives: bool
    seconds: float


@lru_cache(maxsize=8)
def scenes_of(setup: str) -> tuple[Scene, ...]:
    """The scenes of a setup in which weights are changed, the same for everybody: those of the figures' that its file
    says, else the first."""
    from desirepath.learning.scene_sets import Purpose, first_seed
    from desirepath.simulation.scenes import draw_scenes
    from desirepath.simulation.setups import get_setup

    places = get_setup(setup).preferences.places or range(PLACES)
    return tuple(draw_scenes(setup, [first_seed(Purpose.FIGURE, 0) + place for place in places]))


@lru_cache(maxsize=4)
def load_shipped_conditioned(setup: str) -> ConditionedPolicy:
    """The conditioned policy that comes with a setup. Raises LearningError where none does."""
    from desirepath.learning.policies.shipped import load_conditioned

    return load_conditioned(f"{setup}/conditioned")


@lru_cache(maxsize=4)
def shipped_base(setup: str) -> Policy:
    """The usual robot's policy."""
    from desirepath.learning.policies.shipped import load_policy

    return load_policy(f"{setup}/base")


@lru_cache(maxsize=64)
def typical_rollouts(setup: str, place: int) -> tuple[Trajectory, ...]:
    """What the robot does there at each weight alone, so that the view from above is wide enough for what may come."""
    from desirepath.learning.policies.conditioned import settings

    conditioned = load_shipped_conditioned(setup)
    alone = settings(setup=setup).values()
    return tuple(roll_out(conditioned.at(weights), scenes_of(setup)[place]) for weights in alone)


@lru_cache(maxsize=4)
def warm_up(setup: str) -> bool:
    """Policies read and simulator compiled: the first rollout of a process takes seconds, every other milliseconds."""
    scene = scenes_of(setup)[0]
    return all(path_of(roll_out(policy, scene)).track for policy in (condition_on(setup, {}), shipped_base(setup)))


@lru_cache(maxsize=4)
def driving(files: ArtefactStore, policy: str) -> DrivingPolicy:
    """A stored policy; the last few stay, since each move of a slider or a place asks for one again."""
    from desirepath.learning.policies.policy import read_policy

    return read_policy(files.get(policy)).driving()


def network_in(policy: DrivingPolicy, scene: Scene) -> Policy:
    """The network that drives there. Raises LearningError where none does."""
    from desirepath.learning.policies.policy import network_of

    return network_of(policy.in_scene(scene))


def condition_on(setup: str, weights: Mapping[str, float]) -> Policy:
    """The setup's conditioned policy at these weights. Raises LearningError for weights that cannot be."""
    from desirepath.learning.preferences.objectives import preference_weights

    return load_shipped_conditioned(setup).at(preference_weights(weights))


def roll_out(
    policy: DrivingPolicy, scene: Scene, pose: Sequence[float] | None = None, seconds: float = 0.0
) -> Trajectory:
    """The policy from the scene's start, or from that pose (x, y, yaw), so many seconds after whoever walks there began
    to. Raises SceneError for a pose outside the room."""
    from desirepath.simulation.fast import rollout
    from desirepath.simulation.scene import Pose, SceneError
    from desirepath.simulation.scenes import extent_m
    from desirepath.simulation.setups import get_setup

    if pose is not None:
        x, y, yaw = pose
        low, high = extent_m(scene) or ((-FARTHEST_M, -FARTHEST_M), (FARTHEST_M, FARTHEST_M))
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
            raise SceneError("start", (x, y), "lies outside the room")
        crowd = scene.crowd.later(seconds) if scene.crowd else None
        scene = replace(scene, start=Pose(x, y, math.remainder(yaw, 2 * math.pi)), crowd=crowd)
    return rollout(get_setup(scene.setup), policy.rollout_policy, [scene])[0]


def path_of(trajectory: Trajectory) -> LivePath:
    """What the page draws of a rollout, yaw without jumps."""
    import numpy as np

    from desirepath.simulation.trajectory import Outcome

    poses = np.asarray(trajectory.poses, np.float64)
    rows = np.round(np.column_stack([trajectory.times, poses[:, :2], np.unwrap(poses[:, 2])]), 4)
    return LivePath(rows.tolist(), trajectory.outcome == Outcome.SUCCESS, trajectory.duration_s)


def looks_at(policy: DrivingPolicy, trajectory: Trajectory) -> list[str]:
    """The things that moved the policy's turning most on this way, the most first, at most `LOOKED_AT`; none that
    hardly did. Turning, as what moves the study room's speeds is told apart from chance by no method.
    """
    from desirepath.explain.attribution import explain  # torch comes with it: only where a protocol asks
    from desirepath.explain.sight import WALLS, sight_of
    from desirepath.learning.policies.torch_actor import actor_of

    explained = explain(actor_of(network_in(policy, trajectory.scene)), sight_of(trajectory), command="turning")
    means = dict(zip(explained.things, explained.scores.mean(axis=0).tolist(), strict=True))
    named: dict[str, float] = {}
    for thing, score in means.items():
        kind = "wall" if thing in WALLS else re.sub(r" \d+$", "", thing)
        if thing != "goal":
            named[kind] = max(named.get(kind, 0.0), score)
    ordered = sorted(named, key=lambda kind: -named[kind])
    return [kind for kind in ordered[:LOOKED_AT] if named[kind] >= LEAST_LOOKED]
