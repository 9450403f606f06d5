"""A policy with attention as a file: what is shipped, stored and looked at. Its networks are `crowd_networks.py`'s.

Read without torch, which comes with whoever rolls it out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.npz import Arrays
from desirepath.simulation.acting import ActionError, EpisodeActs, Rows, SensingPolicy
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from desirepath.learning.pedestrians.crowd_evaluation import CrowdRollout
    from desirepath.learning.pedestrians.crowd_networks import Actor

VARIANT = "ours"
AT_ONCE = 500  # states through the network, whose features are a hundred times as many


@dataclass(frozen=True)
class AttentionPolicy(StoredArrays, DrivingPolicy):
    """An actor with attention of `VARIANT`. setup: one of those that it was trained in, whose robot is the same in all.
    arrays: its numbers by name, as in `crowd_networks.actor_to_arrays`."""

    setup: str
    arrays: dict[str, NDArray[Any]] = field(repr=False)

    noun, raises = "attention policy", LearningError
    reads = "what its lidar and its descriptors see of people"
    file_format = "desirepath-attention-2"  # 1 was given both centroids, not the gap

    def actor(self) -> Actor:
        """The network."""
        from desirepath.learning.pedestrians.crowd_networks import actor_from_arrays  # torch comes with it

        return actor_from_arrays(VARIANT, {name: value.astype(np.float32) for name, value in self.arrays.items()})

    @property
    def rollout_policy(self) -> SensingPolicy:
        """Senses what chapter 4's networks read, in the engine of crowds."""
        return _Attending(self)

    def manifest(self) -> dict[str, object]:
        from desirepath.learning.pedestrians.crowd_networks import VARIANTS
        from desirepath.learning.pedestrians.crowd_states import SIZES

        given, limits = VARIANTS[VARIANT].given, get_setup(self.setup).robot.limits
        return {
            "setup": self.setup,
            "state": {"dtype": "float32", "shape": [SIZES[given]], "given": given, "source": "crowd_states.py"},
            "action": {
                "range": [-1.0, 1.0],
                "linear_velocity_m_s": [limits.v_min, limits.v_max],
                "angular_velocity_rad_s": [-limits.w_max, limits.w_max],
            },
            "control_rate_hz": 5,
            "policy_sha256": self.digest(),
        }

    def rolled_out(self, scene: Scene) -> CrowdRollout:
        """One episode in a scene with pedestrians."""
        from desirepath.learning.pedestrians.crowd_evaluation import roll_out_crowd
        from desirepath.learning.pedestrians.crowd_networks import VARIANTS, actor_acts

        return roll_out_crowd(actor_acts(self.actor()), VARIANTS[VARIANT].given, scene)

    def attended(self, scene: Scene) -> tuple[Trajectory, NDArray[np.float64]]:
        from desirepath.learning.pedestrians.attended import as_trajectory, attention_to_people, measure_attention

        rolled_out = self.rolled_out(scene)
        looked = (np.array(rows[:-1]) for rows in measure_attention(self.actor(), rolled_out))
        return as_trajectory(rolled_out), attention_to_people(rolled_out, *looked)

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        """Numbers in half precision."""
        return {"setup": self.setup, "variant": VARIANT}, dict(self.arrays)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> AttentionPolicy:
        if header["variant"] != VARIANT:
            raise ValueError(f"variant {header['variant']!r}; what is read here is {VARIANT!r}")
        return cls(str(header["setup"]), arrays)


class _Attending(SensingPolicy):
    def __init__(self, policy: AttentionPolicy) -> None:
        self._policy = policy

    def begin_in(self, engine: Any) -> EpisodeActs:
        from desirepath.learning.pedestrians.crowd_networks import VARIANTS, actor_acts
        from desirepath.learning.pedestrians.crowd_states import states

        crowd = getattr(engine, "crowd", None)
        if crowd is None:
            raise ActionError(f"setup {engine.setup.name} has no pedestrians, whom an attention policy goes by")
        acts, given = actor_acts(self._policy.actor()), VARIANTS[VARIANT].given

        def act(_: NDArray[np.float32], rows: Rows) -> NDArray[np.float32]:
            seen = states(crowd, given)[rows]
            some = [acts(seen[first : first + AT_ONCE]) for first in range(0, len(seen), AT_ONCE)]
            return np.concatenate(some)

        return act


STORED = AttentionPolicy
