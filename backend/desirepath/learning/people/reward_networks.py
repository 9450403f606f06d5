"""Reads the networks of reward files: linear layers of a state dict, plain ONNX. `limited_reward.py` calls it, where
little can be lost."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.people.onnx_bounds import ROWS, check_network
from desirepath.learning.people.reward_manifest import RewardManifest

Floats = NDArray[np.float32]
MOST_NUMBERS = 4_000_000
MOST_LAYERS = 20
LEAK = 0.01
HIDDEN: dict[str, Callable[[Floats], Floats]] = {
    "relu": lambda x: np.maximum(x, 0),
    "leaky_relu": lambda x: np.where(x > 0, x, LEAK * x),
    "tanh": np.tanh,
}


def reader_of(manifest: RewardManifest) -> Callable[[bytes, RewardManifest], Callable[[Floats], Floats]]:
    """What reads the manifest's network; call it where little can be lost."""
    return _onnx if manifest.file.endswith(".onnx") else _layers


def _layers(content: bytes, manifest: RewardManifest) -> Callable[[Floats], Floats]:
    """Linear layers of a state dict, in its order. Only tensors are read: nothing pickled is run."""
    import torch

    path = manifest.file

    try:
        state: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        # A tensor can be far larger than its file: all of its rows may be one.
        if (numbers := sum(tensor.numel() for tensor in state.values())) > MOST_NUMBERS:
            raise ValueError(f"{numbers:,} numbers; at most {MOST_NUMBERS:,} are read")
        named = {str(name): tensor.detach().numpy().astype(np.float32) for name, tensor in state.items()}
    except Exception as problem:  # torch raises what it likes for files of others
        raise LearningError(f"{path}: not a state dict of tensors: {str(problem).splitlines()[0]}") from None
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
        last: Floats = (values @ layers[-1][0] + layers[-1][1])[:, 0]
        return np.tanh(last) if manifest.output == "tanh" else last

    return reward


def _onnx(content: bytes, manifest: RewardManifest) -> Callable[[Floats], Floats]:
    """Asked ROWS steps at a time: its sizes were checked for that many."""
    bounded = check_network(content, manifest.width, manifest.file)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # Folding constants is the one place where it would compute before anything is asked.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        session = onnxruntime.InferenceSession(bounded, options, providers=["CPUExecutionProvider"])
        (network_input,) = session.get_inputs()
        tried = [
            np.asarray(session.run(None, {network_input.name: values})[0], dtype=np.float32)
            for values in _same_among_others(manifest.width)
        ]
    except Exception as problem:  # onnxruntime raises what it likes for files of others
        why = (str(problem) or type(problem).__name__).splitlines()[0][:200]
        raise LearningError(f"{manifest.file}: no ONNX network of {manifest.width} inputs per step: {why}") from None
    for rewards in tried:
        if rewards.size != ROWS:
            raise LearningError(
                f"{manifest.file}: needed is one reward per step; it gives {rewards.shape} for {ROWS} steps"
            )
    once, again = (rewards.reshape(-1)[::2] for rewards in tried)
    most = np.abs(once, where=np.isfinite(once), out=np.zeros_like(once)).max()
    if not np.allclose(once, again, rtol=1e-4, atol=1e-5 * most, equal_nan=True):
        raise LearningError(
            f"{manifest.file}: a step's reward changes with the steps that are asked beside it; export a network whose "
            "operators (Softmax, means, BatchNormalization) leave the first dimension alone"
        )

    def reward(values: Floats) -> Floats:
        return np.asarray(session.run(None, {network_input.name: values})[0], dtype=np.float32).reshape(-1)

    return reward


def _same_among_others(width: int) -> tuple[Floats, Floats]:
    """Twice the same steps at the even places, among others: nothing, as where rows are filled up, and much."""
    draws = np.random.default_rng(0)
    first = draws.uniform(-1, 1, (ROWS, width)).astype(np.float32)
    second = first.copy()
    first[1::2], second[1::2] = 0, 10 * second[1::2]
    return first, second
