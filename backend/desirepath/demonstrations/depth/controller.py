"""A trained depth vision-based controller: one configuration's actor, as it is stored. How it sees: `states.py`."""

from __future__ import annotations

from dataclasses import dataclass

from desirepath.demonstrations.depth.states import CONFIGURATIONS, DepthConfiguration, Floats
from desirepath.learning.policies.policy import PolicyError, check_networks, networks_from_bytes, networks_to_bytes
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.td3 import act

FORMAT = "desirepath-depth-controller-1"


@dataclass(frozen=True)
class DepthController:
    """actor: weight, bias, ... float32, in the order of `NetworkShape`. Raises PolicyError for what does not fit."""

    configuration: DepthConfiguration
    shape: NetworkShape
    actor: tuple[Floats, ...]

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

    def to_bytes(self) -> bytes:
        """NPZ without pickled objects; the same controller always gives the same bytes."""
        meta = {"format": FORMAT, "configuration": self.configuration.name, "shape": self.shape.as_dict()}
        return networks_to_bytes(meta, self.actor, ())

    @classmethod
    def from_bytes(cls, data: bytes) -> DepthController:
        """Read `to_bytes` back, never unpickling. Raises PolicyError for anything else."""
        meta, actor, _, _ = networks_from_bytes(data, FORMAT)
        if meta["configuration"] not in CONFIGURATIONS:
            raise PolicyError(f"configuration {meta['configuration']!r}: known are {', '.join(CONFIGURATIONS)}")
        return cls(CONFIGURATIONS[meta["configuration"]], NetworkShape.from_dict(meta["shape"]), actor)
