"""A policy's network as NumPy or onnxruntime computes it: observations in, actions in [-1, 1] out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Act = Callable[[Floats], Floats]
"""(n, obs) observations -> (n, 2) actions."""
ACTIONS = 2
MOST_LAYERS = 24
MOST_ROWS = 4_096
FEWEST_ROWS = 4
"""Fewer states are asked about several times at once: libraries multiply one row by another rule, whose sums are
rounded otherwise (by 2e-5 of an action). From four on they are the same, so that one robot acts as one of many."""


LOOPS, ELSEWHERE = b"\x22\x04Loop", b"\x0a\x08location"
"""As ONNX files write an operator that may never end, and weights in another file: the runtime would do both."""


class NetworkError(ValueError):
    """A network that is none, or another one than its manifest says."""


@dataclass(frozen=True, eq=False)
class Layers:
    """Linear layers and ReLU, at last tanh. arrays: weight, bias, weight, bias, ... float32, weights (inputs, outputs).

    With extractors, two layers read the first `task_inputs` of the observation and two the rest, before the others;
    else all of them read the whole.
    """

    arrays: tuple[Floats, ...]
    task_inputs: int
    extractors: bool

    def __call__(self, observations: Floats) -> Floats:
        if 0 < len(observations) < FEWEST_ROWS:
            return self(np.repeat(observations, FEWEST_ROWS, axis=0))[::FEWEST_ROWS]
        arrays, first, seen = self.arrays, 0, observations
        if self.extractors:
            task = _relu_layers(arrays[0:4], observations[:, : self.task_inputs])
            lidar = _relu_layers(arrays[4:8], observations[:, self.task_inputs :])
            first, seen = 8, np.concatenate([task, lidar], axis=1)
        hidden = _relu_layers(arrays[first:-2], seen)
        actions: Floats = np.tanh(hidden @ arrays[-2] + arrays[-1])
        return actions

    def check(self, inputs: int, what: str) -> None:
        """Raise NetworkError unless they read so many inputs, follow from each other, and are numbers."""
        arrays, branches = self.arrays, 8 if self.extractors else 0
        if len(arrays) % 2 or not branches + 2 <= len(arrays) <= 2 * MOST_LAYERS:
            raise NetworkError(
                f"{what} has {len(arrays)} arrays: must be weight and bias of up to {MOST_LAYERS} layers"
            )
        if any(one.dtype != np.float32 or one.ndim != 2 - k % 2 for k, one in enumerate(arrays)):
            raise NetworkError(f"{what}: must be matrices and vectors of float32 by turns")
        width = inputs
        if self.extractors:
            task, lidar = (self._chain(arrays[k : k + 4], read, what) for k, read in self._branches(inputs))
            width = task + lidar
        if (found := self._chain(arrays[branches:], width, what)) != ACTIONS:
            raise NetworkError(f"{what} gives {found} numbers: must be {ACTIONS}, forward speed and turn rate")

    def _branches(self, inputs: int) -> tuple[tuple[int, int], tuple[int, int]]:
        return (0, self.task_inputs), (4, inputs - self.task_inputs)

    @staticmethod
    def _chain(arrays: Sequence[Floats], width: int, what: str) -> int:
        for weight, bias in zip(arrays[0::2], arrays[1::2], strict=True):
            if weight.shape[0] != width or bias.shape != weight.shape[1:]:
                raise NetworkError(
                    f"{what}: a layer of shape {weight.shape} with {bias.shape} biases where {width} inputs come in"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise NetworkError(f"{what} holds NaN or infinite weights")
            width = weight.shape[1]
        return width


def _relu_layers(arrays: Sequence[Floats], x: Floats) -> Floats:
    for k in range(0, len(arrays), 2):
        x = x @ arrays[k]
        x += arrays[k + 1]
        np.maximum(x, 0, out=x)
    return x


def folded(arrays: tuple[Floats, ...], first_row: int, weights: Floats) -> tuple[Floats, ...]:
    """The layers as they are where the inputs from `first_row` on are always these weights (k,): exact, since a
    constant input only moves the first layer's bias."""
    first, bias = arrays[:2]
    end = first_row + len(weights)
    kept = np.concatenate([first[:first_row], first[end:]])
    return (kept, bias + weights @ first[first_row:end], *arrays[2:])


def onnx_network(content: bytes, inputs: int) -> Act:
    """A network of any kind by onnxruntime, on one thread. Raises NetworkError where it is none, or another one."""
    try:
        import onnxruntime
    except ImportError:
        raise NetworkError("the policy's network is ONNX: `pip install onnxruntime` is needed") from None
    if LOOPS in content or ELSEWHERE in content:
        raise NetworkError("the policy's network has loops, or weights in other files: export a plain one, all inside")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as problem:  # onnxruntime's errors have no class of their own above them
        raise NetworkError(f"the policy's network cannot be read as ONNX: {str(problem)[:300]}") from None
    taken, given = session.get_inputs(), session.get_outputs()
    shapes = [list(one.shape) for one in taken]
    if len(taken) != 1 or len(given) != 1 or shapes[0][1:] not in ([inputs], []):
        raise NetworkError(f"the policy's network reads {shapes}: must be one input (n, {inputs})")
    name, fixed = taken[0].name, shapes[0][0] if shapes[0] and isinstance(shapes[0][0], int) else 1
    if not 1 <= fixed <= MOST_ROWS:
        raise NetworkError(f"the policy's network reads {fixed} states at once; at most {MOST_ROWS:,}")

    def act(observations: Floats) -> Floats:
        actions = np.asarray(session.run(None, {name: np.repeat(observations, fixed, axis=0)})[0], dtype=np.float32)
        if actions.shape != (len(observations) * fixed, ACTIONS):
            raise NetworkError(f"the policy's network gave actions of shape {actions.shape}")
        clipped: Floats = np.clip(actions[::fixed], -1, 1)
        return clipped

    try:
        act(np.zeros((1, inputs), dtype=np.float32))
    except NetworkError:
        raise
    except Exception as problem:
        raise NetworkError(f"the policy's network cannot be run: {str(problem)[:300]}") from None
    return act
