"""Rooms for the scenarios of chapter 8, in which people say what mattered to the robot: five objects each.

Which rooms may be asked about, by rules that know no policy; of these `ranking_sets.py` takes the first ones in which
the robot halts in sight. How a room is drawn is `kernels.draw_explained_room`'s.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from desirepath.explain.sight import Sight, sight_of
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setups import get_setup

EXPLAINED_ROOM = get_setup("explained_room")

SCENARIOS, PRACTICE = 48, 2
OBJECTS = 5
LEAST_SEEN = 4  # ours: of the five, from the start; who cannot be seen has no score, and ties have no order
FIRST_SEED, FIRST_PRACTICE_SEED = 2_000_000_000, 2_000_010_000
"""Where `scene_sets.Purpose.QUERIES` begins: nothing is trained, chosen or reported on these."""


def rooms(seed: int = FIRST_SEED) -> Iterator[Scene]:
    """Seed after seed, always the same: rooms in which four of five objects are seen from the start."""
    for number in range(seed, seed + FIRST_PRACTICE_SEED - FIRST_SEED):
        scene = draw_scene(EXPLAINED_ROOM, number)
        if _at_start(scene).seen[0, :OBJECTS].sum() >= LEAST_SEEN:
            yield scene


def practice_rooms() -> Iterator[Scene]:
    """Rooms to practise in, none of the others."""
    return rooms(FIRST_PRACTICE_SEED)


def _at_start(scene: Scene) -> Sight:
    """What is seen before the first step."""
    standing = np.array([[-1.0, 0.0]], dtype=np.float32)
    return sight_of(
        rollout(EXPLAINED_ROOM, lambda seen: np.repeat(standing, len(seen), axis=0), [scene], max_steps=1)[0]
    )
