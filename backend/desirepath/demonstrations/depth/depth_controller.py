"""A trained depth vision-based controller: one configuration's actor, as it is stored. How it sees: `states.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from desirepath.demonstrations.depth.states import CONFIGURATIONS, DepthConfiguration, Floats, Senses, goals_of
from desirepath.learning.policies.policy import (
    DrivingPolicy,
    PolicyError,
    check_networks,
    network_arrays,
    read_networks,
)
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.shipped_files import resolve
from desirepath.learning.td3.td3 import act as act_by
from desirepath.npz import Arrays
from desirepath.perception import SHIPPED_ENCODER, SHIPPED_PREDICTOR
from desirepath.simulation.acting import EpisodeActs, Rows, SensingPolicy
from desirepath.simulation.depth_camera import CameraNoise, Sights
from desirepath.simulation.setups import get_setup
from desirepath.simulation.stored import StoredArrays


@dataclass(frozen=True)
class DepthController(StoredArrays, DrivingPolicy):
    """actor: weight, bias, ... float32, in the order of `NetworkShape`. Raises PolicyError for what does not fit."""

    configuration: DepthConfiguration
    shape: NetworkShape
    actor: tuple[Floats, ...]
    setup: str = field(default="home", init=False)

    reads = "a depth camera's pictures"
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
        return act_by(states, list(zip(self.actor[::2], self.actor[1::2], strict=True)))

    @property
    def rollout_policy(self) -> SensingPolicy:
        """Takes noisy pictures in the engine, encoded as shipped."""
        return _Looking(self)

    def manifest(self) -> dict[str, object]:
        camera, limits = self.configuration.camera, get_setup(self.setup).robot.limits
        return {
            "setup": self.setup,
            "camera": asdict(camera),
            "state": {"dtype": "float32", "shape": [self.shape.observation_size], "source": "depth/states.py"},
            "configuration": self.configuration.name,
            "encoder": SHIPPED_ENCODER,
            "action": {
                "range": [-1.0, 1.0],
                "linear_velocity_m_s": [limits.v_min, limits.v_max],
                "angular_velocity_rad_s": [-limits.w_max, limits.w_max],
            },
            "control_rate_hz": 5,
            "policy_sha256": self.digest(),
        }

    def to_parts(self) -> tuple[Mapping[str, object], Arrays]:
        header = {"configuration": self.configuration.name, "shape": self.shape.as_dict()}
        return header, network_arrays(self.actor)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> DepthController:
        if header["configuration"] not in CONFIGURATIONS:
            raise PolicyError(f"configuration {header['configuration']!r}: known are {', '.join(CONFIGURATIONS)}")
        shape = NetworkShape.from_dict(header["shape"])
        return cls(CONFIGURATIONS[header["configuration"]], shape, read_networks(arrays).actor)


class _Looking(SensingPolicy):
    def __init__(self, controller: DepthController) -> None:
        self._controller = controller

    def begin_in(self, engine: Any) -> EpisodeActs:
        from desirepath.demonstrations.depth.episodes import people_of
        from desirepath.perception.beta_vae import DepthEncoder  # torch comes with it
        from desirepath.perception.predictor import PersonPredictor

        configuration = self._controller.configuration
        encoder = DepthEncoder.from_bytes(resolve(SHIPPED_ENCODER).read_bytes())
        predictor = (
            PersonPredictor.from_bytes(resolve(SHIPPED_PREDICTOR).read_bytes()) if configuration.predicts else None
        )
        scenes = [engine.scene(k) for k in range(engine.n_envs)]
        places = {scene: k for k, scene in enumerate(dict.fromkeys(scenes))}  # often one scene, many starts
        at = np.array([places[scene] for scene in scenes])
        senses = Senses(configuration, encoder, predictor, Sights(list(places)), noise=CameraNoise(), evaluating=True)
        begins = np.ones(len(scenes), dtype=bool)

        def act(_: Floats, rows: Rows) -> Floats:
            states = senses.states(engine.poses, goals_of(engine.rows), people_of(engine.rows), at, begins)
            begins[:] = False
            actions = self._controller.act(states)
            senses.acted(actions)
            return actions[rows]

        return act


STORED = DepthController
