"""The scenes that paths are drawn in, which every participant sees: chapter 2's two environments with four
position-orientation pairs each, four scenes of the study room, where drawing is one of several ways to say what one
prefers (ours), and four homes (ch. 3). Which they are says `demonstrations` of the setup's file.
"""

from __future__ import annotations

import math
from dataclasses import replace

from desirepath.simulation.scene import Person, Pose, Scene, SceneError
from desirepath.simulation.scenes import check_scene, draw_scene
from desirepath.simulation.setup_parts import DemonstrationSettings
from desirepath.simulation.setups import SETUPS, get_setup

FURNITURE_SEED = 0  # furniture stands where it stands in every scene of an environment


def _settings_of(setup: str) -> DemonstrationSettings:
    drawn = get_setup(setup).demonstrations
    if drawn is None:
        known = ", ".join(one.name for one in SETUPS.values() if one.demonstrations)
        raise SceneError("setup", setup, f"has no demonstration pairs; known: {known}")
    return drawn


def pairs_of(setup: str) -> int:
    """How many situations paths are drawn in there. Raises SceneError where none are."""
    drawn = _settings_of(setup)
    return len(drawn.pairs) or len(drawn.seeds)


def demonstration_scene(setup: str, pair: int) -> Scene:
    """The scene of that environment and pair, from 0. Raises SceneError for any other.

    In scenes that are drawn from a seed the robot begins looking where the goal is, so that a drawn path and a policy
    begin alike.
    """
    drawn = _settings_of(setup)
    if not 0 <= pair < pairs_of(setup):
        raise SceneError("pair", pair, f"must lie in 0..{pairs_of(setup) - 1}")
    if drawn.seeds:
        scene = draw_scene(setup, drawn.seeds[pair])
        ahead = math.atan2(scene.goal.y - scene.start.y, scene.goal.x - scene.start.x)
        return replace(scene, start=replace(scene.start, yaw=ahead))
    places = drawn.pairs[pair]
    start, goal = Pose(*places.start), Pose(*places.goal)
    towards = math.atan2(goal.y - start.y, goal.x - start.x)
    scene = replace(
        draw_scene(setup, FURNITURE_SEED),
        seed=pair,
        start=start,
        goal=replace(goal, yaw=towards),
        person=Person(Pose(*places.person)),
    )
    check_scene(scene)
    return scene


def pair_seed(setup: str, pair: int) -> int:
    """The seed of `demonstration_scene(setup, pair)`, which is not drawn for it."""
    seeds = _settings_of(setup).seeds
    return seeds[pair] if seeds else pair


def demonstration_scenes(setup: str) -> list[Scene]:
    """All pairs of an environment, in order."""
    return [demonstration_scene(setup, pair) for pair in range(pairs_of(setup))]
