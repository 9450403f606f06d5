"""Actor and critic: two feature extractors (task part, lidar part), joined, then hidden layers (chapter 6), or these
alone (chapter 8).

Here live parameters and forward passes in torch. Their sizes live in `shape.py`, how they are trained in `td3.py`, how
a finished actor is carried around in `policy.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Layer = tuple[Tensor, Tensor]


def use_one_thread() -> None:
    """One torch thread for this process: these networks are so small that a second thread makes them slower."""
    torch.set_num_threads(1)


class Parameters:
    """All weights of one network in one flat vector, with a view per layer.

    One vector makes Adam one fused call and the target update one `lerp_`. The layer views are autograd leaves whose
    `.grad` are views of one flat gradient, so that `backward` accumulates straight into it.
    `layers`: list of (weight (inputs, outputs), bias (outputs,)).
    """

    def __init__(self, sizes: Sequence[tuple[int, int]], *, trainable: bool) -> None:
        self.sizes = list(sizes)
        self.flat = torch.zeros(sum(i * o + o for i, o in self.sizes))
        self.grad = torch.zeros_like(self.flat) if trainable else None
        self.layers: list[Layer] = []
        offset = 0
        for inputs, outputs in self.sizes:
            weight, offset = self._view(offset, (inputs, outputs))
            bias, offset = self._view(offset, (outputs,))
            self.layers.append((weight, bias))
        if self.grad is not None:
            self.flat.grad = self.grad
        self.weights = self._arrays(self.flat)
        self.gradients = self._arrays(self.grad) if self.grad is not None else []

    def _arrays(self, flat: Tensor) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """NumPy views per layer, for who computes without automatic differentiation."""
        parts = iter(np.split(flat.numpy(), np.cumsum([n for i, o in self.sizes for n in (i * o, o)])[:-1]))
        return [(next(parts).reshape(inputs, outputs), next(parts)) for inputs, outputs in self.sizes]

    def _view(self, offset: int, shape: tuple[int, ...]) -> tuple[Tensor, int]:
        end = offset + math.prod(shape)
        view = self.flat.detach()[offset:end].view(shape)
        if self.grad is not None:
            view.requires_grad_(True)
            view.grad = self.grad[offset:end].view(shape)
        return view, end

    def initialise(self, generator: torch.Generator) -> None:
        """Uniform in +-1/sqrt(inputs), torch's own default for linear layers."""
        with torch.no_grad():
            for weight, bias in self.layers:
                bound = 1.0 / math.sqrt(weight.shape[0])
                for part in (weight, bias):
                    part.copy_((torch.rand(part.shape, generator=generator) * 2 - 1) * bound)

    def frozen(self) -> list[Layer]:
        """The layers without gradient, for targets and for the critic inside the actor's loss."""
        return [(weight.detach(), bias.detach()) for weight, bias in self.layers]

    def zero_grad(self) -> None:
        """Forget the accumulated gradient; frozen parameters have none."""
        if self.grad is not None:
            self.grad.zero_()

    def to_arrays(self) -> list[NDArray[np.float32]]:
        """Copies: weight, bias, weight, bias, ..."""
        return [part.detach().numpy().copy() for layer in self.layers for part in layer]

    def load_arrays(self, arrays: Sequence[NDArray[np.float32]]) -> None:
        """Write arrays in the order of `to_arrays`. Raises ValueError on a shape that does not fit."""
        parts: Iterator[Tensor] = (part for layer in self.layers for part in layer)
        with torch.no_grad():
            for part, array in zip(parts, arrays, strict=True):
                if tuple(part.shape) != array.shape:
                    raise ValueError(f"network layer has shape {array.shape}, this network needs {tuple(part.shape)}")
                part.copy_(torch.from_numpy(np.ascontiguousarray(array)))


def _linear(x: Tensor, layer: Layer) -> Tensor:
    return torch.addmm(layer[1], x, layer[0])


def _features(observations: Tensor, layers: list[Layer]) -> Tensor:
    task_inputs = layers[0][0].shape[0]
    if task_inputs >= observations.shape[1]:  # no extractors
        return observations
    task, lidar = observations[:, :task_inputs], observations[:, task_inputs:]
    task = torch.relu(_linear(torch.relu(_linear(task, layers[0])), layers[1]))
    lidar = torch.relu(_linear(torch.relu(_linear(lidar, layers[2])), layers[3]))
    return torch.cat([task, lidar], 1)


def _head(x: Tensor, layers: list[Layer]) -> Tensor:
    for layer in layers[:-1]:
        x = torch.relu(_linear(x, layer))
    return _linear(x, layers[-1])


def _head_layers(observations: Tensor, layers: list[Layer]) -> list[Layer]:
    return layers[4:] if layers[0][0].shape[0] < observations.shape[1] else layers


def actor_features(observations: Tensor, layers: list[Layer]) -> Tensor:
    """observations (n, obs) -> (n, 2) what actions are before tanh."""
    return _head(_features(observations, layers), _head_layers(observations, layers))


def actor_forward(observations: Tensor, layers: list[Layer]) -> Tensor:
    """observations (n, obs) -> actions (n, 2) in [-1, 1]."""
    return torch.tanh(actor_features(observations, layers))


def critic_forward(observations: Tensor, actions: Tensor, layers: list[Layer], n_heads: int = 2) -> list[Tensor]:
    """observations (n, obs), actions (n, 2) -> one (n,) value per head."""
    joined = torch.cat([_features(observations, layers), actions], 1)
    every = _head_layers(observations, layers)
    depth = 1 + next(k for k, (weight, _) in enumerate(every) if weight.shape[1] == 1)  # a head ends with its value
    return [_head(joined, every[depth * k : depth * (k + 1)])[:, 0] for k in range(n_heads)]
