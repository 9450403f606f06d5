"""Forward and backward passes of actor and critic, written out in NumPy, and Adam on flat parameters.

On networks this small automatic differentiation costs more than the arithmetic (`desirepath benchmark train` measures
it). Which losses are differentiated is written in `td3.py`; the same networks in torch are in `networks.py`, and
`tests/learning/test_backprop.py` holds the gradients equal to torch's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled

Floats = NDArray[np.float32]
Weights = Sequence[tuple[Floats, Floats]]
"""(weight (inputs, outputs), bias (outputs,)) per layer, in the order of `NetworkShape`; gradients likewise."""


class Features(NamedTuple):
    """What a backward pass needs of the two extractors: inputs and activations; `joined` holds both outputs. Without
    extractors `joined` is what is observed, and the others are empty.
    """

    task: Floats
    task_hidden: Floats
    lidar: Floats
    lidar_hidden: Floats
    joined: Floats  # (n, 2 * extractor width [+ 2 actions])


_NONE = np.empty((0, 0), dtype=np.float32)


class Head(NamedTuple):
    """Activations of a head: its hidden layers and its linear output (n, outputs)."""

    hidden: tuple[Floats, ...]
    output: Floats


@compiled
def add_bias_relu(x: Floats, bias: Floats) -> None:
    """x[:, :len(bias)] = max(0, x + bias), in place."""
    for i in range(x.shape[0]):
        for j in range(bias.shape[0]):
            x[i, j] = max(x[i, j] + bias[j], np.float32(0))


@compiled
def relu_backward(gradient: Floats, activation: Floats, bias_gradient: Floats) -> None:
    """Set the gradient to zero where the unit was silent, and sum it over the batch into its bias's, both in place."""
    bias_gradient[:] = 0
    for i in range(gradient.shape[0]):
        for j in range(gradient.shape[1]):
            passed = gradient[i, j] if activation[i, j] > 0 else np.float32(0)
            gradient[i, j] = passed
            bias_gradient[j] += passed


@compiled
def adam_step(
    flat: Floats,
    gradient: Floats,
    first: Floats,
    second: Floats,
    step_size: np.float32,
    root_correction: np.float32,
) -> None:
    """flat -= step_size * m / (sqrt(v) / root_correction + 1e-8), with torch's default betas 0.9 and 0.999."""
    for k in range(flat.shape[0]):
        g = gradient[k]
        first[k] += np.float32(0.1) * (g - first[k])
        second[k] = np.float32(0.999) * second[k] + np.float32(0.001) * g * g
        flat[k] -= step_size * first[k] / (np.sqrt(second[k]) / root_correction + np.float32(1e-8))


@compiled
def move_towards(flat: Floats, goal: Floats, share: np.float32) -> None:
    """flat += share * (goal - flat), in place."""
    for k in range(flat.shape[0]):
        flat[k] += share * (goal[k] - flat[k])


class Adam:
    """Adam (Kingma & Ba 2015) on one flat vector, equal to torch.optim.Adam with its defaults."""

    def __init__(self, size: int, learning_rate: float) -> None:
        self.learning_rate = learning_rate
        self.steps = 0
        self._first, self._second = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32)

    def step(self, flat: Floats, gradient: Floats) -> None:
        """One step of `flat` (size,) down its gradient (size,), in place."""
        self.steps += 1
        adam_step(
            flat,
            gradient,
            self._first,
            self._second,
            np.float32(self.learning_rate / (1 - 0.9**self.steps)),
            np.float32(math.sqrt(1 - 0.999**self.steps)),
        )

    def remember(self) -> tuple[int, Floats, Floats]:
        """The state of learning, without the learning rate, to `go_back` to."""
        return self.steps, self._first.copy(), self._second.copy()

    def go_back(self, state: tuple[int, Floats, Floats]) -> None:
        """Be as at `remember`."""
        self.steps = state[0]
        self._first[:], self._second[:] = state[1:]


def _dense_relu(x: Floats, layer: tuple[Floats, Floats]) -> Floats:
    out: Floats = x @ layer[0]
    add_bias_relu(out, layer[1])
    return out


def has_extractors(observations: Floats, layers: Weights) -> bool:
    """Whether the first of the layers reads a part of the observation only, so that four of them are extractors'."""
    return bool(layers[0][0].shape[0] < observations.shape[1])


def heads_of(observations: Floats, layers: Weights, n_heads: int = 1) -> list[Weights]:
    """The layers of each head; the gradients of weights are split likewise, by `n_heads` and the same observations."""
    every = layers[4:] if has_extractors(observations, layers) else layers
    depth = len(every) // n_heads
    return [every[depth * k : depth * (k + 1)] for k in range(n_heads)]


def features(observations: Floats, layers: Weights, actions: Floats | None = None) -> Features:
    """Both extractors on observations (n, obs); the critic's `joined` ends with the actions (n, 2)."""
    if not has_extractors(observations, layers):
        joined = observations if actions is None else np.concatenate([observations, actions], axis=1)
        return Features(_NONE, _NONE, _NONE, _NONE, joined)
    split, width = layers[0][0].shape[0], layers[1][0].shape[1]
    task, lidar = observations[:, :split], observations[:, split:]
    task_hidden, lidar_hidden = _dense_relu(task, layers[0]), _dense_relu(lidar, layers[2])
    extra = 0 if actions is None else actions.shape[1]
    joined = np.empty((len(observations), 2 * width + extra), dtype=np.float32)
    np.matmul(task_hidden, layers[1][0], out=joined[:, :width])
    np.matmul(lidar_hidden, layers[3][0], out=joined[:, width : 2 * width])
    add_bias_relu(joined, np.concatenate([layers[1][1], layers[3][1]]))
    if actions is not None:
        joined[:, 2 * width :] = actions
    return Features(task, task_hidden, lidar, lidar_hidden, joined)


def head(joined: Floats, layers: Weights) -> Head:
    """The layers of a head on (n, features)."""
    hidden = [_dense_relu(joined, layers[0])]
    for layer in layers[1:-1]:
        hidden.append(_dense_relu(hidden[-1], layer))
    return Head(tuple(hidden), hidden[-1] @ layers[-1][0] + layers[-1][1])


def _to_inputs(gradient: Floats, weight: Floats) -> Floats:
    """gradient (n, outputs) @ weight (inputs, outputs).T; NumPy's own product is five times as slow for one output."""
    return gradient * weight.T if weight.shape[1] == 1 else gradient @ weight.T


def head_backward(gradient: Floats, joined: Floats, seen: Head, layers: Weights, gradients: Weights) -> Floats:
    """From the loss's gradient (n, outputs) to its gradient at the first hidden layer's input sums (n, width).

    Writes the gradients of the head's weights.
    """
    inputs = (joined, *seen.hidden)
    np.matmul(inputs[-1].T, gradient, out=gradients[-1][0])
    gradient.sum(0, out=gradients[-1][1])
    at_hidden = _to_inputs(gradient, layers[-1][0])
    for k in range(len(seen.hidden) - 1, -1, -1):
        relu_backward(at_hidden, seen.hidden[k], gradients[k][1])
        np.matmul(inputs[k].T, at_hidden, out=gradients[k][0])
        if k:
            at_hidden = at_hidden @ layers[k][0].T
    return at_hidden


def input_gradient(gradient: Floats, seen: Head, layers: Weights, columns: slice) -> Floats:
    """The gradient (n, columns) at some of a head's inputs, from that at its output; no weight's is wanted."""
    at_hidden = _to_inputs(gradient, layers[-1][0])
    for k in range(len(seen.hidden) - 1, -1, -1):
        relu_backward(at_hidden, seen.hidden[k], np.empty(layers[k][1].size, dtype=np.float32))
        at_hidden = at_hidden @ (layers[k][0] if k else layers[0][0][columns]).T
    return at_hidden


def features_backward(at_joined: Floats, seen: Features, layers: Weights, gradients: Weights) -> None:
    """From the gradient at the extractors' outputs (n, 2 * width) to those of their weights, which are written."""
    width = layers[1][0].shape[1]
    branches = ((0, seen.task, seen.task_hidden), (2, seen.lidar, seen.lidar_hidden))
    for k, (layer, inputs, hidden) in enumerate(branches):
        part = slice(k * width, (k + 1) * width)
        at_output = np.ascontiguousarray(at_joined[:, part])
        relu_backward(at_output, np.ascontiguousarray(seen.joined[:, part]), gradients[layer + 1][1])
        np.matmul(hidden.T, at_output, out=gradients[layer + 1][0])
        at_hidden = at_output @ layers[layer + 1][0].T
        relu_backward(at_hidden, hidden, gradients[layer][1])
        np.matmul(inputs.T, at_hidden, out=gradients[layer][0])
