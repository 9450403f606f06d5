"""A trajectory: what one rollout of one policy in one scene left behind, as plain arrays."""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.simulation.scene import Scene

Floats = NDArray[np.float32]


class Outcome(IntEnum):
    """How an episode stands or ended."""

    RUNNING = 0
    SUCCESS = 1
    COLLISION = 2
    TIMEOUT = 3


@dataclass(frozen=True)
class Trajectory:
    """T control steps (5 Hz) in one scene.

    scene: where it ran. outcome: how it ended.
    poses: (T + 1, 3) float32: x, y (m), yaw (rad); row 0 is the start.
    observations, next_observations: (T, obs_dim) float32, scaled as the setup's layout says.
    actions: (T, 2) float32 in [-1, 1]. rewards: (T,) float32, the setup's core reward. dones: (T,) bool.
    self_intersections: how often the path crossed itself.
    """

    scene: Scene
    outcome: Outcome
    poses: Floats
    observations: Floats
    actions: Floats
    rewards: Floats
    next_observations: Floats
    dones: NDArray[np.bool_]
    self_intersections: int = 0
    dt: float = 0.2

    @property
    def times(self) -> Floats:
        """(T + 1,) float32 seconds since the start, one per pose."""
        return (np.arange(len(self.poses)) * self.dt).astype(np.float32)

    @property
    def duration_s(self) -> float:
        return float((len(self.poses) - 1) * self.dt)

    def to_bytes(self) -> bytes:
        """NPZ without pickled objects; the same trajectory always gives the same bytes."""
        meta: dict[str, Any] = {
            "scene": self.scene.as_dict(),
            "outcome": int(self.outcome),
            "self_intersections": self.self_intersections,
            "dt": self.dt,
        }
        out = io.BytesIO()
        np.savez_compressed(
            out,
            meta=np.frombuffer(json.dumps(meta, sort_keys=True).encode(), dtype=np.uint8),
            poses=self.poses,
            observations=self.observations,
            actions=self.actions,
            rewards=self.rewards,
            next_observations=self.next_observations,
            dones=self.dones,
        )
        return out.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Trajectory:
        """Read `to_bytes` back. Never unpickles."""
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            meta = json.loads(arrays["meta"].tobytes())
            return cls(
                scene=Scene.from_dict(meta["scene"]),
                outcome=Outcome(meta["outcome"]),
                self_intersections=meta["self_intersections"],
                dt=meta["dt"],
                **{
                    name: arrays[name]
                    for name in ("poses", "observations", "actions", "rewards", "next_observations", "dones")
                },
            )

    def digest(self) -> str:
        """sha256 of `to_bytes`, the trajectory's identity in the store."""
        return hashlib.sha256(self.to_bytes()).hexdigest()
