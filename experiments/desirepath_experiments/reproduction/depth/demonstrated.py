"""What is demonstrated in homes: nine scenes, about three programmed demonstrations each (section 3.4.2). Simulated."""

from __future__ import annotations

import math
from collections.abc import Sequence

from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.depth.episodes import with_mode
from desirepath.demonstrations.stroke import StrokeProblem
from desirepath.simulation.scene import SceneError
from desirepath.simulation.scenes import draw_scene

SCENES, PER_SCENE = 9, 3
MODES = ("static", "opposite", "static", "random")  # of the person, in turn: the thesis has standing and walking ones
STYLES = ("field_of_view", "behind")  # preferences, in turn
FIRST_SEED = 2**33  # beyond training's homes and all that anything is judged in
WAY_M = (2.0, 4.5)  # ours: longer ones take more than an episode at a demonstrator's 0.22 m/s
TRIES = 200


def home_demonstrations(scenes: int = SCENES, per_scene: int = PER_SCENE) -> list[list[Demonstration]]:
    """So many scenes with so many demonstrations each, always the same. Raises SceneError if too few can be shown."""
    demonstrations: list[list[Demonstration]] = []
    for number in range(TRIES):
        if len(demonstrations) == scenes:
            return demonstrations
        mode, style = MODES[len(demonstrations) % len(MODES)], STYLES[len(demonstrations) % len(STYLES)]
        drawn = draw_scene("home", FIRST_SEED + number)
        way = math.dist((drawn.start.x, drawn.start.y), (drawn.goal.x, drawn.goal.y))
        if not WAY_M[0] <= way <= WAY_M[1]:
            continue
        try:
            scene = with_mode(drawn, mode, number)
            demonstrations.append([demonstrate(style, scene, seed) for seed in range(per_scene)])
        except (SceneError, StrokeProblem):
            continue  # nobody can show anything there: the way is closed, or somebody walks into it
    if len(demonstrations) == scenes:
        return demonstrations
    raise SceneError("scenes", scenes, f"only {len(demonstrations)} of {TRIES} homes can be demonstrated in")


def flat(demonstrated: Sequence[Sequence[Demonstration]]) -> list[Demonstration]:
    """All of them, scene by scene."""
    return [demonstration for scene in demonstrated for demonstration in scene]
