"""The adaptable policy as it is stored: an actor that reads demonstration, distance and efficiency weights beside what
it observes; `at(preference)` is an ordinary policy. How it is trained lives in `training.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from desirepath.deploy.network import Layers, folded
from desirepath.learning.adaptable.objectives import NAMES, SIZE, check_preference
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import (
    Policy,
    PolicyError,
    StoredPolicy,
    check_networks,
    network_arrays,
    read_networks,
)
from desirepath.learning.policies.shape import NetworkShape
from desirepath.npz import Arrays
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.stored import StoredArrays

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class AdaptablePolicy(StoredArrays, StoredPolicy):
    """A deterministic actor of one setup, conditioned on a preference (3,) of at least 0 that sums to 1.

    shape: as the setup's, with three more task inputs and no extractors. actor: as in `Policy`.
    """

    setup: str
    shape: NetworkShape
    actor: tuple[Floats, ...]

    file_format = "desirepath-adaptable-1"

    def __post_init__(self) -> None:
        setup = get_setup(self.setup)
        if self.shape.observation_size != setup.observation_size + SIZE or self.shape.extractor:
            raise SetupError(
                f"adaptable policy reads {self.shape.observation_size} inputs; setup {self.setup} gives "
                f"{setup.observation_size}, with {SIZE} weights {setup.observation_size + SIZE}, without extractors"
            )
        check_networks(self.shape, self.actor, ())

    def at(self, preference: ArrayLike) -> Policy:
        """The ordinary policy under that preference. Exact: a constant input only moves the first layer's bias.

        Raises LearningError for what is no preference.
        """
        weights = check_preference(preference)
        task_inputs = self.shape.task_inputs - SIZE
        actor = folded(self.actor, task_inputs, weights)
        return Policy(self.setup, replace(self.shape, task_inputs=task_inputs), actor)

    def driving(self, weights: str = "") -> Policy:
        return self.at(parse_preference(weights))

    @property
    def objectives(self) -> tuple[str, ...]:
        """What it is conditioned on."""
        return NAMES

    def weighed(self, weights: Mapping[str, float]) -> Policy:
        """`at` weights by name; what is not named is 0, and nothing at all a third of each. Raises LearningError."""
        unknown = sorted(set(weights) - set(NAMES))
        if unknown:
            raise LearningError(f"preference names {', '.join(unknown)}; objectives are {', '.join(NAMES)}")
        return self.at([weights.get(name, 0.0) for name in NAMES] if weights else np.full(SIZE, 1 / SIZE))

    def act(self, observations: Floats, preferences: Floats) -> Floats:
        """observations (n, obs), preferences (n, 3), each row its own -> actions (n, 2) in [-1, 1]."""
        split = self.shape.task_inputs - SIZE
        hidden = np.concatenate([observations[:, :split], preferences, observations[:, split:]], axis=1)
        return Layers(self.actor, self.shape.task_inputs, extractors=False)(hidden)

    def to_parts(self) -> tuple[Mapping[str, object], Arrays]:
        header = {"setup": self.setup, "shape": self.shape.as_dict(), "objectives": list(NAMES)}
        return header, network_arrays(self.actor)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        if tuple(header["objectives"]) != NAMES:
            raise PolicyError(f"adaptable policy knows the objectives {header['objectives']}; needed are {list(NAMES)}")
        return cls(header["setup"], NetworkShape.from_dict(header["shape"]), read_networks(arrays).actor)


def parse_preference(text: str) -> Floats:
    """`demonstration=0.5,distance=0.5` -> (3,); what is not named is 0, nothing at all a third of each.

    Raises LearningError naming what cannot be read.
    """
    if not text:
        return np.full(SIZE, 1 / SIZE, dtype=np.float32)
    found = np.zeros(SIZE, dtype=np.float32)
    for part in text.split(","):
        name, _, value = part.partition("=")
        try:
            found[NAMES.index(name.strip())] = float(value)
        except ValueError:
            raise LearningError(f"preference {part!r}: must be NAME=WEIGHT, NAME one of {', '.join(NAMES)}") from None
    return check_preference(found)


STORED = AdaptablePolicy
