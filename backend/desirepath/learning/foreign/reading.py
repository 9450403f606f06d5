"""Reads networks of others: plain ONNX to be run, tensors of a state dict. Called where little can be lost
(`limited.py`)."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.onnx_bounds import MOST_NUMBERS, ROWS, check_network

Floats = NDArray[np.float32]


def read_tensors(content: bytes, named: str) -> dict[str, Floats]:
    """A state dict's tensors by name. Only tensors are read: nothing pickled is run. Raises LearningError."""
    import torch

    try:
        state: Any = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        # A tensor can be far larger than its file: all of its rows may be one.
        if (numbers := sum(tensor.numel() for tensor in state.values())) > MOST_NUMBERS:
            raise ValueError(f"{numbers:,} numbers; at most {MOST_NUMBERS:,} are read")
        return {str(name): tensor.detach().numpy().astype(np.float32) for name, tensor in state.items()}
    except Exception as problem:  # torch raises what it likes for files of others
        why = (str(problem) or type(problem).__name__).splitlines()[0][:200]
        raise LearningError(f"{named}: not a state dict of tensors: {why}") from None


def open_onnx(content: bytes, width: int, named: str, outputs: int = 1) -> Callable[[Floats], Floats]:
    """The network as a function, (ROWS, width) -> (ROWS, outputs): its sizes were checked for that many rows.

    Raises LearningError for what is not run, and for a network whose rows depend on each other."""
    bounded = check_network(content, width, named, outputs)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # Folding constants is the one place where it would compute before anything is asked.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        session = onnxruntime.InferenceSession(bounded, options, providers=["CPUExecutionProvider"])
        (given,) = session.get_inputs()

        def run(values: Floats) -> Floats:
            return np.asarray(session.run(None, {given.name: values})[0], dtype=np.float32)

        tried = [run(values) for values in _same_among_others(width)]
    except Exception as problem:  # onnxruntime raises what it likes for files of others
        why = (str(problem) or type(problem).__name__).splitlines()[0][:200]
        raise LearningError(f"{named}: no ONNX network of {width} inputs per step: {why}") from None
    for found in tried:
        if found.size != ROWS * outputs:
            raise LearningError(
                f"{named}: needed is an output (n, {outputs}) for n steps; it gives {found.shape} for {ROWS}"
            )
    once, again = (found.reshape(ROWS, outputs)[::2] for found in tried)
    most = np.abs(once, where=np.isfinite(once), out=np.zeros_like(once)).max()
    if not np.allclose(once, again, rtol=1e-4, atol=1e-5 * most, equal_nan=True):
        raise LearningError(
            f"{named}: a step's output changes with the steps that are asked beside it; export a network whose "
            "operators (Softmax, means, BatchNormalization) leave the first dimension alone"
        )
    return lambda values: run(values).reshape(-1, outputs)


def _same_among_others(width: int) -> tuple[Floats, Floats]:
    """Twice the same steps at the even places, among others: nothing, as where rows are filled up, and much."""
    draws = np.random.default_rng(0)
    first = draws.uniform(-1, 1, (ROWS, width)).astype(np.float32)
    second = first.copy()
    first[1::2], second[1::2] = 0, 10 * second[1::2]
    return first, second
