"""A fitted reward network as a person: a small manifest and a state dict or an ONNX file. Both together are one file of
the store. What a manifest may say is `reward_manifest.py`'s and `reward_inputs.py`'s, which networks are run
`learning/foreign`'s; they are read and run in a process of their own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.limited import LimitedNetwork
from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.families.base import Doubles, FamilyMember
from desirepath.learning.people.reward_manifest import (
    FILE_BYTES,
    MANIFEST_BYTES,
    RewardManifest,
    read_manifest,
    unpack,
)
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RewardFileMember(FamilyMember):
    """Somebody who prefers what a network says. reward: (n, inputs) -> (n, 1), a `LimitedNetwork`."""

    manifest: RewardManifest
    reward: LimitedNetwork

    def scores(self, trajectories: list[Trajectory] | tuple[Trajectory, ...]) -> Doubles:  # type: ignore[override]
        steps = SeenSteps.of_trajectories(trajectories)
        means = steps.means(self.rewards(steps))
        return means if self.manifest.reduction == "mean" else means * np.bincount(steps.of)

    def rewards(self, steps: SeenSteps) -> Doubles:
        """(steps,) what the network says of each. Raises LearningError where that is not a number."""
        values = self.reward(self.given(steps))[:, 0]
        if not np.isfinite(values).all():
            raise LearningError(f"{self.manifest.file}: the reward of a step is not a number")
        return values.astype(np.float64)

    def close(self) -> None:
        """End the network's process."""
        self.reward.close()

    def given(self, steps: SeenSteps) -> Floats:
        """(steps, inputs) what the network is given, converted as its manifest says."""
        columns = {
            "observation": steps.observations,
            "action": steps.actions,
            "next_observation": steps.next_observations,
        }
        ours = np.concatenate([columns[part.of] for part in self.manifest.inputs], axis=1, dtype=np.float32)
        return self.manifest.conversion(ours)


@dataclass(frozen=True)
class RewardModelMember(FamilyMember):
    """Somebody who prefers what a reward model of ours says."""

    model: RewardModel

    def scores(self, trajectories: list[Trajectory] | tuple[Trajectory, ...]) -> Doubles:  # type: ignore[override]
        return np.array([self.model.trajectory_reward(one) for one in trajectories], dtype=np.float64)


def read_reward(path: Path, setup: str) -> FamilyMember:
    """The person of a manifest (.json) or of a reward model of ours (.npz). Raises LearningError that names the field,
    the value and what would work."""
    if path.suffix == ".npz":
        return reward_of_store(_bounded(path, FILE_BYTES), setup)
    if path.suffix != ".json":
        raise LearningError(f"--reward {path}: give the manifest (.json) or a reward model of the store (.npz)")
    manifest = read_manifest(_bounded(path, MANIFEST_BYTES), str(path))
    _require_setup(path, manifest.setup, setup)
    weights = path.parent / manifest.file
    return _member(manifest, _bounded(weights, FILE_BYTES), weights)


def reward_of_store(content: bytes, setup: str) -> FamilyMember:
    """The person of a reward model of the store, fitted here or uploaded. Raises LearningError as `read_reward`."""
    together = unpack(content)
    if together is None:
        model = RewardModel.from_bytes(content)
        _require_setup(Path("reward model"), model.setup, setup)
        return RewardModelMember(model)
    manifest, network = together
    _require_setup(Path(manifest.file), manifest.setup, setup)
    return _member(manifest, network, Path(manifest.file))


def _member(manifest: RewardManifest, content: bytes, named: Path) -> RewardFileMember:
    return RewardFileMember(
        manifest, LimitedNetwork("reward", manifest.model_dump_json().encode(), content, str(named))
    )


def _require_setup(path: Path, found: str, setup: str) -> None:
    if found != setup:
        raise LearningError(f"{path}: setup = {found!r}; --setup asks for {setup!r}")


def _bounded(path: Path, most: int) -> bytes:
    try:
        if (size := path.stat().st_size) > most:
            raise LearningError(f"{path}: {size:,} bytes; at most {most:,} are read")
        return path.read_bytes()
    except OSError as problem:
        raise LearningError(f"cannot read {path}: {problem.strerror}") from None
