"""A few numbers per step of which a weighted sum comes near most rewards of observation and action.

Here are the basis itself and what it says of steps and trajectories. It was chosen once, from networks that people
might have for rewards, and is shipped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.steps import WORDS, SeenSteps, reference, scale_words
from desirepath.npz import Arrays
from desirepath.simulation.setups import Setup, get_setup
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
BELOW = {"person_m": (0.8, 1.2, 1.8, 2.5), "clearance_m": (0.2, 0.4, 0.6), "free_ahead_m": (0.8, 1.5, 2.5)}
ABOVE = {"turning": (0.2, 0.5), "off_course": (0.15, 0.4), "jerk": (0.1, 0.3), "speed": (0.5, 0.8)}
"""By word, from where on less, or more, of it is a feature of its own."""
WAVES = 6  # lidar weights are sums of so many waves over the bearing
SEED = 5


def seen_steps(setup: Setup, observations: Floats, actions: Floats, next_observations: Floats) -> SeenSteps:
    """Steps that belong to no trajectory, (n, ...) each. What was done before is read off the observed velocity; where
    none is observed nothing is known to have changed."""
    acted = np.clip(actions.astype(np.float64), -1, 1)
    before = np.stack([observations[:, 4] * 2 - 1, observations[:, 5]], axis=1) if setup.with_velocity else acted
    return SeenSteps(
        setup,
        observations.astype(np.float64),
        acted,
        next_observations.astype(np.float64),
        before.astype(np.float64),
        np.zeros(len(acted), dtype=np.int64),
        np.full(len(acted), 0.5),
    )


@dataclass(frozen=True)
class StepLayer:
    """Random features of a step, the same for everybody: a layer over its inputs (first half tanh, second half hinges),
    the inputs themselves, the words, and where words begin to count. weights (inputs, n), bias (n,)."""

    weights: Floats
    bias: Floats

    @classmethod
    def drawn(cls, setup: str, size: int) -> StepLayer:
        """Each group of inputs has about equal parts, in every feature others somewhat more."""
        random = np.random.default_rng(SEED)
        groups = []
        for name, values in reference(setup).steps.scaled_inputs.items():
            count = values.shape[1]
            drawn = random.normal(0, 1, (count, size))
            if name == "lidar":
                bearings = (np.arange(count) + 0.5) * 2 * math.pi / count
                waves = [np.ones(count)]
                for k in range(1, WAVES + 1):
                    waves += [np.cos(k * bearings) / math.sqrt(k), np.sin(k * bearings) / math.sqrt(k)]
                drawn = np.stack(waves, axis=1) @ random.normal(0, 1, (len(waves), size))
            spread = np.exp(random.normal(0, 0.6, size)) / math.sqrt(3)
            groups.append(drawn / (values @ drawn).std(0) * spread)
        return cls(np.concatenate(groups).astype(np.float32), random.normal(0, 0.7, size).astype(np.float32))

    def of(self, steps: SeenSteps) -> Floats:
        """(n, features)."""
        inputs = np.concatenate(list(steps.scaled_inputs.values()), axis=1, dtype=np.float32)
        hidden = inputs @ self.weights + self.bias
        half = hidden.shape[1] // 2
        np.tanh(hidden[:, :half], out=hidden[:, :half])
        np.maximum(hidden[:, half:], 0, out=hidden[:, half:])
        words = [np.clip((limit - steps.words[name]) / limit, 0, 1) for name, of in BELOW.items() for limit in of]
        words += [
            np.clip((steps.words[name] - limit) / (1 - limit), 0, 1) for name, of in ABOVE.items() for limit in of
        ]
        parts = [hidden, inputs, scale_words(steps, WORDS), np.stack(words, axis=1)]
        return np.concatenate(parts, axis=1, dtype=np.float32)


@dataclass(frozen=True)
class StepBasis(StoredArrays):
    """size K numbers per step, mean 0 over varied rollouts; rewards of random people weigh them by about N(0, 1).

    mix (features, K), offset (K,): of the layer's features. covariance (K, K): of trajectories' means within a scene.
    """

    setup: str
    layer: StepLayer
    mix: Floats
    offset: Floats
    covariance: Floats

    noun, file_format, raises = "step basis", "desirepath-step-basis-1", LearningError

    @property
    def size(self) -> int:
        return len(self.offset)

    def of_steps(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        """(n, K) of steps as transitions have them."""
        setup = get_setup(self.setup)
        values: Floats = self.layer.of(seen_steps(setup, observations, actions, next_observations)) @ self.mix
        return values - self.offset

    def means(self, trajectories: Sequence[Trajectory]) -> Doubles:
        """(n, K) mean over each trajectory's steps. Raises ValueError for none."""
        if not trajectories:
            raise ValueError("trajectories: none given; at least one is needed")
        steps = self.of_steps(
            np.concatenate([trajectory.observations for trajectory in trajectories]),
            np.concatenate([trajectory.actions for trajectory in trajectories]),
            np.concatenate([trajectory.next_observations for trajectory in trajectories]),
        )
        lengths = np.array([len(trajectory.actions) for trajectory in trajectories])
        of_trajectories: Doubles = (
            np.add.reduceat(steps.astype(np.float64), np.cumsum(lengths) - lengths) / lengths[:, None]
        )
        return of_trajectories

    def between(self, first: Doubles, second: Doubles) -> Doubles:
        """(n, K) first minus second of pairs of trajectories' means; a typical pair has length 1."""
        found: Doubles = (first - second) / np.sqrt(2 * np.trace(self.covariance))
        return found

    def to_arrays(self) -> dict[str, Floats]:
        """By name, for storage."""
        return {
            "layer_weights": self.layer.weights,
            "layer_bias": self.layer.bias,
            "mix": self.mix,
            "offset": self.offset,
            "covariance": self.covariance,
        }

    @classmethod
    def from_arrays(cls, setup: str, arrays: dict[str, Floats]) -> StepBasis:
        """Back from `to_arrays`. Raises KeyError where one is missing."""
        layer = StepLayer(arrays["layer_weights"], arrays["layer_bias"])
        return cls(setup, layer, *(arrays[name] for name in ("mix", "offset", "covariance")))

    def to_parts(self) -> tuple[dict[str, object], dict[str, Floats]]:
        return {"setup": self.setup}, self.to_arrays()

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> StepBasis:
        return cls.from_arrays(header["setup"], arrays)
