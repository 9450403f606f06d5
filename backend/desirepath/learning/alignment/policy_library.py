"""Policies made before anybody came, and which of them is somebody's own by what their answers say: no training at all.

Some are the conditioned policy at settings; the others are mixes, in their networks' weights, of policies that were
trained on from the base policy by orthogonal weights of the step basis (rewarded soups, Rame et al. 2023): part of the
way arrives more often than all of it, and two ways together are what neither was trained on. How each differs from the
base policy is stored beside it. Making one is `experiments/shipping/policy_libraries.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.measures.step_basis import Doubles, Floats
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.measures import MEASURES
from desirepath.npz import Arrays
from desirepath.simulation.stored import StoredArrays

FORMAT_WITHOUT_MIXES = "desirepath-policy-library-1"
DOUBT = 0.1
"""Standard deviations that are taken off what a policy is expected to gain; chosen on tuning families."""

LEAST_SUCCESS = 0.96
SLOWEST = 2.0
"""How much longer than the base policy a policy may take, in what the slowest setting of the conditioned policy does:
rewards per step are gained by dawdling where one is liked to be, which nobody watches."""
TIME = MEASURES.index("time_s")


class Believed(Protocol):
    """What answers say by what trajectories measure, of one person (`FreePosterior`) or of several."""

    @property
    def left_right_symmetry(self) -> bool: ...

    def advantages(self, differences: PairDifferences) -> tuple[Doubles, Doubles]:
        """(n,) how much better the first of each pair is expected to be, and its standard deviation."""
        ...


class BelievedOfSteps(Protocol):
    """The same by means over steps, of one person (`StepPosterior`) or of several."""

    def advantages(self, differences: Doubles) -> tuple[Doubles, Doubles]:
        """As of `Believed`, of (n, K)."""
        ...


@dataclass(frozen=True)
class LibraryMeasures:
    """How each of n policies differs from the base policy, on average over the scenes in which both arrive. pairs,
    mirrored: without and with left-right symmetry; steps (n, K): as `step_differences`; success (n,)."""

    pairs: PairDifferences
    mirrored: PairDifferences
    steps: Doubles
    success: Doubles

    @property
    def longer_s(self) -> Doubles:
        """(n,) seconds that each takes more than the base policy."""
        return self.pairs.seen[:, 0, TIME]

    def __getitem__(self, rows: NDArray[np.int64]) -> LibraryMeasures:
        return LibraryMeasures(self.pairs[rows], self.mirrored[rows], self.steps[rows], self.success[rows])


@dataclass(frozen=True)
class PolicyLibrary(StoredArrays):
    """settings (m, 9): of the conditioned policy. weights (k, K): that policies were trained on; actors: theirs, in
    half precision. mixes (p, k): of each further policy, how far it goes from the base policy towards each of these.
    measures: of the m, then of the p."""

    setup: str
    settings: Floats
    weights: Floats
    actors: tuple[tuple[NDArray[np.float16], ...], ...]
    mixes: Floats
    measures: LibraryMeasures

    noun, file_format, raises = "policy library", "desirepath-policy-library-2", LearningError
    read_too = (FORMAT_WITHOUT_MIXES,)

    def __len__(self) -> int:
        return len(self.settings) + len(self.mixes)

    @property
    def longest_s(self) -> float:
        """Seconds that a policy may take more than the base policy."""
        return SLOWEST * float(self.measures.longer_s[: len(self.settings)].max())

    @property
    def allowed(self) -> NDArray[np.bool_]:
        """(n,) those that arrive often enough and soon enough to be anybody's."""
        arrives: NDArray[np.bool_] = self.measures.success >= LEAST_SUCCESS
        return arrives & (self.measures.longer_s <= self.longest_s)

    def without_what_is_not_allowed(self) -> PolicyLibrary:
        """Mixes that are allowed, and the trained ones that some of these are of; settings cost nothing to keep."""
        first = len(self.settings)
        allowed = np.flatnonzero(self.allowed[first:])
        rows = np.concatenate([np.arange(first), first + allowed])
        mixes = self.mixes[allowed]
        used = np.flatnonzero(np.any(mixes != 0, axis=0))
        actors = tuple(self.actors[k] for k in used)
        return PolicyLibrary(self.setup, self.settings, self.weights[used], actors, mixes[:, used], self.measures[rows])

    def policy(self, place: int, conditioned: ConditionedPolicy, base: Policy) -> Policy:
        """The one at this place, with a critic to go on training from; freed by the base policy where it is stuck."""
        if place < len(self.settings):
            return conditioned.as_trained().at(self.settings[place])
        return mix_policies(base, self.actors, self.mixes[place - len(self.settings)])

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        of, mirrored = self.measures.pairs, self.measures.mirrored
        arrays: Arrays = {
            "settings": self.settings,
            "weights": self.weights,
            "mixes": self.mixes,
            "seen": of.seen.astype(np.float32),
            "named": of.named.astype(np.float16),
            "embedding": of.embedding.astype(np.float16),
            "mirrored_named": mirrored.named.astype(np.float16),
            "mirrored_embedding": mirrored.embedding.astype(np.float16),
            "steps": self.measures.steps.astype(np.float32),
            "success": self.measures.success.astype(np.float32),
        }
        for place, actor in enumerate(self.actors):
            arrays |= {f"actor{place:03d}_{k:02d}": layer for k, layer in enumerate(actor)}
        return {"setup": self.setup}, arrays

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> PolicyLibrary:
        """In the format without mixes each trained policy is one of the library."""
        setup = str(header["setup"])
        named, embedding, seen = (arrays[key].astype(np.float64) for key in ("named", "embedding", "seen"))
        mirrored = (arrays[f"mirrored_{key}"].astype(np.float64) for key in ("named", "embedding"))
        layers: dict[str, list[NDArray[np.float16]]] = {}
        for key in sorted(key for key in arrays if key.startswith("actor")):
            layers.setdefault(key.partition("_")[0], []).append(arrays[key])
        measures = LibraryMeasures(
            PairDifferences(setup, seen, named, embedding),
            PairDifferences(setup, seen, *mirrored),
            arrays["steps"].astype(np.float64),
            arrays["success"].astype(np.float64),
        )
        actors = tuple(tuple(of) for of in layers.values())
        whole = np.eye(len(actors), dtype=np.float32)
        mixes = whole if header["format"] == FORMAT_WITHOUT_MIXES else arrays["mixes"]
        return cls(setup, arrays["settings"], arrays["weights"], actors, mixes, measures)


def mix_policies(base: Policy, actors: Sequence[Sequence[NDArray[np.floating[Any]]]], parts: Floats) -> Policy:
    """Parts (k,): how far from the base policy towards each of these actors, together."""
    towards = [(np.float32(part), actors[k]) for k, part in enumerate(parts) if part]
    if len(towards) == 1 and towards[0][0] == 1:
        actor = tuple(layer.astype(np.float32) for layer in towards[0][1])
    else:
        actor = tuple(
            layer + sum((part * (other[n].astype(np.float32) - layer) for part, other in towards), np.float32(0))
            for n, layer in enumerate(base.actor)
        )
    return Policy(base.setup, base.shape, actor, base.critic, (base.actor,), held=base.held)


def expected_gains(measures: LibraryMeasures, believed: Believed, steps: BelievedOfSteps) -> Doubles:
    """(n,) what each is expected to gain over the base policy, by both posteriors together."""
    total: Doubles = gains_by_posterior(measures, believed, steps).sum(axis=0)
    return total


def gains_by_posterior(measures: LibraryMeasures, believed: Believed, steps: BelievedOfSteps) -> Doubles:
    """(2, n) what each is expected to gain over the base policy by the free-form and by the step posterior, each in the
    largest gain among these, less doubt."""
    gains = [
        (mean - DOUBT * deviation) / max(float(np.abs(mean).max()), 1e-9)
        for mean, deviation in expected_by_posterior(measures, believed, steps)
    ]
    return np.stack(gains)


def expected_by_posterior(
    measures: LibraryMeasures, believed: Believed, steps: BelievedOfSteps
) -> tuple[tuple[Doubles, Doubles], tuple[Doubles, Doubles]]:
    seen = measures.mirrored if believed.left_right_symmetry else measures.pairs
    return believed.advantages(seen), steps.advantages(measures.steps)


def best_of(library: PolicyLibrary, believed: Believed, steps: BelievedOfSteps) -> int:
    """The place of the policy that is expected to gain most, of those that are allowed."""
    expected = expected_gains(library.measures, believed, steps)
    return int(np.where(library.allowed, expected, -np.inf).argmax())
