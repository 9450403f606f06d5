"""A policy of somebody else whose network is not one of ours, such as PPO's with tanh: kept as the ONNX file that it
came as, run in a process of its own (`learning/foreign`). How it comes in is `foreign_files.py`'s."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.steering import Slowing
from desirepath.learning.foreign.limited import LimitedNetwork
from desirepath.learning.policies.manifest import robot_manifest, setup_manifest
from desirepath.learning.policies.policy import DrivingPolicy, PolicyError, read_slowing
from desirepath.npz import Arrays
from desirepath.simulation.acting import ActFunction
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.slowing import person_distance_input, slowed
from desirepath.simulation.stored import StoredArrays

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class ForeignPolicy(StoredArrays, DrivingPolicy):
    """A deterministic actor of one setup. network: ONNX, observation (n, obs) -> (n, 2), clipped to [-1, 1]; slowing:
    as in `Policy`."""

    setup: str
    network: bytes
    slowing: Slowing | None = None

    reads = "its setup's observation by a network of another kind"
    file_format = "desirepath-foreign-1"

    def __post_init__(self) -> None:
        get_setup(self.setup)
        if self.slowing:
            person_distance_input(get_setup(self.setup))

    @property
    def rollout_policy(self) -> ActFunction:
        return self.act

    def act(self, observations: Floats) -> Floats:
        """observations (n, obs) float32 as the setup lays them out -> actions (n, 2) float32 in [-1, 1], slowed.

        Raises SetupError if the observation has another setup's size, PolicyError where an action is not a number.
        """
        setup = get_setup(self.setup)
        if observations.ndim != 2 or observations.shape[1] != setup.observation_size:
            raise SetupError(
                f"observations have shape {observations.shape}; "
                f"a {self.setup} policy reads (n, {setup.observation_size})"
            )
        if not len(observations):
            return np.zeros((0, 2), dtype=np.float32)
        actions = self._running(np.ascontiguousarray(observations, dtype=np.float32))
        if not np.isfinite(actions).all():
            raise PolicyError(f"policy of {self.setup}: an action is not a number; its network cannot drive there")
        clipped: Floats = np.clip(actions, -1, 1)
        return slowed(self.slowing, clipped, observations, setup) if self.slowing else clipped

    @cached_property
    def _running(self) -> LimitedNetwork:
        described = json.dumps({"setup": self.setup}).encode()
        return LimitedNetwork("policy", described, self.network, f"policy of {self.setup}")

    def manifest(self) -> dict[str, object]:
        slowing = (
            self.slowing.as_dict()
            | {"exported": "the network alone; whoever runs it scales both commands down by this rule"}
            if self.slowing
            else None
        )
        own = {"network": None, "recovery": None, "slowing": slowing, "policy_sha256": self.digest()}
        setup = get_setup(self.setup)
        return {"setup": self.setup, **setup_manifest(setup), **robot_manifest(setup), **own}

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        header: dict[str, object] = {"setup": self.setup}
        if self.slowing:
            header["slowing"] = self.slowing.as_dict()
        return header, {"network": np.frombuffer(self.network, dtype=np.uint8)}

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        return cls(header["setup"], arrays["network"].tobytes(), read_slowing(header))


STORED = ForeignPolicy
