"""A policy as it is stored, shown and compared: one actor bound to one setup, plain arrays, no optimiser.

Training lives in the algorithms' files, exports to other formats in `export.py`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.network import Layers
from desirepath.deploy.steering import Recovery, Slowing, SteeringError
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.manifest import robot_manifest, setup_manifest
from desirepath.learning.policies.shape import NetworkShape
from desirepath.npz import Arrays, npz_header
from desirepath.registries import Registry
from desirepath.simulation.acting import ActFunction, EpisodicPolicy, RecoveringPolicy
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.slowing import person_distance_input, slowed
from desirepath.simulation.stored import Stored, StoredArrays
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]


class PolicyError(ValueError):
    """A policy file or weights that cannot be used; says what was found and what would work."""


def check_networks(shape: NetworkShape, actor: Sequence[Floats], critic: Sequence[Floats]) -> None:
    """Raise PolicyError unless the arrays have the shape's layers and are finite; the critic may be empty."""
    _check(shape.actor_layers(), actor, "actor")
    if critic:
        _check(shape.critic_layers(), critic, "critic")


def _check(sizes: list[tuple[int, int]], arrays: Sequence[Floats], what: str) -> None:
    expected = [shape for inputs, outputs in sizes for shape in ((inputs, outputs), (outputs,))]
    found = [array.shape for array in arrays]
    if found != expected:
        raise PolicyError(f"policy field '{what}' has layer shapes {found}; its network shape needs {expected}")
    if not all(np.isfinite(array).all() for array in arrays):
        raise PolicyError(f"policy field '{what}' holds NaN or infinite weights; train again or take an earlier file")


def network_arrays(
    actor: Sequence[Floats], critic: Sequence[Floats] = (), recovery_policies: Sequence[Sequence[Floats]] = ()
) -> Arrays:
    """Their layers by name, for storage."""
    others = {f"escape{n}": layers for n, layers in enumerate(recovery_policies)}  # the key in all stored files
    named = {"actor": actor, "critic": critic} | others
    return {f"{name}_{k:02d}": array for name, layers in named.items() for k, array in enumerate(layers)}


class StoredNetworks(NamedTuple):
    """What `network_arrays` names."""

    actor: tuple[Floats, ...]
    critic: tuple[Floats, ...]
    recovery_policies: tuple[tuple[Floats, ...], ...]


def read_networks(arrays: Arrays) -> StoredNetworks:
    """Back from `network_arrays`."""
    layers: dict[str, list[Floats]] = {}
    for name in sorted(arrays):
        layers.setdefault(name.rpartition("_")[0], []).append(arrays[name])
    recovery_policies = tuple(tuple(layers[name]) for name in layers if name.startswith("escape"))
    return StoredNetworks(tuple(layers.get("actor", ())), tuple(layers.get("critic", ())), recovery_policies)


def read_slowing(meta: Mapping[str, Any]) -> Slowing | None:
    """The rule that a policy's file names, or none. Raises PolicyError where it is not a rule."""
    if "slowing" not in meta:
        return None
    try:
        return Slowing(**meta["slowing"])
    except (TypeError, SteeringError) as problem:
        raise PolicyError(f"policy field 'slowing' = {meta['slowing']!r}: {problem}") from None


class StoredPolicy(Stored):
    """A kind of policy as a file: whatever `to_bytes` gives, `from_bytes` reads (`StoredArrays` has both).

    A kind is one module in this folder, found by looking, or one of another package by an entry point of
    `desirepath.policies`; it ends with `STORED`, and stored files name it in their format: `NAME-VERSION`
    (the product's: `desirepath-NAME-VERSION`).
    """

    noun = "policy"
    raises: ClassVar[type[ValueError]] = PolicyError
    setup: str

    @abstractmethod
    def driving(self, weights: str = "") -> DrivingPolicy:
        """What drives, conditioned on weights as they are written behind `@` on the command line. Raises LearningError
        for weights that it does not take."""


class DrivingPolicy(StoredPolicy):
    """What drives a robot of its setup. Evaluation, comparison, flow fields and exports ask no more of it.

    reads: what it goes by, where that is not its setup's observation.
    """

    reads: ClassVar[str] = "its inputs in a way of its own"

    @property
    @abstractmethod
    def rollout_policy(self) -> ActFunction | EpisodicPolicy:
        """What acts in whole episodes."""

    @abstractmethod
    def manifest(self) -> dict[str, object]:
        """What a foreign program needs to run it."""

    def without_critic(self) -> DrivingPolicy:
        """All of it that driving needs."""
        return self

    def in_scene(self, scene: Scene) -> DrivingPolicy:
        """What drives in an episode that begins there, of a policy that is several."""
        return self

    def attended(self, scene: Scene) -> tuple[Trajectory, NDArray[np.float64]]:
        """Its rollout in the scene, and (steps, people) in [0, 1] how much it looked at each person: what explains a
        policy that is no one network. Raises LearningError where nothing does."""
        raise LearningError(
            f"{type(self).__name__} of {scene.setup} reads {self.reads}: no thing in the scene can be told to have "
            "moved it; evaluate, compare, flow-field and trajectories take it"
        )

    def driving(self, weights: str = "") -> DrivingPolicy:
        if weights:
            raise LearningError(f"this policy takes no preference weights: {weights!r} needs a conditioned policy")
        return self


FORMATS: Registry[type[StoredPolicy]] = Registry(
    "desirepath.policies", ("desirepath.learning.policies", "desirepath.demonstrations.depth"), "STORED"
)
"""By the name in a stored file's format."""


def read_policy(content: bytes) -> StoredPolicy:
    """A stored policy of whatever kind. Raises PolicyError, or LearningError, for what is none."""
    try:
        found = str(npz_header(content)["format"])
    except (ValueError, KeyError) as problem:
        raise PolicyError(f"not a desirepath policy (.npz): {problem}") from None
    name = found.removeprefix("desirepath-").rpartition("-")[0].replace("-", "_")
    if name not in FORMATS:
        raise PolicyError(f"policy format {found!r} is unknown; known are the formats of {', '.join(FORMATS)}")
    return FORMATS[name].from_bytes(content)


def network_of(policy: DrivingPolicy) -> Policy:
    """The policy, where it is one network that reads its setup's observation: what trainings start from, and what
    gradients and other people's formats are made of. Raises LearningError for others."""
    if not isinstance(policy, Policy):
        kind = f"{type(policy).__name__} of {policy.setup}"
        raise LearningError(
            f"{kind} reads {policy.reads}; needed is one network of linear layers and ReLU that reads its setup's "
            "observation alone. Its file and manifest can be had, and it is evaluated, compared and drawn as any"
        )
    return policy


@dataclass(frozen=True)
class Policy(StoredArrays, DrivingPolicy):
    """A deterministic actor of one setup.

    actor, critic: weight, bias, weight, bias, ... float32, weights (inputs, outputs), in the order of `NetworkShape`.
    critic: the value functions the actor was trained with, or empty; alignment starts from them.
    recovery_policies: other actors of the same shape that drive, in this order, while the robot is stuck (`driver`).
    made_for: whose it is, such as the id of the answers behind it; stored, so that two people's policies are two where
    they act alike. slowing: how it is slowed down beside the person, by a rule that is no part of the network.
    held: with which weight its training drew it to a guide until the end. Its critic wants something else, so whoever
    trains on from it draws the new one to it as much (`held_to`).
    """

    setup: str
    shape: NetworkShape
    actor: tuple[Floats, ...]
    critic: tuple[Floats, ...] = ()
    recovery_policies: tuple[tuple[Floats, ...], ...] = ()
    made_for: str = ""
    slowing: Slowing | None = None
    held: float = 0.0

    file_format = "desirepath-policy-1"

    def __post_init__(self) -> None:
        if self.shape.observation_size != get_setup(self.setup).observation_size:
            raise SetupError(
                f"policy reads {self.shape.observation_size} inputs, setup {self.setup} "
                f"gives {get_setup(self.setup).observation_size}"
            )
        check_networks(self.shape, self.actor, self.critic)
        if not isinstance(self.held, float) or not 0 <= self.held < np.inf:
            raise PolicyError(f"policy field 'held' = {self.held!r}: a finite weight of at least 0")
        for recovery_policy in self.recovery_policies:
            check_networks(self.shape, recovery_policy, ())
        if self.slowing:
            person_distance_input(get_setup(self.setup))

    @cached_property
    def rollout_policy(self) -> ActFunction | EpisodicPolicy:
        """What acts in whole episodes: `act`, with a recovery where the policy has recovery policies."""
        if not self.recovery_policies:
            return self.act
        others = [
            Policy(self.setup, self.shape, recovery_policy, slowing=self.slowing).act
            for recovery_policy in self.recovery_policies
        ]
        return RecoveringPolicy(get_setup(self.setup), self.act, others)

    def act(self, observations: Floats) -> Floats:
        """observations (n, obs) float32 as the setup lays them out -> actions (n, 2) float32 in [-1, 1], slowed.

        Raises SetupError if the observation has another setup's size.
        """
        if observations.ndim != 2 or observations.shape[1] != self.shape.observation_size:
            raise SetupError(
                f"observations have shape {observations.shape}; "
                f"a {self.setup} policy reads (n, {self.shape.observation_size})"
            )
        actions = self._layers(observations)
        return slowed(self.slowing, actions, observations, get_setup(self.setup)) if self.slowing else actions

    @cached_property
    def _layers(self) -> Layers:
        return Layers(self.actor, self.shape.task_inputs, bool(self.shape.extractor))

    def commands(self, actions: Floats) -> Floats:
        """actions (n, 2) in [-1, 1] -> (n, 2) linear velocity (m/s) and angular velocity (rad/s)."""
        limits = get_setup(self.setup).robot.limits
        speed = limits.v_min + (actions[:, 0] + 1) / 2 * (limits.v_max - limits.v_min)
        return np.stack([speed, actions[:, 1] * limits.w_max], axis=1).astype(np.float32)

    def without_critic(self) -> Policy:
        """The actor alone: all that driving needs."""
        return replace(self, critic=(), held=0.0)

    def manifest(self) -> dict[str, object]:
        """What a foreign program needs to run the exported policy: inputs in order with units, outputs with scaling."""
        return {
            "setup": self.setup,
            **setup_manifest(get_setup(self.setup)),
            **robot_manifest(get_setup(self.setup)),
            "network": self.shape.as_dict(),
            "value_functions": bool(self.critic),
            "recovery": asdict(Recovery())
            | {
                "recovery_policies": len(self.recovery_policies),
                "exported": "policy.onnx is the usual actor alone; the .npz holds the recovery policies, too",
            }
            if self.recovery_policies
            else None,
            "slowing": self.slowing.as_dict()
            | {"exported": "the network alone; whoever runs it scales both commands down by this rule"}
            if self.slowing
            else None,
            "policy_sha256": self.digest(),
        }

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        header: dict[str, object] = {"setup": self.setup, "shape": self.shape.as_dict()}
        if self.made_for:
            header["made_for"] = self.made_for
        if self.slowing:
            header["slowing"] = self.slowing.as_dict()
        if self.held:
            header["held"] = self.held
        return header, network_arrays(self.actor, self.critic, self.recovery_policies)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        shape, made_for = NetworkShape.from_dict(header["shape"]), header.get("made_for", "")
        held = header.get("held", 0.0)
        return cls(header["setup"], shape, *read_networks(arrays), made_for, read_slowing(header), held)


STORED = Policy
