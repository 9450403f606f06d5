"""Several policies of one setup that act side by side, each episode by its own: one compiled pass through all of their
networks, where one call for each policy would cost more than the arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.steering import Progress, Recovery
from desirepath.learning.policies.policy import Floats, Policy, PolicyError
from desirepath.simulation.acting import EpisodeActs, Rows, SensingPolicy
from desirepath.simulation.kernels import compiled
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.slowing import slowed

STANDS = -1


class SideBySide:
    """Policies of one setup and one network shape.

    Their actions are a policy's own, rounded otherwise (by some 1e-6). Raises PolicyError for several shapes.
    """

    def __init__(self, policies: Sequence[Policy]) -> None:
        shapes = {policy.shape for policy in policies}
        if len(shapes) != 1:
            raise PolicyError(f"policies: {len(shapes)} network shapes; side by side they need one")
        self._shape, self._setup = shapes.pop(), get_setup(policies[0].setup)
        self._slowing = {place: one.slowing for place, one in enumerate(policies) if one.slowing is not None}
        self._most_recoveries = max(len(policy.recovery_policies) for policy in policies)
        networks: list[Sequence[Floats]] = []
        self._network = np.full((len(policies), self._most_recoveries + 2), STANDS)
        """Policy by policy the network of who drives (`Progress`): itself, its recovery policies, at last none."""
        for place, policy in enumerate(policies):
            if not policy.recovery_policies:  # which never counts as stuck
                self._network[place] = len(networks)
            for driver, actor in enumerate((policy.actor, *policy.recovery_policies)):
                self._network[place, driver] = len(networks)
                networks.append(actor)
        layers = [np.ascontiguousarray(np.stack(layer), dtype=np.float32) for layer in zip(*networks, strict=True)]
        self._weights, self._biases = tuple(layers[0::2]), tuple(layers[1::2])

    def __len__(self) -> int:
        return len(self._network)

    def begin(self, drivers: NDArray[np.int64]) -> EpisodeActs:
        """Acts in new episodes. drivers (episodes,): the policy that drives in each; where it changes, who drives
        changes with it."""
        progress = Progress(len(drivers), self._most_recoveries + 1, CONTROL_DT_S, Recovery())
        scale, before = self._setup.distance_scale_m, drivers.copy()

        def act(observations: Floats, rows: Rows) -> Floats:
            places = drivers[rows]
            progress.begin_anew(rows[places != before[rows]])
            before[rows] = places
            active = np.zeros(len(rows), dtype=np.int64)
            if self._most_recoveries:
                active = progress.drivers(observations[:, 0].astype(np.float64) * scale, rows)
            return self.actions(np.ascontiguousarray(observations), places, self._network[places, active])

        return act

    def actions(self, observations: Floats, places: Rows, networks: Rows) -> Floats:
        """(n, 2) of so many states, each by its policy and this network of it; STANDS: none."""
        actions = np.empty((len(observations), 2), dtype=np.float32)
        extractors, inputs = bool(self._shape.extractor), self._shape.task_inputs
        _act(self._weights, self._biases, observations, networks, inputs, extractors, actions)
        for place, rule in self._slowing.items():
            these = places == place
            if these.any():
                actions[these] = slowed(rule, actions[these], observations[these], self._setup)
        return actions


@compiled
def _layer(
    weights: NDArray[Any], bias: NDArray[Any], seen: NDArray[Any], count: int, out: NDArray[Any], at: int
) -> None:
    """out[at:] = bias + seen[:count] @ weights; what is 0 behind a ReLU costs nothing."""
    width = bias.shape[0]
    for j in range(width):
        out[at + j] = bias[j]
    for i in range(count):
        value = seen[i]
        if value != 0.0:
            for j in range(width):
                out[at + j] += value * weights[i, j]


@compiled
def _rectify(values: NDArray[Any], first: int, end: int) -> None:
    for j in range(first, end):
        values[j] = max(values[j], np.float32(0.0))


@compiled
def _act(
    weights: tuple[NDArray[Any], ...],
    biases: tuple[NDArray[Any], ...],
    observations: Floats,
    networks: Rows,
    task_inputs: int,
    extractors: bool,
    out: Floats,
) -> None:
    widest = observations.shape[1]
    for bias in biases:
        widest = max(widest, 2 * bias.shape[1])
    one, other = np.empty(widest, dtype=np.float32), np.empty(widest, dtype=np.float32)
    for row in range(len(networks)):
        network = networks[row]
        if network < 0:
            out[row, 0], out[row, 1] = -1.0, 0.0
            continue
        first, count = 0, observations.shape[1]
        if extractors:
            _layer(weights[0][network], biases[0][network], observations[row], task_inputs, one, 0)
            width = biases[0].shape[1]
            _rectify(one, 0, width)
            _layer(weights[1][network], biases[1][network], one, width, other, 0)
            joined = biases[1].shape[1]
            rest = observations[row, task_inputs:]
            _layer(weights[2][network], biases[2][network], rest, len(rest), one, 0)
            _rectify(one, 0, biases[2].shape[1])
            _layer(weights[3][network], biases[3][network], one, biases[2].shape[1], other, joined)
            count = joined + biases[3].shape[1]
            _rectify(other, 0, count)
            first = 4
        else:
            other[:count] = observations[row]
        for layer in range(first, len(weights)):
            _layer(weights[layer][network], biases[layer][network], other, count, one, 0)
            count = biases[layer].shape[1]
            if layer + 1 < len(weights):
                _rectify(one, 0, count)
            one, other = other, one
        out[row, 0], out[row, 1] = np.tanh(other[0]), np.tanh(other[1])


class Drivers(SensingPolicy):
    """Each episode by one of the policies. drivers (episodes,): by which."""

    def __init__(self, policies: SideBySide, drivers: NDArray[np.int64]) -> None:
        self._policies, self._drivers = policies, drivers

    def begin_in(self, engine: Any) -> EpisodeActs:
        return self._policies.begin(self._drivers)
