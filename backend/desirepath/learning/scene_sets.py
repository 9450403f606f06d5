"""Which scene seeds serve which purpose, so that nothing is reported on scenes it was chosen on.

Scene seed = purpose * 5 * 10^8 + seed * 10^4 + index. Training scenes come from the engine's own pool, whose seeds
lie above 2^32, beyond all of these.
"""

from __future__ import annotations

from enum import IntEnum

from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scenes

SCENES_PER_SEED = 10_000
SEEDS_PER_PURPOSE = 50_000


class Purpose(IntEnum):
    """The disjoint sets of scenes."""

    REPORT = 0  # `evaluate --seed`, tables and cards; never used to choose anything
    SELECT = 1  # checkpoint selection during base training and ensemble training
    ALIGN_SELECT = 2  # checkpoint selection during alignment
    GATE = 3  # may an aligned policy be shown to its participant?
    QUERIES = 4  # scenes that queries are made in
    BENCHMARK = 5  # when has a benchmarked learner reached 94 %?
    COMPARISON = 6  # where a participant sees the base policy and their own
    FIGURE = 7  # scenes that figures show: looking at them gives nothing away


def first_seed(purpose: Purpose, seed: int) -> int:
    """The scene seed of index 0."""
    return (int(purpose) * SEEDS_PER_PURPOSE + seed) * SCENES_PER_SEED


def scene_set(setup: str, n: int, *, purpose: Purpose, seed: int, first: int = 0) -> list[Scene]:
    """The n scenes of that purpose and seed, always the same, from number `first` on. Raises ValueError if they or the
    seed leave the set's range."""
    if not 0 < n <= SCENES_PER_SEED - first:
        raise ValueError(f"scenes = {n}: a set has between 1 and {SCENES_PER_SEED} scenes")
    if not 0 <= seed < SEEDS_PER_PURPOSE:
        raise ValueError(f"seed = {seed}: must be between 0 and {SEEDS_PER_PURPOSE - 1}")
    start = first_seed(purpose, seed) + first
    return draw_scenes(setup, range(start, start + n))


def describe(purpose: Purpose, n: int, seed: int) -> dict[str, int | str]:
    """The set in words for a card."""
    start = first_seed(purpose, seed)
    return {"purpose": purpose.name.lower(), "seed": seed, "first_scene_seed": start, "last_scene_seed": start + n - 1}
