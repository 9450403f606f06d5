"""A trajectory: what one rollout of one policy in one scene left behind, as plain arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.npz import MIB, Arrays, Bounds, from_npz, to_npz
from desirepath.simulation.recorded import NotRecordedError, Recorded
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
    recorded: of a trajectory that no engine made, where it is from. Its observations and actions may be (T, 0), its
    rewards NaN: they were not recorded.
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
    recorded: Recorded | None = None

    @property
    def times(self) -> Floats:
        """(T + 1,) float32 seconds since the start, one per pose."""
        return (np.arange(len(self.poses)) * self.dt).astype(np.float32)

    @property
    def duration_s(self) -> float:
        """How long it takes to watch: a video plays to its own end."""
        if self.recorded is not None and self.recorded.video is not None:
            return self.recorded.video.duration_s
        return float((len(self.poses) - 1) * self.dt)

    @property
    def recorded_steps(self) -> bool:
        """Whether observations and actions are known, as they are of every rollout."""
        return bool(self.observations.shape[1] and self.actions.shape[1])

    noun = "trajectory"

    def to_bytes(self) -> bytes:
        meta: dict[str, Any] = {
            "scene": self.scene.as_dict(),
            "outcome": int(self.outcome),
            "self_intersections": self.self_intersections,
            "dt": self.dt,
        }
        if self.recorded is not None:
            meta["recorded"] = self.recorded.as_dict()
        return to_npz(meta, {name: getattr(self, name) for name in STORED})

    @classmethod
    def from_bytes(cls, data: bytes) -> Trajectory:
        try:
            meta, arrays = from_npz(data, BOUNDS)
            recorded = Recorded.from_dict(meta["recorded"]) if "recorded" in meta else None
            _check_shapes(arrays, action_size=0 if recorded is not None and "actions" in recorded.absent else 2)
            return cls(
                scene=Scene.from_dict(meta["scene"]),
                outcome=Outcome(meta["outcome"]),
                self_intersections=meta["self_intersections"],
                dt=meta["dt"],
                recorded=recorded,
                **{name: arrays[name] for name in STORED},
            )
        except (KeyError, TypeError, ValueError) as problem:
            raise ValueError(f"not a desirepath trajectory (.npz): {problem}") from None


def arrived(trajectories: Sequence[Trajectory]) -> NDArray[np.bool_]:
    """(n,) which of them reached the goal."""
    return np.array([trajectory.outcome == Outcome.SUCCESS for trajectory in trajectories])


def require_steps(trajectories: Iterable[Trajectory]) -> None:
    """Raise NotRecordedError unless observations and actions are known of all: who learns from steps needs them."""
    for one in trajectories:
        known = {"observations": one.observations.shape[1], "actions": one.actions.shape[1]}
        missing = [part for part, size in known.items() if not size]
        if missing and one.recorded is not None:
            raise NotRecordedError(
                f"trajectory {one.recorded.run!r} of {one.recorded.file}: {' and '.join(missing)} were not recorded, "
                "and what learns from or judges single steps needs them; measures of poses work without"
            )


def require_poses(trajectories: Iterable[Trajectory]) -> None:
    """Raise NotRecordedError unless it is known of all where the robot was: measures, and all that is learned, need
    it."""
    for one in trajectories:
        if one.recorded is not None and "poses" not in one.recorded.has:
            raise NotRecordedError(
                f"trajectory {one.recorded.run!r} of {one.recorded.file}: only a video was recorded; what is learned "
                "or measured needs the robot's poses; columns poses_a and poses_b in pairs.csv bring them"
            )


def require_people(trajectories: Iterable[Trajectory]) -> None:
    """Raise NotRecordedError unless there is a person in the scenes of all."""
    for one in trajectories:
        if not one.scene.has_person:
            what = f"trajectory {one.recorded.run!r} of {one.recorded.file}" if one.recorded else "a trajectory"
            raise NotRecordedError(f"{what}: people were not recorded, and what people prefer is measured beside one")


def _check_shapes(arrays: Arrays, action_size: int) -> None:
    """Raise ValueError unless there are arrays of as many steps as there are actions, as the class says."""
    steps, inputs = len(arrays["actions"]), arrays["observations"].shape[1:]
    needed = {
        "poses": (steps + 1, 3),
        "observations": (steps, *inputs),
        "actions": (steps, action_size),
        "rewards": (steps,),
        "next_observations": (steps, *inputs),
        "dones": (steps,),
    }
    for name, shape in needed.items():
        if arrays[name].shape != shape:
            raise ValueError(f"array {name!r} has shape {arrays[name].shape}; with {steps} actions it must be {shape}")
