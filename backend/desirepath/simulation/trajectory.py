"""A trajectory: what one rollout of one policy in one scene left behind, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.npz import MIB, Arrays, Bounds, from_npz, to_npz
from desirepath.simulation.scene import Scene
from desirepath.simulation.stored import Stored

Floats = NDArray[np.float32]
STORED = ("poses", "observations", "actions", "rewards", "next_observations", "dones")  # arrays, in the file's order
BOUNDS = Bounds(arrays=20, header_bytes=4 * MIB, all_bytes=64 * MIB)  # the longest of any setup have less than 1 MiB


class Outcome(IntEnum):
    """How an episode stands or ended."""

    RUNNING = 0
    SUCCESS = 1
    COLLISION = 2
    TIMEOUT = 3


@dataclass(frozen=True)
class Trajectory(Stored):
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

    noun = "trajectory"

    def to_bytes(self) -> bytes:
        meta: dict[str, Any] = {
            "scene": self.scene.as_dict(),
            "outcome": int(self.outcome),
            "self_intersections": self.self_intersections,
            "dt": self.dt,
        }
        return to_npz(meta, {name: getattr(self, name) for name in STORED})

    @classmethod
    def from_bytes(cls, data: bytes) -> Trajectory:
        try:
            meta, arrays = from_npz(data, BOUNDS)
            _check_shapes(arrays)
            return cls(
                scene=Scene.from_dict(meta["scene"]),
                outcome=Outcome(meta["outcome"]),
                self_intersections=meta["self_intersections"],
                dt=meta["dt"],
                **{name: arrays[name] for name in STORED},
            )
        except (KeyError, TypeError, ValueError) as problem:
            raise ValueError(f"not a desirepath trajectory (.npz): {problem}") from None


def _check_shapes(arrays: Arrays) -> None:
    """Raise ValueError unless there are arrays of as many steps as there are actions, as the class says."""
    steps, inputs = len(arrays["actions"]), arrays["observations"].shape[1:]
    needed = {
        "poses": (steps + 1, 3),
        "observations": (steps, *inputs),
        "actions": (steps, 2),
        "rewards": (steps,),
        "next_observations": (steps, *inputs),
        "dones": (steps,),
    }
    for name, shape in needed.items():
        if arrays[name].shape != shape:
            raise ValueError(f"array {name!r} has shape {arrays[name].shape}; with {steps} actions it must be {shape}")
