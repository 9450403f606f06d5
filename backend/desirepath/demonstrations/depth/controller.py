"""A trained depth vision-based controller: one configuration's actor, as it is stored. How it sees: `states.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from desirepath.demonstrations.depth.states import CONFIGURATIONS, DepthConfiguration, Floats
from desirepath.learning.policies.policy import PolicyError, check_networks, network_arrays, stored_networks
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.td3 import act
from desirepath.simulation.npz import Arrays
from desirepath.simulation.stored import StoredArrays


@dataclass(frozen=True)
class DepthController(StoredArrays):
    """actor: weight, bias, ... float32, in the order of `NetworkShape`. Raises PolicyError for what does not fit."""

    configuration: DepthConfiguration
    shape: NetworkShape
    actor: tuple[Floats, ...]

    noun, file_format, raises = "depth controller", "desirepath-depth-controller-1", PolicyError

    def __post_init__(self) -> None:
        needed = self.configuration.shape(self.shape.heads)
        if needed != self.shape:
            raise PolicyError(f"network {self.shape} reads another state than {self.configuration.name}: {needed}")
        check_networks(self.shape, self.actor, ())

    def act(self, states: Floats) -> Floats:
        """states (n, size) of this configuration -> actions (n, 2) in [-1, 1]. Raises PolicyError for another size."""
        if states.ndim != 2 or states.shape[1] != self.shape.observation_size:
            raise PolicyError(
                f"states have shape {states.shape}; {self.configuration.name} reads (n, {self.shape.observation_size})"
            )
        return act(states, list(zip(self.actor[::2], self.actor[1::2], strict=True)))

    def to_parts(self) -> tuple[Mapping[str, object], Arrays]:
        header = {"configuration": self.configuration.name, "shape": self.shape.as_dict()}
        return header, network_arrays(self.actor)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> DepthController:
        if header["configuration"] not in CONFIGURATIONS:
            raise PolicyError(f"configuration {header['configuration']!r}: known are {', '.join(CONFIGURATIONS)}")
        shape = NetworkShape.from_dict(header["shape"])
        return cls(CONFIGURATIONS[header["configuration"]], shape, stored_networks(arrays).actor)
