"""Reward models as files: NPZ without pickled objects, whatever their kind."""

from __future__ import annotations

from pathlib import Path

from desirepath.learning.errors import LearningError
from desirepath.learning.rewards.kinds import MODELS
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.simulation.npz import NpzError, from_npz, to_npz

FORMAT = "desirepath-reward-model-1"


def reward_model_to_bytes(model: RewardModel) -> bytes:
    """NPZ without pickled objects; same model, same bytes."""
    meta, arrays = model.to_arrays()
    return to_npz({"format": FORMAT, **meta}, arrays)


def reward_model_from_bytes(data: bytes) -> RewardModel:
    """Read `reward_model_to_bytes` back, never unpickling. Raises LearningError on anything else."""
    try:
        meta, arrays = from_npz(data)
    except NpzError as problem:
        raise LearningError(f"not a desirepath reward model (.npz): {problem}") from None
    if meta.get("format") != FORMAT or meta.get("kind") not in MODELS:
        raise LearningError(f"reward model format {meta.get('format')!r}, kind {meta.get('kind')!r} is unknown")
    return MODELS[meta["kind"]].from_arrays(meta, arrays)


def save_reward_model(model: RewardModel, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(reward_model_to_bytes(model))


def load_reward_model(path: Path) -> RewardModel:
    """Raises LearningError if the file is missing or no reward model."""
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise LearningError(f"cannot read reward model {path}: {problem.strerror}") from None
    return reward_model_from_bytes(data)
