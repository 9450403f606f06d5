"""Reads the networks of reward files: linear layers of a state dict, plain ONNX. Called where little can be lost
(`learning/foreign/limited.py`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.limited import Opened
from desirepath.learning.foreign.reading import open_onnx, read_tensors
from desirepath.learning.people.reward_manifest import RewardManifest

Floats = NDArray[np.float32]
MOST_LAYERS = 20
LEAK = 0.01
HIDDEN: dict[str, Callable[[Floats], Floats]] = {
    "relu": lambda x: np.maximum(x, 0),
    "leaky_relu": lambda x: np.where(x > 0, x, LEAK * x),
    "tanh": np.tanh,
}


def open_reward(description: bytes, content: bytes) -> Opened:
    """The network of a manifest (JSON): (n, inputs) -> (n, 1). Raises LearningError for what is not read."""
    manifest = RewardManifest.model_validate_json(description)
    if manifest.file.endswith(".onnx"):
        return Opened(width=manifest.width, run=open_onnx(content, manifest.width, manifest.file))
    return Opened(width=manifest.width, run=_layers(content, manifest))


def _layers(content: bytes, manifest: RewardManifest) -> Callable[[Floats], Floats]:
    """Linear layers of a state dict, in its order."""
    path, named = manifest.file, read_tensors(content, manifest.file)
    weights = [(name, array) for name, array in named.items() if name.endswith("weight")]
    if not 1 <= len(weights) <= MOST_LAYERS:
        raise LearningError(f"{path}: {len(weights)} linear layers; between 1 and {MOST_LAYERS} are read")
    layers, before = [], manifest.width
    for name, array in weights:
        bias = named.get(name.removesuffix("weight") + "bias", np.zeros(array.shape[:1], dtype=np.float32))
        if array.ndim != 2 or array.shape[1] != before or bias.shape != array.shape[:1]:
            raise LearningError(
                f"{path}: {name} has shape {array.shape}, its bias {bias.shape}; needed is (outputs, {before})"
            )
        layers.append((array.T, bias))
        before = array.shape[0]
    if before != 1:
        raise LearningError(f"{path}: the last layer has {before} outputs; a reward has one")

    def reward(values: Floats) -> Floats:
        for weight, bias in layers[:-1]:
            values = HIDDEN[manifest.hidden](values @ weight + bias)
        last: Floats = values @ layers[-1][0] + layers[-1][1]
        return np.tanh(last) if manifest.output == "tanh" else last

    return reward
