"""A policy with attention as a file: what is shipped, stored and looked at. Its networks are `crowd_networks.py`'s.

Read without torch, which comes with whoever rolls it out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.simulation.npz import from_npz, to_npz
from desirepath.simulation.scene import Scene

if TYPE_CHECKING:
    from desirepath.learning.pedestrians.crowd_evaluation import CrowdRollout
    from desirepath.learning.pedestrians.crowd_networks import Actor

FORMAT = "desirepath-attention-2"  # 1 was given both centroids, not the gap
VARIANT = "ours"


@dataclass(frozen=True)
class AttentionPolicy:
    """An actor with attention of `VARIANT`. setup: one of those that it was trained in, whose robot is the same in all.
    arrays: its numbers by name, as in `crowd_training.actor_to_arrays`."""

    setup: str
    arrays: dict[str, NDArray[Any]] = field(repr=False)

    def actor(self) -> Actor:
        """The network."""
        from desirepath.learning.pedestrians.crowd_training import actor_from_arrays  # torch comes with it

        return actor_from_arrays(VARIANT, {name: value.astype(np.float32) for name, value in self.arrays.items()})

    def rolled_out(self, scene: Scene) -> CrowdRollout:
        """One episode in a scene with pedestrians."""
        from desirepath.learning.pedestrians.crowd_evaluation import roll_out_crowd
        from desirepath.learning.pedestrians.crowd_networks import VARIANTS, actor_acts

        return roll_out_crowd(actor_acts(self.actor()), VARIANTS[VARIANT].given, scene)

    def to_bytes(self) -> bytes:
        """NPZ without pickled objects, numbers in half precision; the same policy always gives the same bytes."""
        return to_npz({"format": FORMAT, "setup": self.setup, "variant": VARIANT}, dict(self.arrays))

    @classmethod
    def from_bytes(cls, data: bytes) -> AttentionPolicy:
        """Read `to_bytes` back, never unpickling. Raises LearningError on anything else."""
        try:
            meta, arrays = from_npz(data)
            if meta.get("format") != FORMAT or meta.get("variant") != VARIANT:
                raise ValueError(f"format {meta.get('format')!r} is unknown; this version reads {FORMAT!r}")
            return cls(str(meta["setup"]), arrays)
        except (KeyError, TypeError, ValueError) as problem:
            raise LearningError(f"not a desirepath attention policy (.npz): {problem}") from None

    @classmethod
    def load(cls, path: Path) -> AttentionPolicy:
        """Raises LearningError if the file is missing or something else."""
        try:
            return cls.from_bytes(path.read_bytes())
        except OSError as problem:
            raise LearningError(f"cannot read attention policy {path}: {problem.strerror}") from None
