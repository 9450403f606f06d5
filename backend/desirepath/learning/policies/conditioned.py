"""The preference-conditioned policy: one policy for all preference weights, so that aligning it takes no training.

Nine weights (`objectives.py`) enter beside the task inputs; `at(weights)` folds them into a bias,
which leaves an ordinary policy of the setup. How the weights are learned from answers lives in `posterior.py`, how the
policy is trained in `conditioned_training.py`, how far weights move it in `steerability.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.conditioning import strengthened
from desirepath.deploy.network import folded
from desirepath.deploy.steering import Slowing
from desirepath.learning.policies.policy import (
    Policy,
    PolicyError,
    StoredPolicy,
    check_networks,
    network_arrays,
    read_networks,
    read_slowing,
)
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.preferences.objectives import (
    NAMES,
    SIZE,
    check_weights,
    names_of,
    parse_weights,
    preference_weights,
)
from desirepath.npz import Arrays
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.stored import StoredArrays

Floats = NDArray[np.float32]
SLOWER = NAMES.index("slower_near_person")


@dataclass(frozen=True)
class ConditionedPolicy(StoredArrays, StoredPolicy):
    """A deterministic actor of one setup, conditioned on preference weights.

    shape: as the setup's, with SIZE more task inputs. actor, critic: as in `Policy`; the rows of the first layer that
    the weights enter come after those of the task part. scales: (9,) reward per step of each objective's step term at
    full weight, as in training. base: the base policy's actor, which frees a robot that is stuck, or empty: a robot
    that has no such recovery. slowing: the rule by which full `slower_near_person` drives beside the person, or none:
    what the network learned of it alone. strengths: objectives by name that, where nothing else is preferred, it is
    conditioned on so many times as strongly as asked for. Both were added after training and
    leave the networks as they are.
    """

    setup: str
    shape: NetworkShape
    actor: tuple[Floats, ...]
    critic: tuple[Floats, ...]
    scales: tuple[float, ...]
    base: tuple[Floats, ...] = ()
    slowing: Slowing | None = None
    strengths: Mapping[str, float] = field(default_factory=dict)

    file_format = "desirepath-conditioned-1"

    def __post_init__(self) -> None:
        setup = get_setup(self.setup)
        if self.shape.observation_size != setup.observation_size + SIZE:
            raise SetupError(
                f"conditioned policy reads {self.shape.observation_size} inputs; setup {self.setup} gives "
                f"{setup.observation_size}, with {SIZE} weights {setup.observation_size + SIZE}"
            )
        if len(self.scales) != SIZE:
            raise PolicyError(f"conditioned policy has {len(self.scales)} scales; there are {SIZE} objectives")
        check_networks(self.shape, self.actor, self.critic)
        if self.base:
            check_networks(self._policy_shape, self.base, ())
        unknown = sorted(set(self.strengths) - set(self.objectives))
        if unknown:
            known = list(self.objectives)
            raise PolicyError(f"conditioned policy field 'strengths' names {unknown}; objectives are {known}")

    @property
    def _policy_shape(self) -> NetworkShape:
        return replace(self.shape, task_inputs=self.shape.task_inputs - SIZE)

    def at(self, weights: Floats) -> Policy:
        """The ordinary policy conditioned on these preference weights (9,), critic included.

        While it is stuck the base policy drives, then this one with all weights zero, where the base policy is known.
        Exact: a constant input only moves the first task layer's bias. The slowing rule is as strict as the weight of
        `slower_near_person` is large; at 0 there is none. Raises LearningError for weights outside [0, 1] or of two
        opposites at once.
        """
        weights = check_weights(weights, self.objectives)
        factors = np.array([self.strengths.get(name, 1.0) for name in self.objectives], dtype=np.float32)
        entering = strengthened(weights, factors)
        shape = self._policy_shape
        actor, critic = (_folded(arrays, shape.task_inputs, entering) for arrays in (self.actor, self.critic))
        unmoved = _folded(self.actor, shape.task_inputs, np.zeros(SIZE, dtype=np.float32))
        recovery_policies = (self.base, unmoved) if self.base else ()
        slowing = self.slowing.weighted(float(weights[SLOWER])) if self.slowing else None
        return Policy(self.setup, shape, actor, critic, recovery_policies, slowing=slowing)

    def driving(self, weights: str = "") -> Policy:
        return self.at(parse_weights(weights))

    @property
    def objectives(self) -> tuple[str, ...]:
        """What it is conditioned on."""
        return names_of(self.setup)

    def weighed(self, weights: Mapping[str, float]) -> Policy:
        """`at` weights by name; what is not named is 0. Raises LearningError."""
        return self.at(preference_weights(weights))

    def as_trained(self) -> Self:
        """The policy without what was added after training: what its network learned. Queries are made of this one,
        since who drives slowly is soon too long to watch twice.
        """
        return replace(self, slowing=None, strengths={})

    def stronger(self, objective: str, factor: float) -> Self:
        """The policy that does at full weight of this objective what this one does at `factor` times full weight.

        Beyond 1 that goes on where training ended: it was never conditioned on so much. Exact, since weights enter
        linearly.
        """
        k = self.objectives.index(objective)
        row = self.shape.task_inputs - SIZE + k
        scales = (*self.scales[:k], self.scales[k] * factor, *self.scales[k + 1 :])
        actor, critic = (_scaled_row(arrays, row, factor) for arrays in (self.actor, self.critic))
        return replace(self, actor=actor, critic=critic, scales=scales)

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        header: dict[str, object] = {
            "setup": self.setup,
            "shape": self.shape.as_dict(),
            "objectives": list(self.objectives),
            "scales": list(self.scales),
        }
        if self.slowing:
            header["slowing"] = self.slowing.as_dict()
        if self.strengths:
            header["strengths"] = dict(self.strengths)
        return header, network_arrays(self.actor, self.critic, (self.base,) if self.base else ())

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        needed = names_of(header["setup"])
        if tuple(header["objectives"]) != needed:
            raise PolicyError(
                f"conditioned policy knows the objectives {header['objectives']}; needed are {list(needed)}"
            )
        actor, critic, recovery_policies = read_networks(arrays)
        if len(recovery_policies) > 1:
            raise PolicyError(
                f"conditioned policy has {len(recovery_policies)} recovery policies; it can have one, the base policy"
            )
        shape, base = NetworkShape.from_dict(header["shape"]), recovery_policies[0] if recovery_policies else ()
        added = (read_slowing(header), header.get("strengths", {}))
        return cls(header["setup"], shape, actor, critic, tuple(header["scales"]), base, *added)


def _folded(arrays: tuple[Floats, ...], task_inputs: int, weights: Floats) -> tuple[Floats, ...]:
    return folded(arrays, task_inputs, weights) if arrays else ()


def _scaled_row(arrays: tuple[Floats, ...], row: int, factor: float) -> tuple[Floats, ...]:
    if not arrays:
        return ()
    first = arrays[0].copy()
    first[row] *= np.float32(factor)
    return (first, *arrays[1:])


def settings(extra: Mapping[str, Mapping[str, float]] | None = None, setup: str = "study_room") -> dict[str, Floats]:
    """The preference weights a conditioned policy of that setup is judged by: none (`neutral`), then each objective
    alone at full strength.
    """
    alone = {name: {name: 1.0} for name in names_of(setup)}
    named: dict[str, Mapping[str, float]] = {"neutral": {}, **alone, **(extra or {})}
    return {name: preference_weights(weights) for name, weights in named.items()}


STORED = ConditionedPolicy
