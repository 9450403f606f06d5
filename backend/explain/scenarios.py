"""The scenarios of chapter 8, in which people say what mattered to the robot: 48 rooms of five objects, and practice.

Which rooms these are, by rules that know no policy. How a room is drawn is `kernels.draw_explained_room`'s; what a
policy looked at in it, `attribution.py`'s.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from backend.explain.sight import Sight, sight_of, thing_names
from backend.simulation.fast import rollout
from backend.simulation.scene import Scene
from backend.simulation.scenes import draw_scene
from backend.simulation.setups import EXPLAINED_ROOM

SCENARIOS, PRACTICE = 48, 2
OBJECTS = 5
LEAST_SEEN = 4  # ours: of the five, from the start; who cannot be seen has no score, and ties have no order
FIRST_SEED, FIRST_PRACTICE_SEED = 2_000_000_000, 2_000_010_000
"""Where `scene_sets.Purpose.QUERIES` begins: nothing is trained, chosen or reported on these."""


def object_names(scene: Scene) -> tuple[str, ...]:
    """The things that can be ranked, in the order of `scene.obstacles`; as `Explanation.things` calls them."""
    return tuple(thing_names(scene)[: len(scene.obstacles)])


def scenarios() -> tuple[Scene, ...]:
    """The 48 scenarios, always the same: seed after seed, where four of five objects are seen from the start."""
    return _first(FIRST_SEED, SCENARIOS)


def practice_scenarios() -> tuple[Scene, ...]:
    """The two that people practise in, none of the 48."""
    return _first(FIRST_PRACTICE_SEED, PRACTICE)


@cache
def _first(seed: int, count: int) -> tuple[Scene, ...]:
    kept: list[Scene] = []
    while len(kept) < count:
        scene = draw_scene(EXPLAINED_ROOM, seed)
        seed += 1
        if _at_start(scene).seen[0, :OBJECTS].sum() >= LEAST_SEEN:
            kept.append(scene)
    return tuple(kept)


def _at_start(scene: Scene) -> Sight:
    """What is seen before the first step."""
    standing = np.array([[-1.0, 0.0]], dtype=np.float32)
    return sight_of(
        rollout(EXPLAINED_ROOM, lambda seen: np.repeat(standing, len(seen), axis=0), [scene], max_steps=1)[0]
    )
