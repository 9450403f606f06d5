"""The scenes that paths are drawn in: chapter 2's two environments with four position-orientation pairs each, four
scenes of the study room, where drawing is one of several ways to say what one prefers (ours), and four homes (ch. 3).

Everything that is drawn from a seed lives in `scenes.py`; here stand the places that every participant sees.
"""

from __future__ import annotations

import math
from dataclasses import replace

from desirepath.simulation.scene import Person, Pose, Scene, SceneError
from desirepath.simulation.scenes import check_scene, draw_scene
from desirepath.simulation.setups import DEMONSTRATION_SETUPS

FURNITURE_SEED = 0  # furniture stands where it stands in every scene of an environment

# (robot start, goal, person), ours: the thesis shows its places in figure 2.4 only. The robot comes from either side;
# the person faces it, turns their back to it, or stands across its way.
_PAIRS: dict[str, tuple[tuple[Pose, Pose, Pose], ...]] = {
    "corridor": (
        (Pose(-3.2, 0.0, 0.0), Pose(3.2, 0.0), Pose(0.0, -0.6, math.pi)),
        (Pose(-3.2, 0.0, 0.0), Pose(3.2, 0.0), Pose(0.2, 0.6, 0.0)),
        (Pose(3.2, 0.0, math.pi), Pose(-3.2, 0.0), Pose(0.4, -0.7, math.pi / 2)),
        (Pose(3.2, 0.0, math.pi), Pose(-3.2, 0.0), Pose(-0.3, 0.5, 0.0)),
    ),
    "room": (
        (Pose(-2.9, 0.1, 0.0), Pose(2.5, -0.1), Pose(-0.1, 0.0, math.pi)),
        (Pose(-2.9, 0.1, 0.0), Pose(2.5, -0.1), Pose(0.2, 0.4, math.pi / 2)),
        (Pose(2.5, -0.1, math.pi), Pose(-2.9, 0.1), Pose(0.0, -0.2, 0.0)),
        (Pose(-2.8, -1.7, math.pi / 4), Pose(2.2, 1.6), Pose(-0.2, 0.2, -math.pi / 2)),
    ),
}
PAIRS = 4
_DRAWN_IN = {
    "study_room": (3_500_000_034, 3_500_000_019, 3_500_000_003, 3_500_000_011),
    "home": (3_500_000_015, 3_500_000_032, 3_500_000_003, 3_500_000_021),
}
"""Setup -> seeds of its scenes: of those that figures show; the study room's are those in which weights are changed by
hand, too, the homes' in each of the four rooms one, with the person beside the way."""
SEEN_BY_DEPTH = ("home",)  # where a robot has a depth camera
DRAWN_IN = (*DEMONSTRATION_SETUPS, *_DRAWN_IN)


def demonstration_scene(setup: str, pair: int) -> Scene:
    """The scene of that environment (`corridor`, `room`, `study_room`, `home`) and pair 0..3. Raises SceneError for any
    other.

    In study room and homes the robot begins looking where the goal is, so that a drawn path and a policy begin alike.
    """
    if setup not in DRAWN_IN:
        raise SceneError("setup", setup, f"has no demonstration pairs; known: {', '.join(DRAWN_IN)}")
    if not 0 <= pair < PAIRS:
        raise SceneError("pair", pair, f"must lie in 0..{PAIRS - 1}")
    if setup in _DRAWN_IN:
        drawn = draw_scene(setup, _DRAWN_IN[setup][pair])
        ahead = math.atan2(drawn.goal.y - drawn.start.y, drawn.goal.x - drawn.start.x)
        return replace(drawn, start=replace(drawn.start, yaw=ahead))
    start, goal, person = _PAIRS[setup][pair]
    towards = math.atan2(goal.y - start.y, goal.x - start.x)
    scene = replace(
        draw_scene(setup, FURNITURE_SEED),
        seed=pair,
        start=start,
        goal=replace(goal, yaw=towards),
        person=Person(person),
    )
    check_scene(scene)
    return scene


def pair_seed(setup: str, pair: int) -> int:
    """The seed of `demonstration_scene(setup, pair)`, which is not drawn for it."""
    return _DRAWN_IN[setup][pair] if setup in _DRAWN_IN else pair


def demonstration_scenes(setup: str) -> list[Scene]:
    """All pairs of an environment, in order."""
    return [demonstration_scene(setup, pair) for pair in range(PAIRS)]
