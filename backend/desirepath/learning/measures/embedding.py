"""An embedding of trajectories learned from nobody: means over a trajectory of random features of its steps' inputs.

A weighing of these features can come near any reward per step of observation and action (random features of a neural
kernel, Rahimi and Recht 2007), so it says what no named measure says. The numbers are ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.steps import SeenSteps, reference
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
SIZE = 400
WAVES = 4  # lidar weights are sums of so many waves over the bearing, the finer ones the smaller
SEED = 77


@dataclass(frozen=True)
class _Layer:
    """weights (inputs, SIZE), of all groups of inputs; the first half of the features is tanh, the other a hinge."""

    weights: Floats
    bias: Floats


def embed(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, SIZE) of each trajectory. Raises SetupError for mixed setups, ValueError for none."""
    steps = SeenSteps.of_trajectories(trajectories)
    layer = _layer(steps.setup.name)
    features = np.concatenate(list(steps.scaled_inputs.values()), axis=1, dtype=np.float32) @ layer.weights
    features += layer.bias
    half = SIZE // 2
    np.tanh(features[:, :half], out=features[:, :half])
    np.maximum(features[:, half:], 0.0, out=features[:, half:])
    ends = np.flatnonzero(np.diff(steps.of, prepend=-1))
    return np.add.reduceat(features, ends, axis=0, dtype=np.float64) / np.bincount(steps.of)[:, None]


@lru_cache(maxsize=4)
def _layer(setup: str) -> _Layer:
    """The same for everybody. Each group of inputs has about equal parts, in every feature others somewhat more."""
    random = np.random.default_rng(SEED)
    weights = []
    for name, values in reference(setup).steps.scaled_inputs.items():
        size = values.shape[1]
        drawn = random.normal(0, 1, (size, SIZE))
        if name == "lidar":
            bearings = (np.arange(size) + 0.5) * 2 * math.pi / size
            waves = [np.ones(size)]
            for k in range(1, WAVES + 1):
                waves += [np.cos(k * bearings) / k, np.sin(k * bearings) / k]
            drawn = np.stack(waves, axis=1) @ random.normal(0, 1, (len(waves), SIZE))
        spread = np.exp(random.normal(0, 0.6, SIZE)) / math.sqrt(3)
        weights.append(drawn / (values @ drawn).std(0) * spread)
    bias = random.normal(0, 0.7, SIZE)
    return _Layer(np.concatenate(weights, dtype=np.float32), bias.astype(np.float32))
