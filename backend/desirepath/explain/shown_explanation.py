"""What of an explanation is shown on a stage, and how whoever cannot see it would rank: plain data, no torch.

Where scores come from is `attribution.py`'s and `ranking_sets.py`'s, drawing them the stage's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.simulation.crowds.crowd_setups import PED_DEPTH_M, PED_HEIGHT_M, PED_WIDTH_M
from desirepath.simulation.pedestrians import where_on_route
from desirepath.simulation.scene import Obstacle, Pose, Scene
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath.simulation.trajectory import Trajectory

Scores = tuple[tuple[float, ...], ...]
PERSON, PEDESTRIAN = "person", "pedestrian"
"""People as things that are scored: the scene's person, and `pedestrian 1` and so on of its crowd."""
AHEAD_M = 0.5  # ours: what lies straight ahead seems so much nearer, to who guesses what mattered


@dataclass(frozen=True)
class ShownAttention:
    """What a policy with attention looked at (chapter 4): one row per pose, each of weights that sum to 1.

    spatial: of lidar sectors; temporal: of descriptor rays; from straight ahead on, counter-clockwise. Empty rows of a
    policy without that stream.
    """

    spatial: Scores
    temporal: Scores


@dataclass(frozen=True)
class ShownExplanation:
    """What of a trajectory's explanation is shown beside its motion.

    things: objects of the scene, its first obstacles in order, or its people. scores: one row per pose, in [0, 1].
    outlines, lidar: whether each is drawn. hold_s: how long they stay after the halt. attention: what is drawn of it,
    beside them.
    """

    things: tuple[str, ...]
    scores: Scores
    outlines: bool
    lidar: bool
    hold_s: float = 1.0
    attention: ShownAttention | None = None


def is_of_people(things: Sequence[str]) -> bool:
    """Whether people are scored, rather than obstacles."""
    return PERSON in things


def people_of(scene: Scene) -> tuple[str, ...]:
    """What the scene's people are called, the person first, as in `Scene.people_at`."""
    crowd = scene.crowd.pedestrians if scene.crowd else ()
    return (PERSON, *(f"{PEDESTRIAN} {number}" for number in range(1, len(crowd) + 1)))


def solids_of(scene: Scene, things: Sequence[str], at_s: float) -> tuple[Obstacle, ...]:
    """The things as boxes on the floor, people where they are at that moment."""
    if not is_of_people(things):
        return scene.obstacles[: len(things)]
    x, y, yaw = (float(value) for value in scene.person_poses([at_s])[0])
    poses = {PERSON: Pose(x, y, yaw)}
    for name, body in zip(people_of(scene)[1:], scene.crowd.pedestrians if scene.crowd else (), strict=True):
        walked = body.walk.poses_at([at_s])[0] if body.walk is not None else where_on_route(body, at_s)
        poses[name] = Pose(*(float(value) for value in walked))
    return tuple(Obstacle(thing, poses[thing], PED_DEPTH_M, PED_WIDTH_M, PED_HEIGHT_M) for thing in things)


def guess_weights(trajectory: Trajectory, things: Sequence[str]) -> dict[str, float]:
    """How much somebody who sees only the room would think that each object matters where the robot stands, above 0:
    near ones more, ahead of it more.
    """
    x, y, yaw = (float(value) for value in trajectory.poses[-1])
    weights = {}
    solids = solids_of(trajectory.scene, things, (len(trajectory.poses) - 1) * CONTROL_DT_S)
    for thing, obstacle in zip(things, solids, strict=True):
        bearing = math.atan2(obstacle.pose.y - y, obstacle.pose.x - x) - yaw
        weights[thing] = 1.0 / (0.2 + max(0.0, float(obstacle.distance_m(x, y)) - AHEAD_M * math.cos(bearing)))
    return weights


def simulate_ranking(
    trajectory: Trajectory,
    things: Sequence[str],
    scores: Mapping[str, float] | None,
    random: np.random.Generator,
    *,
    noise: float = 0.6,
    trust: float = 0.5,
) -> list[str]:
    """The objects as a simulated person ranks them, the most important first.

    scores: what the outlines showed; None: there were none, so the room alone says what matters. trust: how much of a
    place goes by the outlines where there are some. noise: standard deviation of a place, in places.
    """
    guessed = _places(guess_weights(trajectory, things))
    shown = _places(scores) if scores is not None else guessed
    share = trust if scores is not None else 0.0
    felt = {
        thing: share * shown[thing] + (1 - share) * guessed[thing] + noise * float(random.normal()) for thing in things
    }
    return sorted(things, key=lambda thing: felt[thing])


def _places(weights: Mapping[str, float]) -> dict[str, float]:
    """Thing -> its place from 0, the heaviest first; those that weigh the same share the mean of their places."""
    values = list(weights.values())
    return {
        thing: sum(other > value for other in values) + (values.count(value) - 1) / 2
        for thing, value in weights.items()
    }
